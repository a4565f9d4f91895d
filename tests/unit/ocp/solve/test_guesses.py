"""Guesses of users: keyframes, drawn paths, contact schedules, runs of other problems."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import problems
from dynamics.contact import Barrier
from ocp import InputError, Sketch, roll_out, solve
from ocp.problem.evaluation import Evaluation
from ocp.search.other_routes import GuessSearch
from ocp.solve.guesses import GuessLike, user_guess_of
from ocp.solve.judging import judge_outcome
from ocp.solve.solve import begin_at, new_session
from tests.golden.cases.test_plans_worth_having import nail

N = 20


def evaluation(name: str, **params: Any) -> Evaluation:
    problem = problems.get(name, **params)
    return Evaluation(problem, problem.parameters.defaults)


def test_states_pass_their_keyframes_and_lie_on_straight_lines_between_them() -> None:
    at = evaluation("push-disc", N=N)
    pose = np.array([0.3, 0.1, -0.4, 0.2])
    states, inputs = user_guess_of({5: pose, 15: {"ox": 0.9}}, at.problem, at.values).trajectories
    np.testing.assert_allclose(states[5], pose)
    np.testing.assert_allclose(states[5:16, 0], np.linspace(0.3, 0.9, 11))
    np.testing.assert_array_equal(states[15:, 0], 0.9)
    np.testing.assert_array_equal(states[0], at.initial_states[0])
    np.testing.assert_array_equal(states[5:, 1:], np.tile(pose[1:], (N - 4, 1)))
    np.testing.assert_array_equal(inputs, at.initial_guess[1])


def test_velocities_are_differences_of_the_positions_that_are_given() -> None:
    at = evaluation("ball-bounce")
    h, names = at.node_times()[1], [signal.name for signal in at.problem.system.states]
    states, _ = user_guess_of({10: {"x": 0.5}}, at.problem, at.values).trajectories
    x, y, vx, vy = (names.index(name) for name in ("x", "y", "vx", "vy"))
    assert states[10, x] == 0.5
    np.testing.assert_allclose(states[1:, vx], np.diff(states[:, x]) / h, atol=1e-12)
    np.testing.assert_array_equal(states[:, [y, vy]], at.initial_guess[0][:, [y, vy]])


@pytest.mark.parametrize("count", [2, 3, N + 1, 7 * N + 1])
def test_a_drawn_path_is_spread_evenly_over_the_horizon(count: int) -> None:
    at = evaluation("push-disc", N=N)
    line = np.linspace(0.0, 1.0, count)
    marks = Sketch(paths={"ox": line}, keyframes={N: {"ox": 0.7}}).marks(at.problem)[:, 0]
    steps = np.flatnonzero(~np.isnan(marks))
    assert len(steps) == min(count, N + 1)
    np.testing.assert_allclose(marks[steps[:-1]], steps[:-1] / N)
    assert marks[N] == 0.7


REFUSED: dict[str, tuple[Any, Any, str]] = {
    "state": (Sketch, {"keyframes": {3: {"oz": 1.0}}}, "unknown state 'oz'"),
    "step": (Sketch, {"keyframes": {N + 1: {"ox": 1.0}}}, "has steps 0 to 20, got 21"),
    "step's kind": (Sketch, {"keyframes": {"five": {"ox": 1.0}}}, "must be a number, got 'five'"),
    "shape": (Sketch, {"keyframes": {3: [1.0, 2.0]}}, "must have 4 states, ox, oy, ax, ay; got (2,)"),
    "no number": (Sketch, {"keyframes": {3: {"ox": "far"}}}, "ox must be a number, got 'far'"),
    "not finite": (Sketch, {"keyframes": {3: {"ox": np.nan}}}, "ox must be a finite number"),
    "start": (Sketch, {"keyframes": {0: {"ox": 1.0}}}, "the guess has ox = 1 at step 0, where it must be 0"),
    "nothing": (dict, {}, "is empty"),
    "short path": (Sketch, {"paths": {"ox": [1.0]}}, "two or more numbers"),
    "contact": (Sketch, {"contacts": {"pull": [(1, 2)]}}, "unknown contact 'pull'"),
    "range": (Sketch, {"contacts": {"push": [(1, 2, 3)]}}, "contacts['push'][0]"),
    "range's step": (Sketch, {"contacts": {"push": [(1, 99)]}}, "got 99"),
    "empty range": (Sketch, {"contacts": {"push": [(9, 3)]}}, "9 to 3 is empty"),
}


@pytest.mark.parametrize(("kind", "parts", "said"), REFUSED.values(), ids=REFUSED)
def test_a_sketch_that_does_not_fit_is_refused(kind: Any, parts: dict[str, Any], said: str) -> None:
    at = evaluation("push-disc", N=N)
    with pytest.raises(InputError) as told:
        user_guess_of(kind(**parts), at.problem, at.values)
    assert said in str(told.value)


def test_contacts_that_nothing_would_seek_are_refused() -> None:
    contacts = Sketch(contacts={"push": [(1, 2)]})
    for law, search in ((Barrier(mu=1e-2), None), ("exact", False)):
        with pytest.raises(InputError, match="need the exact law"):
            solve("push-disc", law, guess=contacts, search=search)


def search_near(guess: GuessLike) -> GuessSearch:
    session = begin_at(new_session(nail(), "exact"), guess, None, "quick")
    assert session.user_guess is not None
    return GuessSearch(session, judge_outcome, guess=session.user_guess)


@pytest.mark.costly
def test_a_schedule_is_solved_with_the_contacts_that_it_asks_for() -> None:
    (outcome,) = search_near(Sketch(contacts={"hammer on nail": [(33, 38)]})).within_windows()
    assert outcome.finished
    blocks = outcome.nlp.variables.unpack(outcome.result.point.x)
    closed = np.isin(np.arange(1, 41), np.arange(33, 39))
    np.testing.assert_array_equal(blocks["gap"][0, closed, 0], 0.0)
    np.testing.assert_array_equal(blocks["lam"][0, ~closed, 0], 0.0)


@pytest.mark.costly
@pytest.mark.parametrize(
    ("guess", "cost"),
    [
        ({20: {"hammer": -0.15}}, 0.0271),
        ({20: {"hammer": -0.1}, 34: {"hammer": 0.05}}, 0.029),
        (Sketch(contacts={"hammer on nail": [(33, 38)]}), 0.0297),
    ],
    ids=["drawn back", "drawn back and struck", "schedule"],
)
def test_a_sketch_leads_to_a_blow_that_the_usual_route_misses(guess: GuessLike, cost: float) -> None:
    solution = solve(nail(), "exact", guess=guess, effort="quick")
    assert solution.certificate.certified
    assert solution.cost < cost
    assert solution.route.name == "guess"


@pytest.mark.costly
def test_a_sketch_that_no_plan_passes_is_told_and_costs_nothing() -> None:
    solution = solve(nail(), "exact", guess={5: {"hammer": -0.9}}, effort="quick")
    assert solution.certificate.certified
    assert "found no answer: no plan was found that passes the keyframes of the guess" in solution.verdict


@pytest.mark.costly
def test_an_answer_is_never_worse_than_the_rollout_of_its_guess() -> None:
    problem = nail()
    blow = np.where(np.arange(problem.N) < 11, -5.0, 10.0)[:, None]
    rolled = roll_out(problem, blow[None], problem.parameters.defaults)
    solution = solve(problem, "exact", guess=(rolled.x[0], blow), effort="quick")
    assert solution.audit.exact_cost <= rolled.cost


def test_a_run_of_another_problem_gives_what_has_the_same_name() -> None:
    longer = evaluation("push-disc", N=2 * N)
    run = solve("push-disc", N=N, effort="quick").data
    at = evaluation("push-disc", N=2 * N, h=longer.node_times()[1] / 2)
    resampled, _ = user_guess_of(run, at.problem, at.values).trajectories
    np.testing.assert_allclose(resampled[::2], run["x"].values[0])
    renamed = run.assign_coords(state=["ox", "b", "c", "ay"], control=["p", "q"])
    shared, own_inputs = user_guess_of(renamed, at.problem, at.values).trajectories
    np.testing.assert_allclose(shared[::2, [0, 3]], run["x"].values[0][:, [0, 3]])
    np.testing.assert_array_equal(shared[:, 1], at.initial_guess[0][:, 1])
    np.testing.assert_array_equal(own_inputs, at.initial_guess[1])
    strangers = run.assign_coords(state=["a", "b", "c", "d"], control=["p", "q"])
    with pytest.raises(InputError, match="no name in common"):
        user_guess_of(strangers, at.problem, at.values)
