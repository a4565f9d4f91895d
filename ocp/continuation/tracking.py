"""Follow a curve of stationary points: predict, correct, and see where its active set changes."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ocp.continuation.events import LOCATED, Event, degenerate
from ocp.errors import InputError
from ocp.judge.kkt import Held, KKTCurve, regular
from ocp.problem.evaluation import Evaluation
from ocp.programs.solver import Point, Result, Status
from ocp.routes.branches import Branches
from ocp.routes.homotopy import Homotopy, RouteResult, lower
from ocp.routes.session import Session

_OFF = 1e-8
_WEAK = 1e-6
_CHANGES = 500
_SHARE = 1 / 16
_LOCATING = 60
_ARCS = 400
_PATIENCE = 40
_JUMP = 1e-2
_GAIN = 1e-6


@dataclass(frozen=True)
class Stop:
    """A point on the way round a fold, and the events since the last."""

    value: float
    outcome: RouteResult
    events: list[Event]


class Tracker:
    """Stands at a solved point of a session and moves it along the parameter ``name``.

    ``events`` are those on the way of the last move, ``wasted`` the iterations that led nowhere.
    Where the point has no curve (contacts undecided, a kink of shooting under the exact law)
    ``curve`` is None. ``kinked`` says that a bound is in the way, of a law without pairs, which is
    the solver's to pass; ``stuck`` that the curve ends at the place where the tracker stands.
    """

    def __init__(self, session: Session, name: str, span: float, log: bool) -> None:
        self.session, self.name, self.span, self.log = session, name, span, log
        self.curve: KKTCurve | None = None
        self.v, self.events, self.down = np.zeros(0), list[Event](), 0
        self.stuck, self.around, self.kinked, self.wasted = False, False, False, 0

    def begin(self, outcome: RouteResult) -> None:
        """Stand at an outcome at the session's present values."""
        self.curve, self.stuck, self.events = None, False, []
        program, point = outcome.nlp, outcome.result.point
        self.program = program
        if point.lam_g is None or (self.session.step.exact and program.reformulation != "none"):
            return
        values = dict(self.session.values)
        unit = abs(values[self.name]) if self.log else self.span
        try:
            self.curve, self.v = regular(program, point, values, self.name, unit)
        except InputError:
            return
        self.wasted += self.curve.iterations
        if (self._kept(self.curve.margins(self.v)) < -_OFF).any():
            self.curve = None
        else:
            self.down = self.curve.curvature(self.v)

    @property
    def value(self) -> float:
        """The parameter's value at which the tracker stands."""
        assert self.curve is not None
        return float(self.v[-1] * self.curve.unit)

    def to(self, value: float) -> RouteResult | None:
        """Move to a value, or past some events towards it, in predictions that come back.

        None where a sixteenth of the way is too far and nothing happened, with the tracker where it
        came to; where the curve ends on the way, None too, with ``stuck``, at that end.
        """
        assert self.curve is not None
        began, spent, last = time.perf_counter(), 0, -1
        self.events, self.kinked = [], False
        curve, v, goal = self.curve, self.v, value / self.curve.unit
        curve.iterations, least, target = 0, _SHARE * self._far(v[-1], goal), goal
        for _ in range(_CHANGES):
            found = curve.at(v, target)
            below = self._violated(curve, found)
            # A minimum that has become a saddle: a singular point was passed.
            if found is None or below is None or (not below.any() and curve.curvature(found) > self.down):
                target = v[-1] * np.sqrt(target / v[-1]) if self.log else (v[-1] + target) / 2
                if self._far(v[-1], target) < least:
                    break
                continue
            if not below.any():
                v = found
                if target == goal:
                    self.curve, self.v = curve, v
                    spent += curve.iterations
                    return self._outcome(spent, time.perf_counter() - began)
                target = goal
                continue
            if not curve.own.size:
                self.kinked = True
                break
            v, end = self._located(curve, v, found)
            after = self._changed(curve, v, end)
            if after is None or (end == last and abs(v[-1] - curve.start[-1]) < 1e-12):
                self.stuck = True
                self.events += [self._event(curve, v, end)] if after is None else []
                break
            self.events.append(self._event(curve, v, end))
            spent += curve.iterations
            curve, v, last, target = after, after.start, end, goal
        self.curve, self.v, spent = curve, v, spent + curve.iterations
        if self.events and not self.stuck:
            return self._outcome(spent, time.perf_counter() - began)
        self.wasted += spent
        return None

    def _far(self, one: float, other: float) -> float:
        return abs(np.log(other / one)) if self.log else abs(other - one)

    def _violated(self, curve: KKTCurve, v: np.ndarray | None) -> np.ndarray | None:
        """Ends beyond which a point lies; None where a smooth law's pair lies on no curve."""
        if v is None:
            return None
        below = self._kept(curve.margins(v)) < -_OFF
        return None if not curve.own.size and below[curve.program.pairs].any() else below

    def _changed(self, curve: KKTCurve, v: np.ndarray, end: int) -> KKTCurve | None:
        """The curve beyond an event; None where a pair at (0, 0) would gain by leaving it."""
        held = curve.held.toggled(end)
        if end in curve.own and held.x[end]:
            if curve.program.reformulation != "none":
                return None
            column = np.flatnonzero((curve.own == end).any(axis=0))[0]
            if (curve.press(v)[curve.own[:, column]] < -_OFF).any():
                return None
        return self._curve(curve, v, held)

    def _curve(self, curve: KKTCurve, v: np.ndarray, held: Held) -> KKTCurve:
        """A curve through a point of another, in sizes and the unit of that place."""
        (x, y), value = curve.point(v), float(v[-1] * curve.unit)
        unit = abs(value) if self.log else self.span
        values = {**curve.values, self.name: value}
        return KKTCurve(curve.program, values, self.name, unit, Point(x), y, held)

    def _located(self, curve: KKTCurve, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, int]:
        """First end that changes between two points, and where: secant, every third bisection."""
        near, far = (self._kept(curve.margins(v)) for v in (low, high))
        end, width = 0, 1e-3 * LOCATED
        for count in range(_LOCATING):
            crossing = np.flatnonzero(far < -_OFF)
            positive = np.maximum(near[crossing], 0.0)
            shares = positive / (positive - far[crossing])
            first = int(np.argmin(shares))
            end, share = int(crossing[first]), float(shares[first])
            wide = abs(high[-1] - low[-1])
            if share * wide <= width or wide <= width:
                return low, end
            share = 0.5 if count % 3 == 2 else min(share + 0.1 * width / wide, 1.0)
            middle = curve.at(low, low[-1] + share * (high[-1] - low[-1]))
            if middle is None:
                return low, end
            margins = self._kept(curve.margins(middle))
            if (margins < -_OFF).any():
                high, far = middle, margins
            else:
                low, near = middle, margins
        return low, end

    def _kept(self, margins: np.ndarray) -> np.ndarray:
        return np.where(np.isnan(margins), -np.inf, margins)

    def _event(self, curve: KKTCurve, v: np.ndarray, end: int) -> Event:
        name, step, contact = curve.place(end)
        cost, value = curve.result(v)[1], float(v[-1] * curve.unit)
        if contact and (curve.margins(v)[curve.own] < _WEAK).any(axis=0).sum() > 1:
            return degenerate(value, cost)
        if not contact:
            change = "leaves its bound" if curve.held.holds(end) else "meets its bound"
            return Event("bound", value, cost, change, name, (step,))
        first = bool((curve.program.pairs[0] == end).any())
        held = curve.held.toggled(end).x[end] != 0
        change = "comes to rest" if first else "touches"
        if not held:
            change = "acts" if first else "opens"
        return Event("contact", value, cost, change, name, (step,))

    def _outcome(self, iterations: int, seconds: float) -> RouteResult:
        assert self.curve is not None
        curve, session = self.curve, self.session
        (point, f, g), value = curve.result(self.v), self.value
        self.curve = self._curve(curve, self.v, curve.held)
        result = Result(point, f, g, Status.SOLVED, "newton", iterations, seconds)
        follower = Homotopy(session.nlp_of, session.solver, session.values)
        follower.record(self.name, value, self.program, result, *curve.given(self.v[-1]))
        self.v = self.curve.start
        return RouteResult(result, self.program, True, follower.trace)

    def changed(self, before: KKTCurve, outcome: RouteResult) -> list[Event]:
        """Pairs whose state differs from that on another curve, as events at this point."""
        if self.curve is None or not self.curve.own.size:
            return []
        program = self.curve.program
        differ = (before.held.x != self.curve.held.x)[program.pairs].any(axis=0)
        named = [program.pair_name(int(i)) for i in np.flatnonzero(differ)]
        return [
            Event(
                "contact",
                self.value,
                self.cost(outcome.result.f),
                "changes",
                pair.name,
                (pair.step,),
            )
            for pair in named
        ]

    def cost(self, f: float, value: float | None = None) -> float:
        """Return the problem's cost with its constant terms, from a program's, at a parameter."""
        values = {**self.session.values, self.name: self.value if value is None else value}
        return f + Evaluation(self.session.problem, values).constant_cost

    def jumped(self, outcome: RouteResult, value: float) -> bool:
        """Whether an outcome lies off the curve's tangent by more than twice the predicted way."""
        assert self.curve is not None
        curve, x = self.curve, outcome.result.point.x
        way = (value / curve.unit - self.v[-1]) * curve.tangent(self.v)[: curve.nx]
        off = (x / curve.sizes)[curve.free] - self.v[: curve.nx] - way
        return bool(np.abs(off).max(initial=0.0) > _JUMP + 2 * np.abs(way).max(initial=0.0))

    def cheaper(self, outcome: RouteResult) -> RouteResult | None:
        """A cheaper stationary point that a linear program with complementarity leads to."""
        session = self.session
        if not session.complementary or outcome.nlp.reformulation != "none":
            return None
        follower = Homotopy(session.nlp_of, session.solver, session.values)
        better = Branches(follower).improve(outcome.result)
        if not lower(better, outcome.result, _GAIN):
            self.wasted += follower.trace.iterations
            return None
        follower.trace.absorb(outcome.trace)
        return RouteResult(better, outcome.nlp, True, follower.trace)

    def crossing(self, better: RouteResult, since: float) -> Event:
        """The switch to another curve: where, at most back to ``since``, it becomes the cheaper."""
        other, curve, v = Tracker(self.session, self.name, self.span, self.log), self.curve, self.v
        other.begin(better)
        low, high, cost = since, self.value, self.cost(better.result.f)
        assert curve is not None
        while other.curve is not None and abs(high - low) > 0.1 * LOCATED * curve.unit:
            middle = (low + high) / 2
            here = curve.at(v, middle / curve.unit)
            there = other.curve.at(other.v, middle / other.curve.unit)
            below = self._violated(other.curve, there)
            gain = -1.0
            if here is not None and there is not None and below is not None and not below.any():
                gain = curve.result(here)[1] - other.curve.result(there)[1]
            if gain > 0 and here is not None and there is not None:
                high, v, other.v = middle, here, there
                cost = self.cost(curve.result(here)[1], middle)
            else:
                low = middle
        ending = "becomes cheaper"
        if abs(high - since) <= LOCATED * curve.unit:
            return Event("switch", self.value, self.cost(better.result.f), "another point is cheaper")
        return Event("switch", high, cost, f"another point {ending}")

    def turn(self, forward: float, first: float, goal: float) -> Iterator[Stop]:
        """Step round folds by pseudo-arclength until the path goes ``forward`` again, and on.

        Ends early, not ``around``, where the active set changes, the parameter is back at
        ``first``, or no fold comes before ``goal``. The tracker stands at the last stop.
        """
        assert self.curve is not None
        curve, v, began = self.curve, self.v, time.perf_counter()
        t, weights = _unit(curve, curve.tangent(v) * forward)
        arc, turned, edge = 0.05, False, v[-1]
        for count in range(_ARCS):
            if not turned and (count > _PATIENCE or (v[-1] - goal / curve.unit) * forward > 0):
                return
            curve.iterations, self.events = 0, []
            found = curve.newton(v + arc * t, weights * t, float((weights * t) @ v) + arc)
            if found is None or (self._kept(curve.margins(found)) < -_OFF).any():
                arc /= 2
                if arc < 1e-6:
                    return
                continue
            after, _ = _unit(curve, curve.tangent(found, weights * t))
            if after @ (weights * t) < 0.8:
                arc /= 2
                continue
            if after[-1] * t[-1] < 0:
                at = self._fold(curve, v, t, weights, arc)
                cost, value = curve.result(at)[1], float(at[-1] * curve.unit)
                self.events = [Event("fold", value, cost, "turns")]
                edge = at[-1] if not turned else edge
                turned = True
            v, t, arc = found, after, min(1.5 * arc, 0.2)
            self.curve, self.v, self.down = curve, v, curve.curvature(v)
            now = time.perf_counter()
            yield Stop(self.value, self._outcome(curve.iterations, now - began), self.events)
            began = now
            self.around = turned and (v[-1] - edge) * forward > 0 and t[-1] * forward > 0
            if self.around or (v[-1] - first / curve.unit) * forward <= 0:
                return

    def _fold(self, curve: KKTCurve, v: np.ndarray, t: np.ndarray, weights: np.ndarray, arc: float) -> np.ndarray:
        """Find where the parameter's part of the tangent is zero, by bisection in the arc."""
        low, high, at = 0.0, arc, v
        for _ in range(40):
            s = (low + high) / 2
            found = curve.newton(v + s * t, weights * t, float((weights * t) @ v) + s)
            if found is None:
                break
            at, after = found, curve.tangent(found, weights * t)
            low, high = (s, high) if after[-1] * t[-1] > 0 else (low, s)
        return at


def _unit(curve: KKTCurve, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A tangent of length 1 in variables and parameter, and the weights of that length."""
    weights = np.ones_like(t)
    weights[curve.nx : -1] = 0.0
    return t / np.sqrt((weights * t) @ t), weights
