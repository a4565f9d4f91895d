"""Linear complementarity systems whose contact has no effect on states, or does not depend on them."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from dynamics.batch import RolloutFunction, open_loop
from dynamics.contact import Adaptive, Barrier, Exact, Randomized
from dynamics.contact.affine_step import lcp_solver
from dynamics.systems import lcs
from tests.unit.dynamics.batch.backends import BACKENDS

LAWS = {
    "exact": Exact(),
    "barrier": Barrier(mu=1e-2),
    "adaptive": Adaptive(sigma=0.3),
    "frozen": Adaptive(sigma=0.3, gradient="frozen"),
    "randomized": Randomized(sigma=0.2, samples=4, base=Barrier(mu=1e-2)),
}
ZEROS = [("C",), ("A", "B", "C"), ("D", "E"), ("A", "B", "C", "D", "E")]
SIZES = [(1, 1), (2, 1), (2, 3)]


def matrices(nx: int, nlam: int, zero: tuple[str, ...]) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(4)
    sizes = {"A": (nx, nx), "B": (nx, 1), "C": (nx, nlam), "D": (nlam, nx), "E": (nlam, 1)}
    made = {k: rng.standard_normal(size) * (k not in zero) for k, size in sizes.items()}
    return {**made, "F": 2 * np.eye(nlam) + 0.2 * rng.standard_normal((nlam, nlam))}


@pytest.mark.one_case_in(5)
@pytest.mark.parametrize("law", list(LAWS))
@pytest.mark.parametrize("zero", ZEROS, ids="".join)
@pytest.mark.parametrize(("nx", "nlam"), SIZES)
def test_the_step_is_the_linear_map_and_the_multipliers_solve_the_contact(law, zero, nx, nlam):
    m = matrices(nx, nlam, zero)
    step = LAWS[law].close(lcs("idle", **m))
    x, u = np.linspace(-0.5, 1, nx), np.array([0.4])
    found, lam = (np.array(v)[:, 0] for v in step.map(x, u, step.p.values))
    assert lam.shape == (step.n,)
    if "C" in zero:
        np.testing.assert_allclose(found, m["A"] @ x + m["B"] @ u, atol=1e-14)
    if "randomized" in law:
        assert np.isfinite(lam).all()
        return
    z, F = m["D"] @ x + m["E"] @ u, m["F"]
    mu = np.array(step.data(x, u, step.p.values)[4])[:, 0]
    wanted = np.array(lcp_solver(nlam, step.exact)(z, F, mu)[0])[:, 0]
    np.testing.assert_allclose(lam, wanted, rtol=1e-12)


@pytest.mark.one_case_in(13)
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("zero", ZEROS, ids="".join)
@pytest.mark.parametrize(("nx", "nlam"), SIZES)
def test_rollouts_cost_and_differentiate_what_the_matrices_say(backend, zero, nx, nlam):
    """For C = 0 the cost is quadratic in the inputs, whatever the contact does."""
    m, N = matrices(nx, nlam, zero), 3
    x0, theta = np.linspace(-0.5, 1, nx), np.array([[0.3], [-0.2], [0.5]])
    for law in ("exact", "barrier", "randomized"):
        step = LAWS[law].close(lcs("idle", **m))
        x, u, p = step.system.x, step.system.u, step.p.vector
        stage = ca.Function("stage", [x, u, p], [ca.sumsqr(x) + 0.5 * ca.sumsqr(u)])
        end = ca.Function("end", [x, p], [3 * ca.sumsqr(x - 1)])
        f = RolloutFunction(step, stage, end, N, open_loop(nx, 1), backend=backend)
        got = f(x0, theta)
        state, inputs = ca.SX(ca.DM(x0)), ca.SX.sym("inputs", N)
        if "C" not in zero:
            assert np.isfinite(got.cost).all()
            continue
        cost = ca.SX(0)
        for k in range(N):
            cost += ca.sumsqr(state) + 0.5 * inputs[k] ** 2
            state = ca.SX(ca.DM(m["A"])) @ state + ca.SX(ca.DM(m["B"])) @ inputs[k]
        cost += 3 * ca.sumsqr(state - 1)
        wanted = ca.Function("w", [inputs], [cost, ca.gradient(cost, inputs)])(theta)
        np.testing.assert_allclose(got.cost[0], float(wanted[0]), rtol=1e-13)
        gradient = np.array(ca.densify(wanted[1]))
        np.testing.assert_allclose(got.gradient[0], gradient, rtol=1e-12, atol=1e-14)
