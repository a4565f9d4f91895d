"""The effort of a solve grows no faster than its horizon, mostly by counted iterations."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from dynamics.contact import Barrier, Exact
from ocp import Solution, solve
from ocp.judge.certificate import certify, tolerance_of
from ocp.judge.lpec import LinearModel
from ocp.programs.solver import Point, Result, Status
from ocp.routes.branches import MAX_BRANCH_ITERATIONS, Branches, second_limit
from ocp.routes.homotopy import Homotopy
from ocp.routes.relaxations import CentralPath
from ocp.solve.solve import new_session
from problems import get


@functools.cache
def softened(steps: int) -> Solution:
    return solve(get("push-disc", N=steps), Barrier(mu=1e-3))


@pytest.mark.costly
def test_a_horizon_twenty_times_as_long_takes_no_more_than_twice_the_iterations() -> None:
    short, long = softened(20), softened(400)
    assert short.success and long.success
    assert all(stage.accepted for stage in long.stages)
    assert long.iterations <= 2 * short.iterations


@pytest.mark.costly
def test_the_exact_answer_is_near_the_barriers_own_at_any_length() -> None:
    """The solve from the exact solution does not push the many small impulses off their bounds."""
    for steps in (20, 400):
        back = [stage for stage in softened(steps).stages if stage.label == "from exact"]
        assert len(back) == 1 and back[0].accepted
        assert back[0].iterations <= 40


def test_the_barrier_below_a_path_falls_as_the_horizon_grows() -> None:
    """The barrier's weight is t/10 up to sixty steps; for more its sum over steps is constant."""
    mu = get("push-disc").natural_scales.mu

    def held(steps: int) -> float:
        path = CentralPath().for_horizon(steps).paths(mu)[0]
        return path.stage_at(path.values[0]).options["mu_target"]

    assert held(0) == held(20) == held(60) == pytest.approx(mu / 10)
    for steps in (120, 600):
        assert steps * held(steps) == pytest.approx(60 * held(60))
    later = CentralPath().for_horizon(600).paths(mu)[0]
    assert later.stage_at(later.values[1]).options["mu_target"] == pytest.approx(later.values[1] / 10)


class Guessing(Branches):
    """Branches of push-1d whose solves take given numbers of iterations, by the number of active pairs."""

    def __init__(self, took: dict[int, int]) -> None:
        session = new_session(get("push-1d", N=4), Exact())
        super().__init__(Homotopy(session.nlp_of, session.solver, session.values))
        self.took, self.given = took, []

    def solve(self, start: Point, active: np.ndarray, max_iterations: int = MAX_BRANCH_ITERATIONS, *_, **__) -> Result:
        count = int(active.sum())
        took = self.took[count]
        self.given.append((count, max_iterations))
        ended = Status.SOLVED if took <= max_iterations else Status.ITERATION_LIMIT
        word, spent = ended.name, min(took, max_iterations)
        found = Result(start, float(count), np.zeros(self.program.m), ended, word, spent, 0.0)
        self.follower.record("active set", 0.0, self.program, found, self.p, self.limits)
        return found


@pytest.mark.parametrize(
    ("took", "most", "taken"),
    [({3: 10**6, 1: 20}, 64, 1), ({3: 10**6, 1: 90}, 256, 1), ({0: 50, 3: 20}, 64, 0)],
)
def test_a_second_guess_is_given_up_soon_after_what_the_first_took(
    took: dict[int, int], most: int, taken: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    branches = Guessing(took)
    first, last = took
    guesses = [np.arange(4) < count for count in (first, last)]
    monkeypatch.setattr(type(branches.program), "active_sets", lambda self, x: guesses)
    found = branches.solve_branch(Point(np.ones(branches.program.n)))
    assert branches.given == [(last, MAX_BRANCH_ITERATIONS), (first, most)]
    assert found is not None and found.f == taken
    assert most == second_limit(took[last]) >= 2 * took[last]


def test_multipliers_a_little_off_need_no_program(monkeypatch: pytest.MonkeyPatch) -> None:
    """An interior-point method leaves a slope at every bound, and a thousand of these add up."""
    session = new_session(get("push-disc"), Barrier(mu=1e-3))
    outcome = session.solve()
    nlp, x, y = outcome.nlp, outcome.result.point.x, outcome.result.point.lam_g
    assert y is not None
    p, bounds = nlp.parameter_vector(session.values), nlp.bounds(session.values)
    model = LinearModel.at(nlp, x, p, bounds)
    off = y + 1e-2 * np.abs(y).max() * np.random.default_rng(0).standard_normal(y.size)
    assert model.dual_bound(off, 1e-3) > tolerance_of(model)
    monkeypatch.setattr(LinearModel, "descend", lambda *_, **__: pytest.fail("a program"))
    assert certify(nlp, x, p, bounds, off).stationarity == "KKT"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["half-cheetah", "hopper-1d", "planar-push", "cart-walls"])
def test_eight_times_the_steps_take_little_more_iterations(name: str) -> None:
    """A horizon of 200 steps takes at most 2.5 times the iterations of one of 24 steps, and is certified.

    The count includes neighbouring contact schedules that were tried, of which a longer plan has more.
    The half-cheetah's certificate over 200 steps may exceed its own limit and stay undecided.
    """
    short, long = (solve(get(name, N=steps), Exact(), effort="quick") for steps in (24, 200))
    assert short.success and long.status in (Status.SOLVED, Status.UNDECIDED)
    assert long.iterations <= 2.5 * short.iterations
