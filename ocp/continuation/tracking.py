"""Tracker of a curve of stationary points: prediction, correction, and changes of its active set."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ocp.continuation.events import LOCATION_TOLERANCE, Event, degenerate_event
from ocp.errors import InputError
from ocp.judge.kkt import Held, KKTCurve, regular_curve
from ocp.problem.evaluation import Evaluation
from ocp.programs.solver import Point, Result, Status
from ocp.routes.branches import Branches
from ocp.routes.homotopy import Homotopy, RouteResult, lower
from ocp.routes.session import Session

ACTIVE_SET_TOLERANCE = 1e-8
"""Largest scaled violation of a margin at a point of the curve."""
WEAK_MARGIN = 1e-6
"""Margin below which a pair counts as weakly active at an event."""
MAX_EVENTS = 500
"""Maximum number of predictions in a single move."""
MIN_MOVE_SHARE = 1 / 16
"""Minimum length of a predicted move, as a fraction of the distance to its goal."""
MAX_LOCATIONS = 60
"""Maximum number of iterations that locate an event."""
MAX_ARCS = 400
"""Maximum number of arcs around folds."""
MAX_ARCS_TO_FOLD = 40
"""Maximum number of arcs before the first fold."""
JUMP_DISTANCE = 1e-2
"""Scaled distance from the tangent, plus twice the predicted step, above which a solution is on another curve."""
MIN_COST_GAIN = 1e-6
"""Smallest relative decrease of the cost for which the tracker moves to another stationary point."""


@dataclass(frozen=True)
class Stop:
    """A point on the curve near a fold, and the events since the previous point."""

    value: float
    outcome: RouteResult
    events: list[Event]


class Tracker:
    """Tracker that follows a curve of stationary points along the parameter ``name``, from a session's solution.

    ``events`` are the events of the last move; ``fruitless_iterations`` counts the iterations that led to no point.
    ``curve`` is None if no smooth curve passes through the point (contacts are undecided, or shooting under the
    exact law has a kink there). ``meets_kink`` is true if the active set of a program without pairs changes during
    a move; only the solver can pass such a change. ``at_end`` is true if the curve ends at the tracker's point.
    """

    def __init__(self, session: Session, name: str, span: float, log: bool) -> None:
        self.session, self.name, self.span, self.log = session, name, span, log
        self.curve: KKTCurve | None = None
        self.v, self.events, self.curvature = np.zeros(0), list[Event](), 0
        self.at_end, self.past_fold, self.meets_kink, self.fruitless_iterations = False, False, False, 0

    def start_at(self, outcome: RouteResult) -> None:
        """Move the tracker to an outcome at the session's current values."""
        self.curve, self.at_end, self.events = None, False, []
        program, point = outcome.nlp, outcome.result.point
        self.program = program
        if point.lam_g is None or (self.session.step.exact and program.reformulation != "none"):
            return
        values = dict(self.session.values)
        unit = abs(values[self.name]) if self.log else self.span
        try:
            self.curve, self.v = regular_curve(program, point, values, self.name, unit)
        except InputError:
            return
        self.fruitless_iterations += self.curve.iterations
        if (self._finite_margins(self.curve.margins(self.v)) < -ACTIVE_SET_TOLERANCE).any():
            self.curve = None
        else:
            self.curvature = self.curve.curvature(self.v)

    @property
    def value(self) -> float:
        """Value of the parameter at the tracker's point."""
        assert self.curve is not None
        return float(self.v[-1] * self.curve.unit)

    def move_to(self, value: float) -> RouteResult | None:
        """Return the outcome of a move towards ``value``, possibly past events, by predictions and corrections.

        Returns None if a sixteenth of the distance is too far and no event was located; the tracker is then at
        the last point reached. Returns None and sets ``at_end`` if the curve ends before the value.
        """
        assert self.curve is not None
        start_time, iterations, last = time.perf_counter(), 0, -1
        self.events, self.meets_kink = [], False
        curve, v, goal = self.curve, self.v, value / self.curve.unit
        curve.iterations, smallest_move, target = 0, MIN_MOVE_SHARE * self._distance(v[-1], goal), goal
        for _ in range(MAX_EVENTS):
            candidate = curve.corrected_point(v, target)
            below = self._violated(curve, candidate)
            # The minimum has become a saddle: a singular point was passed.
            if candidate is None or below is None or (not below.any() and curve.curvature(candidate) > self.curvature):
                target = v[-1] * np.sqrt(target / v[-1]) if self.log else (v[-1] + target) / 2
                if self._distance(v[-1], target) < smallest_move:
                    break
                continue
            if not below.any():
                v = candidate
                if target == goal:
                    self.curve, self.v = curve, v
                    iterations += curve.iterations
                    return self._outcome(iterations, time.perf_counter() - start_time)
                target = goal
                continue
            if not curve.pairs.size:
                self.meets_kink = True
                break
            v, end = self._locate_event(curve, v, candidate)
            next_curve = self._curve_beyond_event(curve, v, end)
            if next_curve is None or (end == last and abs(v[-1] - curve.start[-1]) < 1e-12):
                self.at_end = True
                self.events += [self._event(curve, v, end)] if next_curve is None else []
                break
            self.events.append(self._event(curve, v, end))
            iterations += curve.iterations
            curve, v, last, target = next_curve, next_curve.start, end, goal
        self.curve, self.v, iterations = curve, v, iterations + curve.iterations
        if self.events and not self.at_end:
            return self._outcome(iterations, time.perf_counter() - start_time)
        self.fruitless_iterations += iterations
        return None

    def _distance(self, first: float, second: float) -> float:
        return abs(np.log(second / first)) if self.log else abs(second - first)

    def _violated(self, curve: KKTCurve, v: np.ndarray | None) -> np.ndarray | None:
        """Return a mask of violated ends at a point; None without a point, or if a smooth law's pair is violated."""
        if v is None:
            return None
        below = self._finite_margins(curve.margins(v)) < -ACTIVE_SET_TOLERANCE
        return None if not curve.pairs.size and below[curve.program.pairs].any() else below

    def _curve_beyond_event(self, curve: KKTCurve, v: np.ndarray, end: int) -> KKTCurve | None:
        """Return the curve beyond an event; None if the cost decreases as a pair leaves (0, 0): the curve then ends."""
        held = curve.held.toggle_end(end)
        if end in curve.pairs and held.x[end]:
            if curve.program.reformulation != "none":
                return None
            column = np.flatnonzero((curve.pairs == end).any(axis=0))[0]
            if (curve.lower_slopes(v)[curve.pairs[:, column]] < -ACTIVE_SET_TOLERANCE).any():
                return None
        return self._curve(curve, v, held)

    def _curve(self, curve: KKTCurve, v: np.ndarray, held: Held) -> KKTCurve:
        """Return a curve through a point of another curve, with the scaling and unit of that point."""
        (x, y), value = curve.primal_dual(v), float(v[-1] * curve.unit)
        unit = abs(value) if self.log else self.span
        values = {**curve.values, self.name: value}
        return KKTCurve(curve.program, values, self.name, unit, Point(x), y, held)

    def _locate_event(self, curve: KKTCurve, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, int]:
        """Return the point before the first change of the active set between two points, and the changed end."""
        lower_margins, upper_margins = (self._finite_margins(curve.margins(v)) for v in (low, high))
        end, width = 0, 1e-3 * LOCATION_TOLERANCE
        for count in range(MAX_LOCATIONS):
            crossing = np.flatnonzero(upper_margins < -ACTIVE_SET_TOLERANCE)
            positive = np.maximum(lower_margins[crossing], 0.0)
            shares = positive / (positive - upper_margins[crossing])
            first = int(np.argmin(shares))
            end, share = int(crossing[first]), float(shares[first])
            distance = abs(high[-1] - low[-1])
            if share * distance <= width or distance <= width:
                return low, end
            share = 0.5 if count % 3 == 2 else min(share + 0.1 * width / distance, 1.0)
            middle = curve.corrected_point(low, low[-1] + share * (high[-1] - low[-1]))
            if middle is None:
                return low, end
            margins = self._finite_margins(curve.margins(middle))
            if (margins < -ACTIVE_SET_TOLERANCE).any():
                high, upper_margins = middle, margins
            else:
                low, lower_margins = middle, margins
        return low, end

    def _finite_margins(self, margins: np.ndarray) -> np.ndarray:
        return np.where(np.isnan(margins), -np.inf, margins)

    def _event(self, curve: KKTCurve, v: np.ndarray, end: int) -> Event:
        name, step, contact = curve.end_name(end)
        cost, value = curve.solver_point(v)[1], float(v[-1] * curve.unit)
        if contact and (curve.margins(v)[curve.pairs] < WEAK_MARGIN).any(axis=0).sum() > 1:
            return degenerate_event(value, cost)
        if not contact:
            change = "leaves its bound" if curve.held.holds_end(end) else "meets its bound"
            return Event("bound", value, cost, change, name, (step,))
        first = bool((curve.program.pairs[0] == end).any())
        acts = curve.held.toggle_end(end).x[end] != 0
        change = "comes to rest" if first else "touches"
        if not acts:
            change = "acts" if first else "opens"
        return Event("contact", value, cost, change, name, (step,))

    def _outcome(self, iterations: int, seconds: float) -> RouteResult:
        assert self.curve is not None
        curve, session = self.curve, self.session
        (point, f, g), value = curve.solver_point(self.v), self.value
        self.curve = self._curve(curve, self.v, curve.held)
        result = Result(point, f, g, Status.SOLVED, "newton", iterations, seconds)
        follower = Homotopy(session.nlp_of, session.solver, session.values)
        follower.record(self.name, value, self.program, result, *curve.problem_data(self.v[-1]))
        self.v = self.curve.start
        return RouteResult(result, self.program, True, follower.trace)

    def pair_changes(self, old_curve: KKTCurve, outcome: RouteResult) -> list[Event]:
        """Return events for pairs whose other member was held at zero on ``old_curve``."""
        if self.curve is None or not self.curve.pairs.size:
            return []
        program = self.curve.program
        changed_pairs = (old_curve.held.x != self.curve.held.x)[program.pairs].any(axis=0)
        pairs = [program.pair_name(int(i)) for i in np.flatnonzero(changed_pairs)]
        value, cost = self.value, self.cost(outcome.result.f)
        return [Event("contact", value, cost, "changes", pair.name, (pair.step,)) for pair in pairs]

    def cost(self, f: float, value: float | None = None) -> float:
        """Return the problem's cost, with constant terms, from a program's cost ``f`` at a parameter value."""
        values = {**self.session.values, self.name: self.value if value is None else value}
        return f + Evaluation(self.session.problem, values).constant_cost

    def has_jumped(self, outcome: RouteResult, value: float) -> bool:
        """Return whether an outcome differs from the curve's tangent by more than twice the predicted step."""
        assert self.curve is not None
        curve, x = self.curve, outcome.result.point.x
        predicted = (value / curve.unit - self.v[-1]) * curve.tangent(self.v)[: curve.nx]
        deviation = (x / curve.sizes)[curve.free] - self.v[: curve.nx] - predicted
        return bool(np.abs(deviation).max(initial=0.0) > JUMP_DISTANCE + 2 * np.abs(predicted).max(initial=0.0))

    def find_cheaper(self, outcome: RouteResult) -> RouteResult | None:
        """Return a cheaper stationary point on another branch, found by linear programs (LPEC), or None."""
        session = self.session
        if not session.complementary or outcome.nlp.reformulation != "none":
            return None
        follower = Homotopy(session.nlp_of, session.solver, session.values)
        better = Branches(follower).improve(outcome.result)
        if not lower(better, outcome.result, MIN_COST_GAIN):
            self.fruitless_iterations += follower.trace.iterations
            return None
        follower.trace.absorb(outcome.trace)
        return RouteResult(better, outcome.nlp, True, follower.trace)

    def locate_crossing(self, better: RouteResult, since: float) -> Event:
        """Return the switch event at the first value, from ``since`` on, where the curve of ``better`` is cheaper."""
        better_tracker, curve, v = Tracker(self.session, self.name, self.span, self.log), self.curve, self.v
        better_tracker.start_at(better)
        low, high, cost = since, self.value, self.cost(better.result.f)
        assert curve is not None
        while better_tracker.curve is not None and abs(high - low) > 0.1 * LOCATION_TOLERANCE * curve.unit:
            middle = (low + high) / 2
            own_point = curve.corrected_point(v, middle / curve.unit)
            other_point = better_tracker.curve.corrected_point(better_tracker.v, middle / better_tracker.curve.unit)
            below = self._violated(better_tracker.curve, other_point)
            gain = -1.0
            if own_point is not None and other_point is not None and below is not None and not below.any():
                gain = curve.solver_point(own_point)[1] - better_tracker.curve.solver_point(other_point)[1]
            if gain > 0 and own_point is not None and other_point is not None:
                high, v, better_tracker.v = middle, own_point, other_point
                cost = self.cost(curve.solver_point(own_point)[1], middle)
            else:
                low = middle
        ending = "becomes cheaper"
        if abs(high - since) <= LOCATION_TOLERANCE * curve.unit:
            return Event("switch", self.value, self.cost(better.result.f), "another point is cheaper")
        return Event("switch", high, cost, f"another point {ending}")

    def turn_folds(self, forward: float, first: float, goal: float) -> Iterator[Stop]:
        """Yield points around folds, by pseudo-arclength, until the parameter moves ``forward`` (1 or -1) again.

        The iteration ends early, with ``past_fold`` false, if the active set changes, if the parameter returns to
        ``first``, or if there is no fold before ``goal``. The tracker is then at the last point.
        """
        assert self.curve is not None
        curve, v, start_time = self.curve, self.v, time.perf_counter()
        t, weights = _unit_tangent(curve, curve.tangent(v) * forward)
        arc, passed_fold, edge = 0.05, False, v[-1]
        for count in range(MAX_ARCS):
            if not passed_fold and (count > MAX_ARCS_TO_FOLD or (v[-1] - goal / curve.unit) * forward > 0):
                return
            curve.iterations, self.events = 0, []
            candidate = curve.newton(v + arc * t, weights * t, float((weights * t) @ v) + arc)
            if candidate is None or (self._finite_margins(curve.margins(candidate)) < -ACTIVE_SET_TOLERANCE).any():
                arc /= 2
                if arc < 1e-6:
                    return
                continue
            tangent, _ = _unit_tangent(curve, curve.tangent(candidate, weights * t))
            if tangent @ (weights * t) < 0.8:
                arc /= 2
                continue
            if tangent[-1] * t[-1] < 0:
                fold_point = self._fold(curve, v, t, weights, arc)
                cost, value = curve.solver_point(fold_point)[1], float(fold_point[-1] * curve.unit)
                self.events = [Event("fold", value, cost, "turns")]
                edge = fold_point[-1] if not passed_fold else edge
                passed_fold = True
            v, t, arc = candidate, tangent, min(1.5 * arc, 0.2)
            self.curve, self.v, self.curvature = curve, v, curve.curvature(v)
            end_time = time.perf_counter()
            yield Stop(self.value, self._outcome(curve.iterations, end_time - start_time), self.events)
            start_time = end_time
            self.past_fold = passed_fold and (v[-1] - edge) * forward > 0 and t[-1] * forward > 0
            if self.past_fold or (v[-1] - first / curve.unit) * forward <= 0:
                return

    def _fold(self, curve: KKTCurve, v: np.ndarray, t: np.ndarray, weights: np.ndarray, arc: float) -> np.ndarray:
        """Return the point in the arc at which the tangent's parameter component is zero, by bisection."""
        low, high, fold_point = 0.0, arc, v
        for _ in range(40):
            s = (low + high) / 2
            candidate = curve.newton(v + s * t, weights * t, float((weights * t) @ v) + s)
            if candidate is None:
                break
            fold_point, tangent = candidate, curve.tangent(candidate, weights * t)
            low, high = (s, high) if tangent[-1] * t[-1] > 0 else (low, s)
        return fold_point


def _unit_tangent(curve: KKTCurve, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a tangent of length 1 in variables and parameter, and the weights used in this length."""
    weights = np.ones_like(t)
    weights[curve.nx : -1] = 0.0
    return t / np.sqrt((weights * t) @ t), weights
