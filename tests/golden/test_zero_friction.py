"""Friction of zero at one of several contacts agrees with a frictionless contact."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from dynamics.contact import Barrier
from dynamics.systems import (
    ContactSystem,
    Parameter,
    ParameterTable,
    quasi_dynamic,
    signals,
    time_stepping,
)
from problems.bodies.half_cheetah.machine import half_cheetah
from tests.golden.test_most_exact_contact import MASS, REACH, H, R, pushed_disc, step


def two_blocks(friction: ca.SX, cone, table: ParameterTable) -> ContactSystem:
    """Return the system of two unit masses on a floor, q = (x1, z1, x2, z2), each pushed by one force."""
    return time_stepping(
        "blocks",
        states=signals("x1 [m]; z1 [m]; x2 [m]; z2 [m]; vx1 [m/s]; vz1 [m/s]; vx2 [m/s]; vz2 [m/s]"),
        inputs=signals("f1 [N]; f2 [N]"),
        contacts=signals("one [N s]; two [N s]"),
        mass=ca.SX.eye(4),
        impulse=lambda q, v, u: H * ca.vertcat(u[0], -10, u[1], -10),
        distance=lambda q: q[[1, 3]],
        friction=friction,
        cone=cone,
        sliding=lambda q: ca.SX([[1.0, 0, 0, 0], [0, 0, 1.0, 0]]),
        h=H,
        parameters=table,
    )


@pytest.mark.one_case_in(2)
@pytest.mark.parametrize("cone", ["linearised", "second-order"])
@pytest.mark.parametrize("by_parameter", [False, True])
def test_friction_may_be_zero_at_one_of_several_contacts(cone, by_parameter: bool) -> None:
    table = ParameterTable([Parameter("f", 0.0)]) if by_parameter else ParameterTable()
    zero = table["f"] if by_parameter else ca.SX(0)
    system = two_blocks(ca.vertcat(0.5, zero), cone, table)
    u = np.array([8.0, 8.0])
    x_next, lam, _ = step(system, np.zeros(8), u)
    np.testing.assert_allclose(x_next[4:], [H * (8 - 5), 0, H * 8, 0], atol=1e-8)
    normal, tangential, slip = forces_at(system, np.zeros(8), u, x_next, lam)
    np.testing.assert_allclose(normal, H * 10, rtol=1e-8)
    np.testing.assert_allclose(tangential, [-H * 5, 0.0], atol=1e-8)
    np.testing.assert_allclose(slip, [H * 3, H * 8], atol=1e-8)
    closed = Barrier(mu=1e-4).close(system)
    given = np.zeros(8), u, closed.p.values
    by_input = np.array(closed.map.jacobian()(*given, *closed.map(*given))[1])
    assert np.all(np.isfinite(by_input[4:]))
    assert by_input[6, 1] == pytest.approx(H, rel=1e-6), "nothing holds the smooth block back"


def forces_at(system: ContactSystem, x, u, x_next, lam) -> list[np.ndarray]:
    f = system.forces
    assert f is not None
    symbols = [system.x, system.u, system.x_next, system.lam, system.parameters.vector]
    function = ca.Function("forces", symbols, [f.normal, f.tangential, f.slip])
    return [np.array(v).ravel() for v in function(x, u, x_next, lam, system.parameters.values)]


@pytest.mark.costly
def test_zero_friction_by_a_parameter_is_the_frictionless_machine() -> None:
    table = ParameterTable([Parameter("f", 0.0)])
    kept = {"h": 0.02, "spheres": ("bfoot", "ffoot")}
    rubbing_not, smooth = (
        half_cheetah().system("cheetah", table, friction=friction, **kept) for friction in (table["f"], None)
    )
    x = np.zeros(smooth.nx)
    x[1], x[9:12] = 0.45, [1.0, -3.0, 2.0]
    one, other = (step(system, x, np.zeros(6))[0] for system in (rubbing_not, smooth))
    np.testing.assert_allclose(one, other, atol=1e-8)


def test_convex_rows_take_a_zero_friction_too() -> None:
    """Both edges of a cone without friction are the same contact twice."""
    table = ParameterTable([Parameter("f", 0.0)])
    base = pushed_disc()
    smooth = quasi_dynamic(
        "smooth",
        states=base.states,
        inputs=base.inputs,
        contacts=signals("push [N s]"),
        h=H,
        mass=ca.SX(ca.DM(MASS[:3, :3])),
        stiffness=50.0 * ca.SX.eye(2),
        parameters=table,
        distance=lambda q: ca.norm_2(q[:2] - q[3:]) - REACH,
        friction=table["f"],
        sliding=lambda q: ca.SX([[0, 1.0, R, 0, -1.0]]),
        linearised=True,
    )
    x, u = np.array([REACH, 0, 0, 0, 0.0]), np.array([0.2, 0.1])
    for system in (smooth, smooth.most_exact):
        x_next = step(system, x, u)[0]
        assert x_next[2] == pytest.approx(0.0, abs=1e-8), "nothing turns the disc"
        assert x_next[0] > REACH + 0.01
