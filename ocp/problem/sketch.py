"""Sketches of a plan: poses at some steps, paths of states, and the steps at which contacts are closed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ocp.errors import InputError, abbreviated, choose
from ocp.problem.evaluation import Evaluation
from ocp.problem.problem import Problem
from ocp.problem.rollout import InitialGuess
from ocp.validation import Index, Number, validate_fields, validated

Pose = ArrayLike | Mapping[str, float]
"""All states (nx,), or a mapping from names of some states to values."""
Window = tuple[np.ndarray, np.ndarray]
"""Lower and upper bounds of a block of variables, NaN for no bound."""
SLACK = 0.05
"""Largest distance of a plan from a keyframe, in characteristic sizes."""
START_TOLERANCE = 1e-6
"""Largest distance of a keyframe at step 0 from the start that counts as rounding error, in characteristic sizes."""


@dataclass(frozen=True)
class UserGuess:
    """States (N+1, nx) and inputs (N, nu) from which a user starts a solve.

    A sketch also gives ``windows``, bounds (N, ...) of the blocks x, lam and gap, which a plan must satisfy.
    """

    trajectories: InitialGuess
    windows: dict[str, Window] = field(default_factory=dict)


@dataclass(frozen=True)
class Sketch:
    """A partial guess: poses, paths of states, and phases of contact; steps count from 0 (the start) to N.

    ``keyframes`` map steps to poses: ``{20: {"hammer": -0.1}, 34: {"hammer": 0.05}}``, or arrays (nx,).
    ``paths`` map names of states to values that are spread evenly over the horizon, such as points of a drawn line;
    keyframes override them. ``contacts`` map names of contacts to the ranges of steps, both ends included, at which
    they are closed: ``{"hammer on nail": [(33, 38)]}``; at all other steps they have no impulse.
    """

    keyframes: Mapping[int, Pose] = field(default_factory=dict)
    paths: Mapping[str, ArrayLike] = field(default_factory=dict)
    contacts: Mapping[str, Sequence[tuple[int, int]]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        ranges = dict[str, list[tuple[Index, Index]]]
        validate_fields(self, "the guess", keyframes=dict[Index, Any], paths=dict[str, Any], contacts=ranges)

    def drawn(self, evaluation: Evaluation) -> UserGuess:
        """Return the interpolated states of keyframes and paths, and the windows that a plan must satisfy.

        Other states are computed if equations without inputs and impulses determine them, such as velocities from
        differences of positions; remaining states, and the inputs, are those of the problem's guess.

        Raises :class:`~ocp.errors.InputError` for an empty sketch, unknown names, steps outside the horizon, and
        values of another shape, not finite, or outside their bounds.
        """
        problem = evaluation.problem
        if not (self.keyframes or self.paths or self.contacts):
            raise InputError("the guess is empty; give keyframes, paths or contacts")
        marks = self.marks(problem)
        self._check_marks(marks, evaluation)
        slack = SLACK * problem.scales.x
        windows = {} if np.isnan(marks).all() else {"x": (marks[1:] - slack, marks[1:] + slack)}
        X, U = evaluation.initial_guess
        return UserGuess((_completed(evaluation, marks, X), U), windows | self._contact_windows(problem))

    def marks(self, problem: Problem) -> np.ndarray:
        """Return the values that keyframes and paths specify, (N+1, nx), NaN elsewhere."""
        N, names = problem.N, [signal.name for signal in problem.system.states]
        index_of = {name: index for index, name in enumerate(names)}
        marks = np.full((N + 1, len(names)), np.nan)
        for name, path in self.paths.items():
            points = _numbers(f"the path of {name}", path)
            if points.ndim != 1 or len(points) < 2:
                raise InputError(f"the path of {name} must be two or more numbers, got the shape {points.shape}")
            steps = np.round(np.linspace(0, N, min(len(points), N + 1))).astype(int)
            positions = steps * (len(points) - 1) / N
            marks[steps, choose("state", name, index_of)] = np.interp(positions, np.arange(len(points)), points)
        for step, pose in self.keyframes.items():
            title = f"the keyframe at step {step}"
            _check_step(title, step, problem)
            if isinstance(pose, Mapping):
                for name, value in pose.items():
                    marks[step, choose("state", name, index_of)] = validated(f"{title}: {name}", value, Number)
                continue
            values = _numbers(title, pose)
            if values.shape != (len(names),):
                raise InputError(f"{title} must have {len(names)} states, {', '.join(names)}; got {values.shape}")
            marks[step] = values
        return marks

    @staticmethod
    def _check_marks(marks: np.ndarray, evaluation: Evaluation) -> None:
        """Raise :class:`~ocp.errors.InputError` for a keyframe outside the bounds, or at step 0 not at the start."""
        problem, limits = evaluation.problem, evaluation.limits
        lower, upper = np.tile(limits.x_lower, (len(marks), 1)), np.tile(limits.x_upper, (len(marks), 1))
        lower[0], upper[0] = evaluation.start_limits
        slack = START_TOLERANCE * problem.scales.x
        outside = np.argwhere((marks < lower - slack) | (marks > upper + slack))
        for step, index in outside[:1]:
            name, value = problem.system.states[index].name, marks[step, index]
            low, high = lower[step, index], upper[step, index]
            allowed = f"{low:g}" if low == high else f"from {low:g} to {high:g}"
            raise InputError(f"the guess has {name} = {value:g} at step {step}, where it must be {allowed}")

    def _contact_windows(self, problem: Problem) -> dict[str, Window]:
        """Return upper bounds (N, nlam) of impulses and gaps: zero gaps for closed, zero impulses for open contacts."""
        if not self.contacts:
            return {}
        system, N = problem.system, problem.N
        index_of = {
            contact.name: index
            for index, (contact, pair) in enumerate(zip(system.contacts, system.pairs, strict=True))
            if pair.kind in ("normal", "limit")
        }
        unbounded, impulse_limits, gap_limits = np.full((3, N, system.nlam), np.nan)
        for name, ranges in self.contacts.items():
            index = choose("contact", name, index_of)
            closed = np.zeros(N + 1, dtype=bool)
            for first, last in ranges:
                _check_step(f"the range of {name}", max(first, last), problem)
                if first > last:
                    raise InputError(f"{name}: the range of steps {first} to {last} is empty")
                closed[first : last + 1] = True
            gap_limits[closed[1:], index] = 0.0
            impulse_limits[~closed[1:], index] = 0.0
        return {"lam": (unbounded, impulse_limits), "gap": (unbounded, gap_limits)}


def _check_step(title: str, step: int, problem: Problem) -> None:
    if step > problem.N:
        raise InputError(f"{title}: {problem.name} has steps 0 to {problem.N}, got {step}")


def _numbers(title: str, value: Any) -> np.ndarray:
    try:
        numbers = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{title} must be numbers, got {abbreviated(value)}") from None
    if not np.isfinite(numbers).all():
        raise InputError(f"{title} must be finite, got {abbreviated(value)}")
    return numbers


def _completed(evaluation: Evaluation, marks: np.ndarray, guess: np.ndarray) -> np.ndarray:
    """Return states (N+1, nx) that agree with marks, and with equations without inputs and impulses.

    Marked states are interpolated between their marks and held after the last one.
    """
    states, is_marked = np.array(guess, dtype=float), ~np.isnan(marks)
    is_marked[0] |= is_marked.any(axis=0)
    values, steps = np.where(np.isnan(marks), guess, marks), np.arange(len(marks))
    for index in np.flatnonzero(is_marked[0]):
        marked_steps = steps[is_marked[:, index]]
        states[:, index] = np.interp(steps, marked_steps, values[marked_steps, index])
    system, free = evaluation.problem.system, np.flatnonzero(~is_marked[0])
    driving, marked_next = ca.vertcat(system.u, system.lam), system.x_next[np.flatnonzero(is_marked[0]).tolist()]
    residuals = ca.vertsplit(ca.SX(system.residual))
    rows = [row for row in residuals if ca.depends_on(row, marked_next) and not ca.depends_on(row, driving)]
    if rows and free.size:
        kinematics = ca.vertcat(*rows)
        slopes = ca.jacobian(kinematics, system.x_next)
        arguments = [system.x, system.x_next, evaluation.problem.parameters.vector]
        linearised = ca.Function("kinematics", arguments, [ca.densify(kinematics), ca.densify(slopes)])
        for state, next_state in pairwise(states):
            residual, slope = (np.array(output) for output in linearised(state, next_state, evaluation.p))
            next_state[free] -= np.linalg.lstsq(slope[:, free], residual.ravel(), rcond=None)[0]
    return states
