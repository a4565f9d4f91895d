"""Exchange of contact schedules for neighbouring ones, and other starts."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynamics.contact import Exact
from ocp.programs.solver import Point, Result
from ocp.routes.branches import Branches
from ocp.routes.complementarity import RelaxationPlan, by_strategy
from ocp.routes.homotopy import Homotopy
from ocp.routes.relaxations import CentralPath
from ocp.routes.schedules import ScheduleMove, apply_move, improve_schedule, moves, predicted_gains, runs
from ocp.solve.solve import new_session, solve
from problems import get
from tests.benchmarks.ocp.random_draws import drawn
from tests.findings import codes

WALLS = {
    "mc": 2.2205,
    "mp": 0.0932,
    "l": 0.4108,
    "wall": 0.3335,
    "k": 106.0,
    "h": 0.033,
    "w_end": 90.53,
    "u_max": 2.3294,
}


@given(st.lists(st.booleans(), min_size=1, max_size=12))
def test_runs_tile_what_is_held(held: list[bool]) -> None:
    found = runs(np.array(held))
    covered = np.zeros(len(held), dtype=bool)
    for begin, end in found:
        assert begin < end and not covered[begin:end].any()
        covered[begin:end] = True
    np.testing.assert_array_equal(covered, held)
    assert all(later[0] > earlier[1] for earlier, later in itertools.pairwise(found))


@given(st.lists(st.booleans(), min_size=3, max_size=9))
def test_moves_change_one_chain_and_are_undone_by_their_opposite(held: list[bool]) -> None:
    chains = np.arange(2 * len(held)).reshape(2, -1)
    active = np.array(held + [False] * len(held))
    for move in moves(active, chains):
        changed = apply_move(active, chains, move)
        assert changed is not None and not changed[chains[1]].any()
        assert abs(int(changed.sum()) - int(active.sum())) <= 2
        alone = len(runs(active)) == len(runs(changed)) == 1
        inside = runs(changed) and runs(changed)[0][0] > 0 and runs(changed)[-1][1] < len(held)
        if alone and inside and runs(active)[0][0] > 0:
            back = ScheduleMove(move.chain, move.run, -move.begins, -move.ends)
            np.testing.assert_array_equal(apply_move(changed, chains, back), active)


def every_branch(name: str, steps: int) -> tuple[Branches, dict[bytes, Result]]:
    """Solve all 2^pairs branches of a short problem from its guess; return those that converge."""
    session = new_session(get(name, N=steps), Exact())
    branches = Branches(Homotopy(session.nlp_of, session.solver, session.values))
    start = Point(session.first_point(branches.program).x)
    found = {}
    for bits in itertools.product([False, True], repeat=branches.program.pairs.shape[1]):
        active = np.array(bits)
        result = branches.solve(start, active, mu_init=1e-2)
        if result.ok:
            found[active.tobytes()] = result
    return branches, found


@pytest.mark.costly
@pytest.mark.parametrize(
    "name",
    ["wall-1d", *(pytest.param(x, marks=pytest.mark.slow) for x in ("ball-bounce", "push-1d"))],
)
def test_any_schedule_with_a_contact_is_led_to_the_best_of_all(name: str) -> None:
    branches, found = every_branch(name, 5)
    lowest = min(result.f for result in found.values())
    highest = max(result.f for key, result in found.items() if any(key))
    assert highest > 1.005 * lowest
    for key, result in found.items():
        if any(key):
            assert improve_schedule(branches, result).f <= lowest + 2e-5 * abs(lowest)


@pytest.mark.costly
def test_exchanged_schedules_find_what_a_relaxation_alone_does_not() -> None:
    *_, instance = drawn("cart-transport", 6, 0, factor=2.0)
    session = new_session(get(instance.problem, **instance.params), Exact())
    follower = Homotopy(session.nlp_of, session.solver, session.values)
    plan = RelaxationPlan(CentralPath(), session.problem.natural_scales.mu, session.first_point)
    alone = by_strategy(follower, plan, plan.strategy).result.f
    found = solve(get(instance.problem, **instance.params), Exact())
    assert found.success and found.cost < 0.9 * alone


@pytest.mark.costly
def test_exchange_knows_no_size_and_begins_where_multipliers_promise_most() -> None:
    """Of planar-hand's 160 pairs one of the five with the steepest predicted gain lowers the cost."""
    session = new_session(get("planar-hand"), Exact())
    branches = Branches(Homotopy(session.nlp_of, session.solver, session.values))
    assert branches.program.pairs.shape[1] > 128
    plan = RelaxationPlan(CentralPath(), session.problem.natural_scales.mu, session.first_point)
    polished = by_strategy(branches.follower, plan, plan.strategy).result
    best = branches.improve(polished)
    found = improve_schedule(branches, best)
    assert found.ok and found.f < 12.2712 < 12.2918 < best.f
    active = branches.program.active_sets(best.point.x)[-1]
    fall, way = predicted_gains(branches, best, active)
    steepest = np.argsort(-fall / way)
    paid = next(rank for rank, pair in enumerate(steepest) if _flipped(branches, best, pair))
    assert paid < 5 < np.count_nonzero(fall)


def _flipped(branches: Branches, best: Result, pair: int) -> bool:
    """Return whether the branch with one pair on its other side costs less."""
    active = apply_move(branches.program.active_sets(best.point.x)[-1], branches.program.chains, pair)
    assert active is not None
    found = branches.solve(best.point, active)
    return found.ok and found.f < best.f * (1 - 1e-5)


@pytest.mark.slow
def test_several_starts_take_other_relaxations_and_reach_other_minima() -> None:
    found = solve(get("cart-walls", **WALLS), Exact(), n_starts=2)
    assert found.success and found.cost == pytest.approx(289.151, rel=1e-5)


def test_a_users_limit_of_time_is_said_where_it_cut() -> None:
    free = solve(get("wall-1d"), Exact())
    cut = solve(get("wall-1d"), Exact(), settings={"max_wall_time": 1e-9}, effort="quick")
    assert "time-limit" not in codes(free)
    assert "time-limit" in codes(cut) and not cut.success
