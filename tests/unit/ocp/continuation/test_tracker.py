"""Moves of the tracker from points that are known in closed form, so that no solver runs."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from dynamics.contact import Exact
from ocp import Direct
from ocp.continuation.tracking import MIN_MOVE_SHARE, Tracker
from ocp.judge.certificate import fit_multipliers
from ocp.judge.lpec import LinearModel
from ocp.programs.solver import Point, Result, Status
from ocp.routes.homotopy import RouteResult, Trace
from ocp.routes.session import Session
from ocp.solve.solve import new_session
from tests.unit.ocp.continuation.test_tracking import R, between_walls, pressing

U_FOLD = np.array(3.0) ** -0.5
"""Absolute value of u at the folds of ``theta = u³ - u``."""
FOLD = U_FOLD - U_FOLD**3
"""Absolute value of theta at these folds."""


@cache
def session(name: str) -> Session:
    """Return the session of a problem whose solution is known."""
    problems = {
        "walls": lambda: between_walls(lambda u, _: R * u**2, lambda x, theta: (x - theta) ** 2),
        "pressing": lambda: pressing(1.0),
        "folds": lambda: between_walls(lambda u, t: u**4 / 4 - u**2 / 2 - t * u, lambda x, _: 0 * x, walls=100.0),
    }
    return new_session(problems[name](), Exact(), Direct())


def outcome_at(name: str, theta: float, u: float, push: float = 0.0, walls: float = 1.0) -> RouteResult:
    """Return the outcome at the input u, with the impulse ``push`` of the right wall, and set theta in the session."""
    found = session(name)
    found.values["theta"] = theta
    program, x_next = found.nlp_of("none"), u - push
    blocks = {"x": [[[x_next]]], "u": [[[u]]], "lam": [[[0, push]]], "gap": [[[walls + x_next, walls - x_next]]]}
    x = program.variables.pack({block: np.array(value, dtype=float) for block, value in blocks.items()})
    p, bounds = program.parameter_vector(found.values), program.bounds(found.values)
    f, g = program.values(x, p)
    assert program.largest_violation(x, g, bounds) < 1e-12
    point = Point(x, lam_g=fit_multipliers(LinearModel.at(program, x, p, bounds)))
    return RouteResult(Result(point, f, g, Status.SOLVED, "closed form", 0, 0.0), program, True, Trace())


def tracker_at(name: str, *at: float, log: bool = False, **more: float) -> Tracker:
    tracker = Tracker(session(name), "theta", 3.0, log)
    tracker.start_at(outcome_at(name, *at, **more))
    assert tracker.curve is not None and tracker.value == pytest.approx(at[0])
    return tracker


def input_of(outcome: RouteResult) -> float:
    program = session("walls").nlp_of("none")
    return float(outcome.result.point.x[program.variables["u"].index].item())


def moved_to(tracker: Tracker, theta: float) -> RouteResult:
    """Move a tracker past all events to theta."""
    for _ in range(4):
        outcome = tracker.move_to(theta)
        assert outcome is not None
        if tracker.value == pytest.approx(theta):
            return outcome
    raise AssertionError


@pytest.mark.parametrize("log", [False, True])
def test_a_move_follows_the_solution_and_names_the_contact_that_changes(log: bool) -> None:
    """The solution is u = clip(theta / (1 + r), -1, 1): the right wall is touched at theta = 1 + r."""
    tracker = tracker_at("walls", 0.6, 0.6 / (1 + R), log=log)
    assert input_of(moved_to(tracker, 1.2)) == pytest.approx(1.2 / (1 + R), abs=1e-8)
    assert tracker.events == []
    events = []
    for goal, u in ((2.4, 1.0), (0.3, 0.3 / (1 + R))):
        while tracker.value != pytest.approx(goal):
            outcome = tracker.move_to(goal)
            assert outcome is not None
            events += tracker.events
        assert input_of(outcome) == pytest.approx(u, abs=1e-8)
    assert [(event.kind, event.contact, event.change) for event in events] == [
        ("contact", "contact1", "touches"),
        ("contact", "contact1", "opens"),
    ]
    assert [event.value for event in events] == pytest.approx([1 + R, 1 + R], abs=1e-5)


@pytest.mark.parametrize("log", [False, True])
def test_a_move_that_is_not_corrected_is_halved_four_times(log: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Targets halve the distance in theta, or in its logarithm, down to a sixteenth of it."""
    tracker, targets = tracker_at("walls", 0.1, 0.1 / (1 + R), log=log), []
    curve = tracker.curve
    assert curve is not None
    monkeypatch.setattr(curve, "corrected_point", lambda v, target: targets.append(target * curve.unit))
    assert tracker.move_to(1.6) is None
    shares = 0.5 ** np.arange(len(targets))
    np.testing.assert_allclose(targets, 0.1 * 16.0**shares if log else 0.1 + 1.5 * shares)
    assert shares[-1] in (MIN_MOVE_SHARE, 2 * MIN_MOVE_SHARE), "rounding decides about the last one"
    assert tracker._distance(2.0, 8.0) == tracker._distance(8.0, 2.0) == pytest.approx(np.log(4) if log else 6.0)


