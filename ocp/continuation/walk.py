"""Continuation of a solution along a parameter, with the locations of contact changes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from dynamics.limits import CONTINUATION_STEPS
from dynamics.settings import read_value
from dynamics.systems import LAW_PREFIX
from ocp.continuation.curve import Continuation, CurvePoint, with_neighbour_costs
from ocp.continuation.events import LOCATION_TOLERANCE, PAIR_EVENTS, Event, merge_simultaneous
from ocp.continuation.tracking import Tracker
from ocp.errors import InputError, choose, input_errors
from ocp.problem.checks import check_physics
from ocp.programs.solver import Point, Status
from ocp.routes.homotopy import RouteResult
from ocp.routes.session import Session
from ocp.solve.judging import judge_outcome
from ocp.solve.request import ProblemLike
from ocp.solve.solve import new_session

MIN_STEP_SHARE = 1e-3
"""Minimum step along the curve, as a fraction of the requested step."""
EASY_ITERATIONS = 15
"""Maximum number of iterations of an easy solve, after which the next step may be longer."""
SCALE_MAPS = {"linear": (float, float), "log": (math.exp, math.log)}
"""Mapping from each scale to two functions: from the scale to parameter values, and the inverse."""
SMALL_STEP_SHARE = 1 / 16
"""Maximum length of a small step, as a fraction of the requested step."""


def resolve(session: Session, over: str) -> str:
    """Return the full name of the parameter ``over``, such as ``M`` or ``problem.M``, ``contact.mu`` or ``mu``.

    Raises :class:`~ocp.errors.InputError` for an unknown name and for settings that change the program, such as
    ``N``.
    """
    names = [*session.problem.parameters.names, *session.step.p.names]
    name = over.removeprefix("problem.")
    if name in ("N", *session.problem.origin.settings):
        raise InputError(
            f"{name} cannot be followed: each value is another program, with no curve between"
            f" them; solve at each, from the last, with ocp solve {session.problem.name} -p"
            f" {name}=... --from @last, or all of them with ocp sweep"
        )
    choices = {choice.removeprefix(LAW_PREFIX): choice for choice in names} | {choice: choice for choice in names}
    return choose("parameter", name, choices)


def continue_over(
    problem: ProblemLike | Session,
    over: str,
    start: float,
    end: float,
    steps: int = 20,
    scale: str = "linear",
    *,
    progress: Callable[[CurvePoint], None] | None = None,
    seed: int = 0,
    **request: Any,
) -> Continuation:
    """Follow the solution of a problem from ``start`` to ``end`` of a parameter, as ``ocp continue`` does::

        continue_over("push-disc", "M", 1.0, 2.0, 10, contact="barrier", mu=1e-3)

    ``over`` is a parameter of the problem, or of the law with ``contact.``; the ``steps`` are equal on ``scale``.
    ``request`` are arguments of :func:`ocp.solve`: ``contact``, ``method``, ``policy``, ``solver``, ``settings``,
    ``params``, ``contact_settings`` and keywords; a session in place of a problem accepts none.

    The first point is solved as any problem is. If the active set of a point is determined, the next
    point is predicted by the sensitivity and corrected by Newton's method on that set; if the set changes
    in between, the event is located to 1e-6 of the range, and the curve continues with the changed set. If
    the curve cannot be followed, folds are passed by pseudo-arclength; if there is no fold, or the curve
    does not turn forward again, the solver starts at the last answer with its multipliers, and a step that
    fails is halved, down to a thousandth of its first size. If the solver finds another curve, or a linear
    program with complementarity constraints leads to a cheaper point, the curve continues there, which is
    called a switch. If nothing succeeds, the curve breaks: the reason is recorded, and the points so far are
    kept. At the end, the plans of both neighbours of every point are rolled out at the point's value; the
    point is an outlier if one of them costs less.

    Raises :class:`~ocp.errors.InputError` for an unknown parameter or scale, fewer than one step,
    equal or non-finite ends, a log scale through zero, or an end at which the law or the mechanics is not valid, such
    as zero mass.
    """
    session = problem if isinstance(problem, Session) else new_session(problem, **request)
    name = resolve(session, over)
    scales = check_range(scale, start, end, steps)
    for value in (start, end):
        check_value(session, name, value)
    tracker = Tracker(session, name, abs(end - start), scale == "log")
    walk = _Walk(session, tracker, Continuation(name), scales, (start, end, steps), seed, progress)
    return walk.follow()


@dataclass
class _Walk:
    """A running continuation: ``at`` is the covered fraction of the range, ``outcome`` the last accepted outcome."""

    session: Session
    tracker: Tracker
    followed: Continuation
    scales: tuple[Callable[[float], float], Callable[[float], float]]
    request: tuple[float, float, int]
    seed: int
    progress: Callable[[CurvePoint], None] | None

    def follow(self) -> Continuation:
        """Follow the curve to the end of the range, or to a value at which the continuation fails."""
        session, followed, (start, end, steps) = self.session, self.followed, self.request
        first = self._solve(start)
        if self._add_point(first, start):
            self.tracker.start_at(first)
            self._follow_range(1.0 / steps)
        else:
            verdict = followed.points[-1].failure_reason
            followed.break_reason = f"at the first point, {followed.parameter} = {start:g}: {verdict}"
        followed.points = with_neighbour_costs(session, followed.parameter, followed.points)
        followed.nlp_builds = session.nlp_builds
        followed.iterations += self.tracker.fruitless_iterations
        followed.events = merge_simultaneous(followed.events, None if self.tracker.log else abs(end - start))
        return followed

    def _follow_range(self, full: float) -> None:
        step = full
        while self.at < 1 - 1e-12 and self.followed.break_reason is None:
            next_step = math.floor(self.at / full + 1e-9) + 1
            value = self._value(next_step * full if step == full else self.at + step)
            tracker = self.tracker
            if self._track_to(value) or (tracker.at_end and self._solve_and_add(self._just_beyond(tracker.value))):
                step = min(full, 2 * step)
                continue
            is_small = step <= SMALL_STEP_SHARE * full
            if self._pass_folds(value) or self._solve_and_add(value, is_small):
                easy = self.outcome.trace.iterations <= EASY_ITERATIONS
                step = min(full, 2 * step) if easy else step
                continue
            step /= 2
            if step < MIN_STEP_SHARE * full:
                self._record_break(value)

    def _value(self, share: float) -> float:
        (start, end, _), (to_value, to_scale) = self.request, self.scales
        if share >= 1 - 1e-12:
            return end
        return to_value(to_scale(start) + share * (to_scale(end) - to_scale(start)))

    def _solve(self, value: float, point: Point | None = None) -> RouteResult:
        self.session.values[self.followed.parameter] = value
        nlp = None if point is None else self.outcome.nlp
        return self.session.solve(start=point, warm_from=nlp)

    def _add_point(self, outcome: RouteResult, value: float) -> bool:
        """Judge an outcome, add it as a point if it is accepted or the first; return whether it is accepted."""
        self.session.values[self.followed.parameter] = value
        solution = judge_outcome(self.session, outcome, self.seed)
        point = CurvePoint(value, solution)
        accepted = outcome.finished and solution.status in (Status.SOLVED, Status.NO_PROGRESS)
        accepted = accepted and not point.infinite_costs
        if not accepted and self.followed.points:
            self.failed = point
            return False
        self.followed.iterations += solution.iterations
        self.followed.points.append(point)
        if accepted:
            first, current, last = (self.scales[1](v) for v in (self.request[0], value, self.request[1]))
            self.outcome, self.at = outcome, (current - first) / (last - first)
            if self.progress is not None:
                self.progress(point)
        return accepted

    def _track_to(self, value: float) -> bool:
        """Follow the curve to a value, or switch to a cheaper point; return whether a point was added."""
        tracker = self.tracker
        if tracker.curve is None:
            return False
        self.session.values[self.followed.parameter] = value
        outcome = tracker.move_to(value)
        if outcome is None:
            return False
        if not math.isclose(tracker.value, value, rel_tol=1e-9, abs_tol=1e-12):
            value = self.session.values[self.followed.parameter] = tracker.value
        better, events = tracker.find_cheaper(outcome), tracker.events
        if better is not None:
            events = [*events, tracker.locate_crossing(better, self.followed.points[-1].value)]
        if not self._add_point(better or outcome, value):
            return self._return_to_last_point(better or outcome)
        self.followed.events += events
        if better is not None:
            tracker.start_at(better)
        return True

    def _solve_and_add(self, value: float, small: bool = True, ended: bool = False) -> bool:
        """Solve at a value and return whether a point was added; ``small`` permits jumps and steps with pairs."""
        tracker, curve = self.tracker, self.tracker.curve
        if curve is not None and curve.pairs.size and not small:
            return False
        warm = self.outcome.result.point if curve is None else curve.solver_point(tracker.v)[0]
        outcome = self._solve(value, warm)
        jumped = curve is not None and tracker.has_jumped(outcome, value)
        if (jumped and not small) or not self._add_point(outcome, value):
            return self._return_to_last_point(outcome)
        self.followed.events += tracker.events
        if jumped or ended:
            self.followed.events.append(Event("switch", value, tracker.cost(outcome.result.f), "the curve ends"))
        explained = jumped or ended or any(e.kind in PAIR_EVENTS for e in tracker.events)
        tracker.start_at(outcome)
        if curve is not None and not explained:
            self.followed.events += tracker.pair_changes(curve, outcome)
        return True

    def _return_to_last_point(self, *outcomes: RouteResult) -> bool:
        """Reset the tracker to the last accepted point after fruitless solves, and return False."""
        self.tracker.fruitless_iterations += sum(outcome.trace.iterations for outcome in outcomes)
        self.session.values[self.followed.parameter] = self.followed.points[-1].value
        self.tracker.start_at(self.outcome)
        return False

    def _pass_folds(self, value: float) -> bool:
        """Step around folds, add every stop as a point, and return whether that succeeded."""
        tracker, followed, (start, end, _) = self.tracker, self.followed, self.request
        if tracker.curve is None or tracker.meets_kink:
            return False
        previous_events = tracker.events
        stops = list(tracker.turn_folds(math.copysign(1.0, end - start), start, value))
        folds = [event for stop in stops for event in stop.events]
        if not folds:
            return self._return_to_last_point(*(stop.outcome for stop in stops))
        followed.events += [*previous_events, *folds]
        if not tracker.past_fold:
            self._return_to_last_point(*(stop.outcome for stop in stops))
            return self._solve_and_add(self._just_beyond(folds[0].value), ended=True)
        for stop in stops:
            if not self._add_point(stop.outcome, stop.value):
                followed.break_reason = f"on the way round a fold: {self.failed.failure_reason}"
                break
        return True

    def _just_beyond(self, value: float) -> float:
        """Return a value of the parameter just beyond an event's value, limited to the end of the range."""
        start, end, _ = self.request
        reach = math.copysign(value, end - start) if self.tracker.log else end - start
        next_value = value + 0.5 * LOCATION_TOLERANCE * reach
        return end if (next_value - end) * (end - start) > 0 else next_value

    def _record_break(self, value: float) -> None:
        """Record where and why the continuation stopped."""
        last = self.followed.points[-1].value
        reason = f"after {self.followed.parameter} = {last:g}, on the way to {value:g}: {self.failed.failure_reason}"
        for worst in self.failed.solution.audit.worst[:1]:
            reason += f" Worst: {worst.name} of {worst.component} at step {worst.step}, {worst.amount:.1e}."
        self.followed.break_reason = reason


def check_value(session: Session, name: str, value: float) -> None:
    """Raise :class:`~ocp.errors.InputError` if a value is not valid for the parameter ``name``."""
    if not name.startswith(LAW_PREFIX):
        check_physics(session.problem, {**session.values, name: value})
        return
    with input_errors():
        session.law.at(**{name.removeprefix(LAW_PREFIX): value})


def check_range(
    scale: str, start: float, end: float, steps: int
) -> tuple[Callable[[float], float], Callable[[float], float]]:
    """Return the functions from the scale to values and the inverse; raise as :func:`continue_over` does."""
    if not (math.isfinite(start) and math.isfinite(end) and start != end):
        raise InputError(f"--from and --to must be finite and differ, got {start} and {end}")
    read_value("steps", steps, int, **CONTINUATION_STEPS)
    maps = choose("scale", scale, SCALE_MAPS)
    if scale == "log" and min(start, end) <= 0:
        raise InputError(f"a log scale needs positive ends, got {start} and {end}")
    return maps
