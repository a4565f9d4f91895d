"""Compiled rollouts of candidates agree with those in NumPy, and with their definition."""

from __future__ import annotations

import numpy as np
import pytest

from ocp.mpc.controller import Controller
from ocp.mpc.newton_phase import ALL_SHARES
from ocp.mpc.rollouts import CandidateRollouts
from ocp.mpc.stages import Plan
from problems import get


def candidates_of(controller: Controller, n: int) -> tuple[CandidateRollouts, Plan, list[np.ndarray]]:
    """Return rollouts, the first n steps of the first plan, and K, x, u, dx, du and shares of candidates around it."""
    rng, sizes, plan = np.random.default_rng(0), controller.problem.scales, controller.current_plan
    nu, nx = len(sizes.u), len(sizes.x)
    gains = 0.1 * (sizes.u[:, None] / sizes.x) * rng.standard_normal((n, nu, nx))
    dx, du = (0.1 * size * rng.standard_normal((steps, len(size))) for steps, size in ((n + 1, sizes.x), (n, sizes.u)))
    return controller.rollouts, plan, [gains, plan.x[: n + 1], plan.u[:n], dx, du, ALL_SHARES]


@pytest.mark.costly_cases("finger-disc", "planar-push")
@pytest.mark.parametrize("name", ["soft-walls", "finger-disc", "planar-push"])
def test_compiled_rollouts_equal_those_in_numpy(name: str) -> None:
    """The shorter horizon of a tracked plan has its rollouts as well."""
    controller = Controller(get(name))
    limits, n = controller._horizon[2], 5
    rollouts, plan, arrays = candidates_of(controller, n)
    p = controller._horizon[1][: n + 1]
    results = []
    for is_compiled in (True, False):
        if not is_compiled:
            rollouts.__dict__["_compiled"] = None
        assert (rollouts._compiled is not None) == is_compiled
        K, k = rollouts.steer(*arrays)
        rolled = rollouts.roll_out(plan.x[0], K, k, controller.u_before, (limits[2], limits[3]), p, 200.0)
        results.append((K, k, rolled))
    (K, k, compiled), (K_numpy, k_numpy, interpreted) = results
    assert compiled.best == interpreted.best
    pairs = [(K, K_numpy), (k, k_numpy), (compiled.states, interpreted.states), (compiled.merit, interpreted.merit)]
    pairs += [(getattr(compiled.plan, name), getattr(interpreted.plan, name)) for name in ("x", "u", "lam", "gap")]
    for first, second in pairs:
        assert np.max(np.abs(first - second)) <= 1e-9 * (1 + np.max(np.abs(second)))


def test_candidates_without_change_and_with_feedback_roll_out_the_plan() -> None:
    """The plan is a rollout of its own inputs from its own start, and feedback then adds nothing."""
    controller = Controller(get("soft-walls"))
    rollouts, plan, (gains, x, u, dx, du, _) = candidates_of(controller, controller.model.N)
    _, p, limits = controller._horizon
    K, k = rollouts.steer(gains, x, u, 0 * dx, 0 * du, ALL_SHARES[:2])
    states = rollouts.roll_out(x[0], K, k, controller.u_before, (limits[2], limits[3]), p).states
    assert np.abs((states - plan.x) / controller.problem.scales.x).max() < 1e-6