def test_folds_are_passed_without_missing_a_point(monkeypatch: pytest.MonkeyPatch) -> None:
    """Stationary points of u⁴/4 - u²/2 - theta u are theta = u³ - u; the path runs from u = -0.6 past both folds."""
    tracker = tracker_at("folds", 0.6 - 0.6**3, -0.6, walls=100.0)
    starts = []
    monkeypatch.setattr(tracker, "_fold", lambda curve, v, *_: starts.append(curve.primal_dual(v)[0][1]) or v)
    stops = [(input_of(stop.outcome), stop.value, len(stop.events)) for stop in tracker.turn_folds(1.0, -2.0, 2.0)]
    inputs, values, folds = np.array(stops).T
    np.testing.assert_allclose(inputs**3 - inputs, values, atol=1e-9)
    assert np.all(np.diff(inputs) > 0) and np.diff(inputs, prepend=-0.6).max() < 0.6, "arcs are at most 0.2 long"
    passed = np.flatnonzero(folds)
    before, after = np.append(-0.6, inputs)[passed], inputs[passed]
    np.testing.assert_allclose(starts, before, err_msg="a fold is sought from the point before it")
    for fold, low, high in zip((-U_FOLD, U_FOLD), before, after, strict=True):
        assert low < fold < high
    edge = before[0] ** 3 - before[0]
    assert tracker.past_fold and values[-2] <= edge < values[-1], "theta is beyond that of the first fold"


@pytest.mark.costly
def test_a_fold_is_where_the_parameter_turns() -> None:
    tracker = tracker_at("folds", 0.62 - 0.62**3, -0.62, walls=100.0)
    stops = tracker.turn_folds(1.0, -2.0, 2.0)
    (event,) = next(stop.events for stop in stops if stop.events)
    assert (event.kind, event.value) == ("fold", pytest.approx(FOLD, abs=1e-9))
    assert event.cost == pytest.approx(U_FOLD**4 / 4 - U_FOLD**2 / 2 + FOLD * U_FOLD, abs=1e-9)


def test_no_fold_before_the_goal_ends_the_arcs_at_the_goal() -> None:
    u = -0.95
    tracker = tracker_at("folds", u**3 - u, u, walls=100.0)
    values = [stop.value for stop in tracker.turn_folds(1.0, -2.0, 0.2)]
    assert not tracker.past_fold
    assert np.all(np.diff(values) > 0) and values[-2] <= 0.2 < values[-1]


def test_arcs_end_before_a_contact_changes() -> None:
    """The right wall, at 1, is touched at theta = 1 + r = 1.5."""
    tracker = tracker_at("walls", 1.4, 1.4 / (1 + R))
    stops = [*tracker.turn_folds(1.0, -2.0, 2.5)]
    assert not tracker.past_fold and not any(stop.events for stop in stops)
    assert 1.5 - 1e-4 < stops[-1].value <= 1.5


@pytest.mark.costly
def test_another_branch_is_cheaper_from_where_the_costs_cross() -> None:
    """In free flight the cost is theta² / 2, pressed against the wall it is 1: they are equal at theta = sqrt(2)."""
    pressed = outcome_at("pressing", 1.7, 1.7, 0.7)
    tracker = tracker_at("pressing", 1.7, 0.85)
    assert tracker.cost(pressed.result.f) == pytest.approx(1.0)
    event = tracker.locate_crossing(pressed, 1.2)
    assert (event.kind, event.value) == ("switch", pytest.approx(np.sqrt(2), abs=1e-6))
    assert event.cost == pytest.approx(1.0, abs=1e-6)
    early = tracker.locate_crossing(pressed, 1.7)
    assert (early.value, early.cost) == (pytest.approx(1.7), pytest.approx(1.0))


def test_a_jump_is_a_point_off_the_tangent() -> None:
    """From theta = 1.2 the free solution is 0.1 further at 1.4; that against the wall is 0.4 further in x."""
    tracker = tracker_at("pressing", 1.2, 0.6)
    assert not tracker.has_jumped(outcome_at("pressing", 1.4, 0.7), 1.4)
    assert not tracker.has_jumped(outcome_at("pressing", 1.4, 0.7 + 0.1), 1.4), "within twice the predicted step"
    assert tracker.has_jumped(outcome_at("pressing", 1.4, 1.4, 0.4), 1.4)
