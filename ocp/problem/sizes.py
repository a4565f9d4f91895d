"""Characteristic sizes of a problem, derived from its data if the user does not state them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from ocp.problem.parts import Scales
from ocp.programs.units import dimension

if TYPE_CHECKING:
    from ocp.problem.problem import Problem

GAP_SHARE = 0.1
"""Characteristic gap, as a fraction of the change of gaps when states change by their sizes."""
_DOUBTFUL = 1e3
"""Ratio of a stated size and the derived size above which the stated size is doubtful."""
_AT_REST = 1e-6
"""Motion of a state up to which it is at rest, relative to its motion in a step without contact."""
DIFFERENCE_ROUNDING = 1e-12
"""Difference, relative to the largest entry, below which it counts as rounding error."""


def derive_sizes(problem: Problem, x: np.ndarray | None = None) -> Scales:
    """Return the characteristic sizes of a problem, in SI units, derived at its default parameter values.

    If ``x`` (nx,) is given, it contains the sizes of the states.

    A state's size is the maximum of two distances from x0: the distance that the guess and its exact rollout
    reach, and the distance to the goal, from one Newton step on each cost and on each terminal constraint that
    x0 violates. States with the same unit have the same, largest size. The size of a velocity is at least the size
    of its position over the horizon; a position without size gets the distance that its velocity
    covers. A state without any of these sizes gets the change that changes gaps as much as other states do, or
    else the distance to its bounds, or else x0. An input's size is half the width of its bounds, or
    the input that moves a state by its size within the horizon, or else one Newton step of the stage
    cost. The size of an impulse changes a state by the state's size; the size of a gap is
    :data:`GAP_SHARE` times its change as states change by their sizes.
    """
    data = _Data(problem)
    x = data.state_sizes() if x is None else x
    u = data.input_sizes(x)
    return Scales(data.impulse(x), GAP_SHARE * data.typical_gap_change(x), x, u)


def describe_sizes(problem: Problem) -> str:
    """Return the derived sizes as text with units, the largest size of each unit; "" if no size is derived."""
    system, scales = problem.system, problem.scales
    sizes = {"impulse": {"N s": scales.impulse}, "gap": {"m": scales.gap}, "x": {}, "u": {}}
    for name, signals in (("x", system.states), ("u", system.inputs)):
        for size, signal in zip(getattr(scales, name), signals, strict=True):
            unit = signal.unit.removeprefix("1")
            sizes[name][unit] = max(float(size), sizes[name].get(unit, 0.0))
    return "; ".join(
        f"{name} " + ", ".join(f"{size:.2g} {unit}".rstrip() for unit, size in sizes[name].items())
        for name in problem.scaling.derived
        if sizes[name]
    )


def doubtful_sizes(problem: Problem) -> list[str]:
    """Return a clause on each stated size that differs from the derived size by a factor above :data:`_DOUBTFUL`."""
    stated, derived = problem.scales, derive_sizes(problem)
    doubts = []
    for name in ("impulse", "gap", "x", "u"):
        ratio = np.max(getattr(stated, name)) / np.max(getattr(derived, name))
        if not 1 / _DOUBTFUL <= ratio <= _DOUBTFUL:
            doubts.append(f"{name} is {ratio:.2g} times what the problem's data give")
    return doubts


def gap_changes(problem: Problem, x_sizes: np.ndarray) -> np.ndarray:
    """Return the first-order change (nlam,) of each gap as states change by ``x_sizes``.

    It is the larger of the changes by the state and by the next state, at x0; The result is NaN for pairs whose gap
    is neither the distance of a contact nor the distance to a joint limit.
    """
    return _Data(problem).gap_changes(x_sizes)


def residual_changes(problem: Problem, x_sizes: np.ndarray) -> np.ndarray:
    """Return the largest change (nx,) of each row of the step's residual as one next state changes by its size.

    Changes are of first order, at x0.
    """
    system = problem.system
    changes = _Data(problem).at_start(ca.jacobian(system.residual, system.x_next))
    return np.max(np.abs(changes) * x_sizes, axis=1, initial=0.0)


class _Data:
    """Quantities of a problem at its default parameter values, from which sizes are derived."""

    def __init__(self, problem: Problem) -> None:
        self.problem, self.system = problem, problem.system
        self.p = problem.parameters.values
        limits = [np.array(v).ravel() for v in problem.limits(self.p)]
        self.x0, self.u_before, self.u_lower, self.u_upper, self.x_lower, self.x_upper = limits
        h = float(ca.Function("h", [self.system.x, problem.parameters.vector], [ca.SX(self.system.h)])(self.x0, self.p))
        self.duration = h * problem.N if np.isfinite(h) and h > 0 else 1.0
        self.dimensions = [dimension(signal.unit) for signal in self.system.states]

    def state_sizes(self) -> np.ndarray:
        """Return the sizes of the states (nx,)."""
        travels = np.fmax(self._travel(), self._goal_distance())
        travels[list(self.system.rotating_entries)] = 1.0
        sizes = self._linked(self._by_unit(travels))
        for fallback in (self._by_gaps, self._bound_widths, lambda _: np.abs(self.x0)):
            if np.all(sizes > 0):
                break
            sizes = self._linked(self._by_unit(np.where(sizes > 0, sizes, fallback(sizes))))
        return np.where(sizes > 0, sizes, 1.0)

    def input_sizes(self, x: np.ndarray) -> np.ndarray:
        """Return the sizes of the inputs (nu,) for states of sizes x (nx,)."""
        widths = (self.u_upper - self.u_lower) / 2
        effects = np.abs(self._inputs_over_horizon()) / x[:, None]
        with np.errstate(divide="ignore"):
            sizes_by_effect = 1 / effects.max(axis=0, initial=0.0)
        sizes = np.where(np.isfinite(widths) & (widths > 0), widths, sizes_by_effect)
        newton_steps = self._newton_step(self.problem.stage_cost, self.system.u)
        sizes = np.where(np.isfinite(sizes), sizes, newton_steps)
        return np.where(sizes > 0, sizes, 1.0)

    def impulse(self, x: np.ndarray) -> float:
        """Return the median impulse that changes velocities by their sizes, or positions by their sizes / N."""
        orders = np.array([0.0 if d is None else -d[2] for d in self.dimensions])
        within_step = np.where(orders > 0, x, x / self.problem.N)
        effect = self.at_start(self.system.reduced.B)[:, self._distances()] / within_step[:, None]
        candidates = []
        for contact in np.abs(effect).T:
            changes = [contact[rows & (contact > 0)] for rows in self._units()]
            typical = [np.median(change) for change in changes if change.size]
            candidates += [1 / max(typical)] if typical else []
        usable = [candidate for candidate in candidates if np.isfinite(candidate)]
        return float(np.median(usable)) if usable else 1.0

    def typical_gap_change(self, x: np.ndarray) -> float:
        """Return the median change of gaps as states change by their sizes; without contacts, the largest length."""
        changes = self.gap_changes(x)
        usable = changes[np.isfinite(changes) & (changes > 0)]
        if usable.size:
            return float(np.median(usable))
        lengths = [size for size, signal in zip(x, self.system.states, strict=True) if signal.unit == "m"]
        return float(max(lengths, default=1.0))

    def gap_changes(self, x: np.ndarray) -> np.ndarray:
        """Return the changes of gaps (nlam,), see the module's function :func:`gap_changes`."""
        system = self.system
        by_state = [ca.jacobian(system.gap, symbol) for symbol in (system.x, system.x_next)]
        largest = np.max([np.abs(self.at_start(J)) * x for J in by_state], axis=0)
        changes = np.full(system.nlam, np.nan)
        changes[self._distances()] = largest.max(axis=1, initial=0.0)[self._distances()]
        return changes

    def _distances(self) -> np.ndarray:
        """Return the indices of the pairs whose gap is the distance of a contact or from a joint limit."""
        kinds = [pair.kind in ("normal", "limit") for pair in self.system.pairs]
        return np.flatnonzero(kinds)

    def at_start(self, expression: ca.SX) -> np.ndarray:
        """Return the value of an expression at rest in x0 without contact impulses."""
        evaluate = ca.Function("at_start", self.problem.step_symbols, [ca.densify(expression)])
        return np.nan_to_num(np.array(evaluate(self.x0, self.u_before, self.x0, 0, self.p)))

    def _travel(self) -> np.ndarray:
        """Return the largest distances (nx,) from x0 of the guess and its exact rollout, 0 for rounding errors."""
        states, inputs = self.problem.initial_guess(self.p)
        step = self.problem.exact_step
        named = dict(zip(self.problem.parameters.names, self.p, strict=True))
        values, x = step.p.pack({**step.p.defaults, **named}), np.array(states[0], dtype=float)
        farthest = np.abs(states - self.x0).max(axis=0)
        for u in inputs:
            x = np.array(step.solve(x, u, values)[0]).ravel()
            if not np.all(np.isfinite(x)):
                break
            farthest = np.fmax(farthest, np.abs(x - self.x0))
        # Bodies at rest on the ground seem to move by the solver's error, which is small relative to free fall.
        free = self._by_unit(np.abs(self.at_start(self.system.reduced.a).ravel() - self.x0))
        noise = np.fmax(DIFFERENCE_ROUNDING * np.abs(self.x0).max(initial=0.0), _AT_REST * free)
        return np.where(farthest > noise, farthest, 0.0)

    def _goal_distance(self) -> np.ndarray:
        """Return the distance (nx,) of every state from x0 to the goals of costs and terminal constraints."""
        problem, x = self.problem, self.system.x
        rows = ca.vertcat(ca.SX(0, 1), *(c.expression for c in problem.terminal))
        low = ca.vertcat(ca.SX(0, 1), *(c.lower for c in problem.terminal))
        high = ca.vertcat(ca.SX(0, 1), *(c.upper for c in problem.terminal))
        violation = ca.fmax(low - rows, 0) + ca.fmax(rows - high, 0)
        away = np.abs(self.at_start(violation)), np.abs(self.at_start(ca.jacobian(rows, x)))
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = np.nan_to_num(away[0] / away[1], posinf=0.0).max(axis=0, initial=0.0)
            for cost in (problem.stage_cost, problem.terminal_cost):
                distance = np.fmax(distance, self._newton_step(cost, x))
        return distance

    def _newton_step(self, cost: ca.SX, by: ca.SX) -> np.ndarray:
        """Return the distance (n,) of each symbol from the minimum of the cost in this symbol, 0 without curvature."""
        du = ca.SX.sym("du", self.system.nu) if self.problem.du is None else self.problem.du
        slope, curvature = (
            self.at_start(ca.substitute(derivative, du, 0 * du)).ravel()
            for derivative in (ca.gradient(cost, by), ca.diag(ca.hessian(cost, by)[0]))
        )
        with np.errstate(divide="ignore", invalid="ignore"):
            newton = np.where(
                curvature > DIFFERENCE_ROUNDING * curvature.max(initial=0.0), np.abs(slope / curvature), 0
            )
        return np.nan_to_num(newton, posinf=0.0)

    def _by_gaps(self, sizes: np.ndarray) -> np.ndarray:
        """Return the change (nx,) of each state that changes a gap as much as the states with known ``sizes`` do."""
        by_state = np.abs(self.at_start(ca.jacobian(self.system.gap, self.system.x_next)))
        by_state = by_state[self._distances()]
        gap_changes = (by_state * sizes).max(axis=1, initial=0.0)[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            sizes_by_gap = np.where((by_state > 0) & (gap_changes > 0), gap_changes / by_state, 0.0)
        return sizes_by_gap.max(axis=0, initial=0.0)

    def _bound_widths(self, _: np.ndarray) -> np.ndarray:
        """Return the distance (nx,) of every state at x0 from its more distant finite bound, zero without one."""
        with np.errstate(invalid="ignore"):
            ends = np.abs([self.x_lower - self.x0, self.x_upper - self.x0])
        return np.where(np.isfinite(ends), ends, 0.0).max(axis=0)

    def _inputs_over_horizon(self) -> np.ndarray:
        """Return the change of the state (nx, nu) due to unit inputs held over the horizon, without contact.

        The step is linearised; the change is limited to N times the change of one step, since an unstable
        motion amplifies the effect of an input.
        """
        s = self.system
        A, B = (self.at_start(ca.jacobian(s.reduced.a, by)) for by in (s.x, s.u))
        change, largest_change = np.zeros_like(B), self.problem.N * np.abs(B)
        for _ in range(self.problem.N):
            change = np.clip(A @ change + B, -largest_change, largest_change)
        return np.abs(change)

    def _units(self) -> list[np.ndarray]:
        """Return a list with one mask (nx,) per unit, which selects the states with this unit."""
        units = np.array([signal.unit for signal in self.system.states])
        return [units == unit for unit in dict.fromkeys(units)]

    def _by_unit(self, sizes: np.ndarray) -> np.ndarray:
        """Return sizes (nx,) in which every state has the largest of the ``sizes`` of states with the same unit."""
        shared = np.zeros_like(sizes)
        for rows in self._units():
            shared[rows] = sizes[rows].max()
        return shared

    def _linked(self, sizes: np.ndarray) -> np.ndarray:
        """Return sizes (nx,) in which positions and velocities are consistent over the horizon's duration T.

        The size of a velocity is at least its position's size divided by T; a position of size 0 gets its velocity's
        size times T.
        """
        linked = sizes.copy()
        for i, of_position in enumerate(self.dimensions):
            for j, of_velocity in enumerate(self.dimensions):
                if of_position is None or of_velocity is None:
                    continue
                if not np.array_equal(of_position - of_velocity, (0, 0, 1)):
                    continue
                linked[j] = max(linked[j], sizes[i] / self.duration)
                if sizes[i] == 0:
                    linked[i] = max(linked[i], sizes[j] * self.duration)
        return self._by_unit(linked)
