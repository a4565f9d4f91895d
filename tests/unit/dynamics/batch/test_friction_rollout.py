"""Rollouts with friction and curved gaps: all backends agree with CasADi and with differences."""

from __future__ import annotations

import functools

import casadi as ca
import numpy as np
import pytest

from dynamics.batch import BatchWarning, Gaussian, RolloutFunction
from dynamics.batch.graphs.policy import open_loop
from dynamics.contact import Barrier, Exact, Randomized, Step
from dynamics.systems import (
    ContactSystem,
    ParameterTable,
    signals,
    time_stepping,
)
from tests.unit.dynamics.batch.backends import BACKENDS

H = 6


@functools.cache
def tossed_rod(law: str) -> Step:
    """Return the step of a rod (x, z, angle) with a foot at one end, which lands, slips and turns."""

    def foot(q: ca.SX) -> ca.SX:
        return ca.vertcat(q[0] + 0.4 * ca.sin(q[2]), q[1] - 0.4 * ca.cos(q[2]))

    system = time_stepping(
        "rod",
        states=signals("x [m]; z [m]; a [rad]; vx [m/s]; vz [m/s]; va [rad/s]"),
        inputs=signals("fx [N]; fz [N]"),
        contacts=signals("foot [N s]"),
        h=0.05,
        mass=ca.diag(ca.SX([1.0, 1.0, 0.1])),
        impulse=lambda q, v, u: 0.05 * ca.vertcat(u[0], u[1] - 9.81, 0),
        distance=lambda q: foot(q)[1],
        sliding=lambda q: ca.jacobian(foot(q)[0], q),
        friction=0.1,
        parameters=ParameterTable(),
    )
    laws = {
        "exact": Exact(),
        "barrier": Barrier(mu=1e-4),
        "randomized": Randomized(sigma=0.5, samples=2, base=Barrier(mu=1e-4)),
    }
    return laws[law].close(system)


def rollout(law: str, backend: str) -> RolloutFunction:
    step = tossed_rod(law)
    x, u, p = step.system.x, step.system.u, step.p.vector
    stage = ca.Function("stage", [x, u, p], [1e-2 * ca.sumsqr(u) + x[0] ** 2])
    end = ca.Function("end", [x, p], [ca.sumsqr(x - 0.5)])
    policy = open_loop(step.system.nx, step.system.nu)
    return RolloutFunction(step, stage, end, H, policy, backend=backend)


START = np.array([0.0, 0.42, 0.3, 1.5, -0.2, 0.4])
THETA = np.tile([0.8, -0.5], (H, 1))


@pytest.mark.cheap_cases("barrier-c")
@pytest.mark.parametrize("backend", [b for b in BACKENDS if b != "casadi"])
@pytest.mark.parametrize("law", ["exact", "barrier", "randomized"])
def test_backends_agree_with_casadi(law, backend):
    given = {"noise": Gaussian(0.3, seed=2), "n_samples": 9}
    wanted = rollout(law, "casadi")(START, THETA, **given)
    got = rollout(law, backend)(START, THETA, **given)
    np.testing.assert_allclose(got.cost, wanted.cost, rtol=1e-13)
    scale = np.abs(wanted.gradient).max()
    np.testing.assert_allclose(got.gradient, wanted.gradient, rtol=1e-12, atol=1e-13 * scale)


@pytest.mark.costly
@pytest.mark.parametrize("law", ["exact", "barrier"])
def test_gradients_are_those_of_differences(law):
    f = rollout(law, "numpy")
    got = f(START, THETA, n_samples=1).gradient[0]
    for k in range(H):
        for i in range(2):
            ends = []
            for sign in (1, -1):
                moved = THETA.copy()
                moved[k, i] += sign * 1e-5
                ends.append(f(START, moved, n_samples=1, gradient=False).cost[0])
            np.testing.assert_allclose(got[k, i], (ends[0] - ends[1]) / 2e-5, rtol=1e-5, atol=1e-7)


def test_the_foot_lands_and_slips():
    step = tossed_rod("exact")
    x, slipped, landed = START, 0.0, 0
    for u in THETA:
        x, lam, _, error = (np.array(v).ravel() for v in step.solve(x, u, step.p.values))
        assert error.max() < 1e-10
        landed += lam[0] > 1e-6
        slipped = max(slipped, lam[3] if lam[0] > 1e-6 else 0.0)
    assert landed >= 2
    assert slipped > 1e-4


@pytest.mark.cheap_cases("0.0-c", "0.0-numpy")
@pytest.mark.parametrize("backend", [b for b in BACKENDS if b != "casadi"])
@pytest.mark.parametrize("curved", [0.0, 1e-3])
def test_a_contact_that_is_not_solved_is_reported(backend, curved):
    """Two contacts attract each other, so that for large gaps no impulse solves both."""
    x, x_next = ca.SX.sym("x", 2), ca.SX.sym("x_next", 2)
    u, lam = ca.SX.sym("u", 2), ca.SX.sym("lam", 2)
    system = ContactSystem(
        name="hopeless",
        x=x,
        u=u,
        x_next=x_next,
        lam=lam,
        residual=x_next - x - u - lam,
        gap=x_next - 3 * ca.vertcat(lam[1], lam[0]) - curved * x_next**2,
        states=signals("a [m]; b [m]"),
        inputs=signals("c [m]; d [m]"),
        contacts=signals("e [N s]; f [N s]"),
        h=1.0,
    )
    step = Barrier(mu=1e-4).close(system)
    cost = ca.Function("cost", [x, u, step.p.vector], [ca.sumsqr(x)])
    end = ca.Function("end", [x, step.p.vector], [ca.sumsqr(x)])
    f = RolloutFunction(step, cost, end, 1, open_loop(2, 2), backend=backend)
    starts = np.array([[1.0, 1.0], [-1.0, -1.0], [1.0, 1.0]])
    with pytest.warns(BatchWarning, match="1 non-finite sample, at index 1"):
        got = f(starts, np.zeros((1, 2)))
    assert list(got.nonfinite.indices) == [1]
