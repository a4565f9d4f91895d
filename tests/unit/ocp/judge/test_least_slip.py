"""The stored slip of a contact without normal force is the body's own sliding distance."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from dynamics.systems import ParameterTable, signals, time_stepping
from ocp import Direct, solve
from ocp.problem.problem import Problem, Scaling

H, G, FRICTION, N = 0.1, 10.0, 0.5, 4


def thrown(cone: str) -> Problem:
    """Return a problem of a point that flies at -2 m/s along the ground and lands in the last step."""
    system = time_stepping(
        "thrown",
        states=signals("x [m] along; z [m] height; vx [m/s] along; vz [m/s] up"),
        inputs=signals("ux [N s] impulse along; uz [N s] impulse up"),
        contacts=signals("ground [N s] normal impulse"),
        h=H,
        mass=ca.SX.eye(2),
        impulse=lambda q, v, u: u + ca.vertcat(0, -G * H),
        distance=lambda q: q[1],
        sliding=lambda q: ca.SX([[1.0, 0.0]]),
        friction=FRICTION,
        cone=cone,
        parameters=ParameterTable(),
    )
    return Problem(
        "thrown",
        system,
        N=N,
        stage_cost=ca.sumsqr(system.u),
        terminal_cost=0.01 * system.x[0] ** 2,
        parameters=ParameterTable(),
        x0=ca.SX([0.0, 0.8, -2.0, 0.0]),
        u_lower=-0.01,
        u_upper=0.01,
        scaling=Scaling(impulse=1.0, gap=0.2),
    )


@pytest.mark.cheap_cases("second-order")
@pytest.mark.parametrize("cone", ["linearised", "second-order"])
def test_the_way_slid_is_the_least_that_the_motion_allows(cone):
    """It is |h J_t v+|, or twice the backward distance; plan and replay keep their complementarity."""
    found = solve(thrown(cone), "exact", Direct(), effort="quick")
    assert found.success
    for suffix, contact in (("", "contact"), ("_replay", "contact_exact")):
        x, lam, gap = (found.data[f"{name}{suffix}"] for name in ("x", "lam", "gap"))
        slid = H * x.values[0, 1:, 2]
        least = np.abs(slid) if cone == "linearised" else np.maximum(0, -2 * slid)
        psi = lam.sel({contact: "ground slip"}).values[0]
        free = lam.sel({contact: "ground"}).values[0] < 1e-6
        assert free.sum() >= N - 1
        np.testing.assert_allclose(psi[free], least[free], atol=1e-9)
        assert np.all(np.abs(lam.values * gap.values) <= 1e-8) and gap.values.min() > -1e-9
        friction = gap.sel({contact: [n for n in gap[contact].values if "slip" not in n]})
        way = [psi + slid, psi - slid] if cone == "linearised" else [psi + 2 * slid]
        np.testing.assert_allclose(friction.values[0, :, 1:].T, way, atol=1e-9)
    assert found.audit.complementarity <= 1e-8
