"""A stored plan is tracked: its own inputs and cost, Bellman's inequality, and shorter horizons in one program."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
import xarray as xr

from ocp import Solution, roll_out, solve
from ocp.errors import InputError
from ocp.mpc import Controller, Disturbance, simulate
from ocp.mpc.horizon_qp import HorizonQP
from ocp.mpc.stages import Plan
from problems import get
from tests.unit.ocp.mpc.test_stages import Horizon

NAMES = ["wall-1d", "push-1d", "cart-walls"]


@cache
def solved(name: str) -> Solution:
    return solve(get(name), "exact")


@dataclass
class Stored:
    """Arrays of a plan."""

    data: xr.Dataset

    @classmethod
    def of(cls, x: np.ndarray, u: np.ndarray) -> Stored:
        return cls(xr.Dataset({"x": (("s", "node", "state"), x), "u": (("s", "interval", "input"), u)}))


@pytest.mark.costly
@pytest.mark.parametrize("phase", ["qpcc", "policy"])
@pytest.mark.parametrize("name", NAMES)
def test_from_its_own_start_the_plan_is_followed(name: str, phase: str) -> None:
    """Bellman: every rest of an optimal plan is optimal, so that the loop's inputs and cost are the plan's."""
    solution = solved(name)
    loop = simulate(Controller(solution.problem, phase=phase, plan=solution), solution.problem.N)
    assert abs(loop.data["u"].values - solution.data["u"].values).max() < 1e-6
    assert loop.costs[0] == pytest.approx(solution.cost, rel=1e-9)
    assert loop.verdict.status == "done"


@pytest.mark.costly
@pytest.mark.parametrize("name", NAMES)
def test_the_loop_costs_at_most_a_plan_that_is_not_optimal(name: str) -> None:
    """No plan is worse than the rest of the one before, so that the costs of the samples sum to at most the plan's."""
    solution = solved(name)
    problem = solution.problem
    rng = np.random.default_rng(0)
    off = 0.1 * problem.scales.u * rng.standard_normal((1, problem.N, problem.system.nu))
    limits = problem.limits(problem.parameters.values)[2:4]
    u = np.clip(solution.data["u"].values + off, *(limit.full().ravel() for limit in limits))
    rolled = roll_out(problem, u, solution.values)
    loop = simulate(Controller(problem, plan=Stored.of(rolled.x, rolled.u)), problem.N)
    assert solution.cost * (1 - 1e-9) <= loop.costs[0] < rolled.cost
    assert np.isfinite(loop.data["plan"].values[0, -1, :2]).all()
    assert np.isnan(loop.data["plan"].values[0, -1, 2:]).all(), "one step is left at the last sample"


@pytest.mark.costly
@pytest.mark.parametrize("name", ["cart-walls", "push-disc"])
def test_after_a_push_it_ends_nearer_than_the_plans_inputs(name: str) -> None:
    solution = solved(name)
    problem, u = solution.problem, solution.data["u"].values[0]
    push = Disturbance(pushes={3: 0.1 * problem.scales.x})
    tracked = simulate(Controller(problem, plan=solution), problem.N, disturbance=push)
    open_loop = Controller(problem, phase="policy", policy=lambda x, k: u[k])
    followed = simulate(open_loop, problem.N, disturbance=push)
    assert tracked.data["end_cost"].values[0] < 0.1 * followed.data["end_cost"].values[0]
    assert tracked.costs[0] < followed.costs[0]


@pytest.mark.costly
def test_after_a_push_the_rest_is_the_optimum_of_a_shorter_problem() -> None:
    solution = solved("soft-walls")
    controller = Controller(solution.problem, plan=solution, iterations=20)
    x = solution.data["x"].values[0]
    for k in range(3):
        controller.step(x[k])
    pushed = x[3] + [0.02, 0.05, -0.1, 0.1]
    command = controller.step(pushed)
    start = dict(zip(("p0", "theta0", "dp0", "dtheta0"), pushed.tolist(), strict=True))
    shorter = solve(get("soft-walls", N=17, **start), "exact")
    assert command.plan is not None and len(command.plan.u) == 17
    assert command.merit == pytest.approx(shorter.cost, rel=1e-7)
    assert command.u == pytest.approx(shorter.data["u"].values[0, 0], abs=1e-4)


@pytest.mark.costly
@pytest.mark.parametrize(("name", "n"), [("soft-walls", 12), ("finger-disc", 7)])
def test_a_shorter_horizon_has_the_program_of_a_shorter_problem(name: str, n: int) -> None:
    made, short = Horizon(name, 0), Horizon(name, 0, N=n)
    plan, p = made.plan, made.p[: n + 1]
    rest = Plan(plan.x[: n + 1], plan.u[:n], plan.lam[:n], plan.gap[:n])
    made.p = p
    _, lin = made.linearised(rest)
    dx0, bounds = 0.01 * made.problem.scales.x, (np.full(rest.u.shape, -0.1), np.full(rest.u.shape, 0.1))
    programs = (HorizonQP(model, model.m).solve(lin, lin.rows, dx0, bounds) for model in (made.model, short.model))
    long, exact = programs
    sizes = made.problem.scales
    assert long.solved and exact.solved
    assert abs((long.du - exact.du) / sizes.u).max() < 1e-4
    assert abs((long.dx - exact.dx) / sizes.x).max() < 1e-4
    assert (long.costates.shape, long.rows.shape) == (exact.costates.shape, exact.rows.shape)


@pytest.mark.costly
@pytest.mark.parametrize("phase", ["qpcc", "qp"])
def test_gains_that_are_read_between_samples_change_no_sample(phase: str) -> None:
    """The exchange of contacts that waits for the next sample is not that of the gains."""
    problem, loops = get("spinner"), []
    for is_read in (False, True):
        controller = Controller(problem, phase=phase)
        x, inputs = controller.start, []
        for _ in range(12):
            command = controller.step(x)
            assert command.plan is not None
            x = command.plan.x[1] + 0.01
            inputs.append(command.u)
            if is_read:
                assert controller.gains is not None
        loops.append(np.array(inputs))
    assert loops[0].tobytes() == loops[1].tobytes()


@pytest.mark.costly
def test_plans_that_cannot_be_tracked_get_one_sentence() -> None:
    problem = get("soft-walls", N=5)
    x, u = np.zeros((1, 6, 4)), np.zeros((1, 5, 1))
    with pytest.raises(InputError, match="the plan has 4 steps of 4 states and 1 inputs, but soft-walls has 5 steps"):
        Controller(problem, plan=Stored.of(x[:, 1:], u[:, 1:]))
    with pytest.raises(InputError, match="the plan has values that are not finite"):
        Controller(problem, plan=Stored.of(np.full_like(x, np.nan), u))
    with pytest.raises(InputError, match="plan must be a solution or a stored run"):
        Controller(problem, plan=3)  # pyright: ignore[reportArgumentType]
    with pytest.raises(InputError, match="phase full plans whole steps of the whole horizon"):
        Controller(problem, phase="full", plan=Stored.of(x, u))
    controller = Controller(problem, plan=Stored.of(x, u))
    with pytest.raises(InputError, match="the tracked plan ends after 5 samples; simulate at most that many, not 6"):
        simulate(controller, 6)
    with pytest.raises(InputError, match="certificates are of plans over the whole horizon"):
        simulate(controller, 5, certify=1)
    simulate(controller, 5)
    with pytest.raises(InputError, match="the plan ends after 5 samples; reset the controller"):
        controller.step(x[0, 0])
