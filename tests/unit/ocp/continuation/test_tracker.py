"""Moves of the tracker from points that are known in closed form, so that no solver runs."""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from dynamics.contact import Exact
from ocp import Direct
from ocp.continuation import continue_over
from ocp.continuation.tracking import MIN_MOVE_SHARE, Tracker
from ocp.continuation.walk import _Walk
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


@pytest.mark.parametrize(("log", "start", "goal", "change"), [(False, 1.2, 2.4, "touches"), (True, 1.9, 0.9, "opens")])
def test_a_move_follows_the_solution_and_names_the_contact_that_changes(
    log: bool, start: float, goal: float, change: str
) -> None:
    """The solution is u = clip(theta / (1 + r), -1, 1): the right wall is touched at theta = 1 + r."""
    pressed, events = max(0.0, start - 1 - R), []
    u = min(start / (1 + R), 1.0)
    tracker = tracker_at("walls", start, u, walls=1.0, log=log)
    assert (pressed > 0) == (change == "opens")
    for _ in range(4):
        outcome = tracker.move_to(goal)
        assert outcome is not None
        assert input_of(outcome) == pytest.approx(min(tracker.value / (1 + R), 1.0), abs=1e-8)
        events += tracker.events
        if tracker.value == pytest.approx(goal):
            break
    ((kind, contact, found_change, value),) = ((e.kind, e.contact, e.change, e.value) for e in events)
    assert (kind, contact, found_change) == ("contact", "contact1", change)
    assert value == pytest.approx(1 + R, abs=1e-5)
    assert tracker.value == pytest.approx(goal)


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


@pytest.mark.one_case_in(2)
@pytest.mark.parametrize("log", [False, True])
def test_a_move_of_several_corrections_ends_at_its_goal(log: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Corrections succeed up to a ratio of 1.6, or a change of 0.25, of theta, which is to grow from 0.1 to 1.4."""
    tracker, reached = tracker_at("walls", 0.1, 0.1 / (1 + R), log=log), []
    curve = tracker.curve
    assert curve is not None
    correct = curve.corrected_point

    def corrected(v: np.ndarray, target: float) -> np.ndarray | None:
        if (target > 1.6 * v[-1]) if log else (target - v[-1] > 0.25 / curve.unit):
            return None
        reached.append(target * curve.unit)
        return correct(v, target)

    monkeypatch.setattr(curve, "corrected_point", corrected)
    outcome = tracker.move_to(1.4)
    assert outcome is not None and input_of(outcome) == pytest.approx(1.4 / (1 + R), abs=1e-8)
    assert tracker.value == pytest.approx(1.4) and len(reached) >= 6
    assert np.all(np.diff(reached) > 0), "every move starts at the last point"


def test_a_curve_ends_where_a_contact_opens_at_a_lower_cost() -> None:
    """Against the wall u = theta with the impulse theta - 1, down to theta = 1; there free flight costs less."""
    tracker = tracker_at("pressing", 1.7, 1.7, push=0.7)
    assert tracker.move_to(0.5) is None
    assert tracker.at_end and tracker.value == pytest.approx(1.0, abs=1e-5)
    (event,) = tracker.events
    assert (event.kind, event.contact, event.change) == ("contact", "contact1", "comes to rest")


@pytest.mark.costly_cases("2")
@pytest.mark.parametrize("count", [1, 2])
def test_folds_are_passed_without_missing_a_point(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Stationary points of u⁴/4 - u²/2 - theta u are theta = u³ - u; the path runs from u = -0.6 past both folds."""
    tracker = tracker_at("folds", 0.6 - 0.6**3, -0.6, walls=100.0)
    starts, inputs, values = [], [-0.6], []
    monkeypatch.setattr(tracker, "_fold", lambda curve, v, *_: starts.append(curve.primal_dual(v)[0][1]) or v)
    for stop in tracker.turn_folds(1.0, -2.0, 2.0):
        inputs.append(input_of(stop.outcome))
        values.append(stop.value)
        if stop.events:
            assert [event.kind for event in stop.events] == ["fold"]
            assert inputs[-2] == pytest.approx(starts[-1]), "a fold is sought from the point before it"
            assert inputs[-2] < (-U_FOLD, U_FOLD)[len(starts) - 1] < inputs[-1]
        if len(starts) == count == 1:
            break
    assert len(starts) == count
    np.testing.assert_allclose(np.array(inputs[1:]) ** 3 - inputs[1:], values, atol=1e-9)
    assert np.diff(inputs).min() > 0 and np.diff(inputs).max() < 0.6, "arcs are at most 0.2 long"
    edge = starts[0] ** 3 - starts[0]
    assert tracker.past_fold == (count == 2)
    assert count == 1 or values[-2] <= edge < values[-1], "theta is beyond that of the first fold"


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


@pytest.mark.parametrize(("log", "reach"), [(False, 3.0), (True, 2.0)])
@pytest.mark.parametrize("forward", [1.0, -1.0])
def test_a_value_just_beyond_an_event_is_half_the_precision_of_events_away(
    log: bool, reach: float, forward: float
) -> None:
    """The precision is a millionth of the range, or of the value on a log scale; the end is not passed."""
    ends = (1.0, 4.0) if forward > 0 else (4.0, 1.0)
    walk: Any = SimpleNamespace(request=(*ends, 5), tracker=SimpleNamespace(log=log))
    assert _Walk._just_beyond(walk, 2.0) - 2.0 == pytest.approx(forward * 0.5e-6 * reach, rel=1e-6)
    assert _Walk._just_beyond(walk, ends[1] - forward * 1e-8) == ends[1]


def test_the_span_of_a_continuation_is_the_distance_of_its_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    spans = []
    monkeypatch.setattr("ocp.continuation.walk.Tracker", lambda session, name, span, log: spans.append(span))
    monkeypatch.setattr("ocp.continuation.walk._Walk.follow", lambda _: None)
    for start, end in ((-1.0, 3.0), (3.0, -1.0)):
        continue_over(session("walls"), "theta", start, end, 4)
    assert spans == [4.0, 4.0]
