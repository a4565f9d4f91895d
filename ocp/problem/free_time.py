"""Free final time: the step size, the same for all steps, is an unknown between two bounds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from dynamics.systems import ContactSystem, Signal
from dynamics.systems.pairs import RefereeModel
from ocp.errors import InputError
from ocp.problem.checks import BY_PARAMETERS
from ocp.problem.parts import Constraint, FreeStart, column, repeat_bound


@dataclass(frozen=True, eq=False)
class FreeStep:
    """Bounds ``lower <= h <= upper`` [s] of a free step size, see :func:`free`."""

    lower: ca.SX
    upper: ca.SX


def free(lower: ca.SX | float, upper: ca.SX | float) -> FreeStep:
    """Return the bounds of an optimised step size: ``Problem(h=free(0.01, 0.05))`` frees the final time ``N h``.

    ``lower`` and ``upper`` [s] are numbers or expressions in the parameters. The system's step size
    must be a parameter, ``p["h"]``, whose value is then the guess. Costs and constraints in ``p["h"]``
    use the optimised step size: ``p["h"] * u**2`` is an integral over the free time, and a terminal
    cost ``N * p["h"]`` is the final time.

    Raises :class:`~ocp.errors.InputError` for bounds that are not two positive numbers in order.
    """
    ends = [column(f"{side} of a free step size", value, 1) for side, value in (("lower", lower), ("upper", upper))]
    if all(end.is_constant() for end in ends):
        low, high = (float(end) for end in ends)
        if not (0 < low <= high < np.inf):
            raise InputError(f"a free step size needs 0 < lower <= upper [s], got {low:g} and {high:g}")
    return FreeStep(*ends)


def with_free_step(problem: Any, step: FreeStep) -> dict[str, Any]:
    """Return the fields of a :class:`~ocp.problem.problem.Problem` that make the step size its last state.

    Raises :class:`~ocp.errors.InputError` if h is not a parameter, or if a bound depends on h.
    """
    name, system = problem.name, problem.system
    step_symbols = [s for s in ca.vertsplit(problem.parameters.vector) if ca.is_equal(s, ca.SX(system.h))]
    if not step_symbols:
        raise InputError(
            f"{name}: the step size is free, but that of the system is not a parameter; build the system with h=p['h']"
        )
    rows = (*problem.path, *problem.terminal)
    bounds = {bound_name: getattr(problem, bound_name) for bound_name in BY_PARAMETERS if bound_name != "x0"}
    bounds |= {f"{side} of {row.name}": getattr(row, side) for row in rows for side in ("lower", "upper")}
    for bound_name, bound in bounds.items():
        if bound is not None and ca.depends_on(ca.SX(bound), step_symbols[0]):
            raise InputError(
                f"{name}: {bound_name} depends on the step size, which is free; write it as a constraint"
                " whose expression has the step size"
            )
    h, h_next = ca.SX.sym("h"), ca.SX.sym("h_next")

    def with_h(value: Any) -> Any:
        return ca.substitute(ca.SX(value), step_symbols[0], h)

    def constraint(row: Constraint) -> Constraint:
        return replace(row, expression=with_h(row.expression))

    nx, start = system.nx, problem.start
    start = FreeStart(problem.x0, problem.x0) if start is None else start
    return {
        "system": _stretched(system, with_h, h, h_next),
        "stage_cost": with_h(problem.stage_cost),
        "terminal_cost": with_h(problem.terminal_cost),
        "x0": ca.vertcat(problem.x0, step_symbols[0]),
        "x_lower": ca.vertcat(repeat_bound(problem.x_lower, nx), step.lower),
        "x_upper": ca.vertcat(repeat_bound(problem.x_upper, nx), step.upper),
        "path": tuple(constraint(row) for row in problem.path),
        "terminal": tuple(constraint(row) for row in problem.terminal),
        "start": FreeStart(
            lower=ca.vertcat(repeat_bound(start.lower, nx), step.lower),
            upper=ca.vertcat(repeat_bound(start.upper, nx), step.upper),
            periodic=start.periodic,
        ),
        "guess": None if problem.guess is None else _stretched_guess(problem.guess),
    }


def _stretched(system: ContactSystem, with_h: Callable[[Any], Any], h: ca.SX, h_next: ca.SX) -> ContactSystem:
    """Return the system with h as a state instead of a parameter, and ``h_next = h`` as its last equation."""

    def each(instance: Any) -> Any:
        changed = {
            field_info.name: with_h(getattr(instance, field_info.name))
            for field_info in fields(instance)
            if isinstance(getattr(instance, field_info.name), ca.SX)
        }
        return replace(instance, **changed)

    referee_model, note, referee_system = None, system.referee_note, system.most_exact
    if note is not None:
        is_same = referee_system is system
        referee_model = RefereeModel(note, None if is_same else lambda: _stretched(referee_system, with_h, h, h_next))
    changed_parts = {
        part_name: each(instance)
        for part_name in ("forces", "energy_balance")
        if is_dataclass(instance := getattr(system, part_name))
    }
    return replace(
        each(system),
        x=ca.vertcat(system.x, h),
        x_next=ca.vertcat(system.x_next, h_next),
        residual=ca.vertcat(with_h(system.residual), h_next - h),
        h=h,
        states=(*system.states, Signal("h", "s", "step size")),
        referee_model=referee_model,
        **changed_parts,
    )


def _stretched_guess(guess: Callable[..., Any]) -> Callable[..., Any]:
    """Return a guess function that appends the start's step size as last state if ``guess`` does not return it."""

    def stretched(problem: Any, p: np.ndarray) -> Any:
        states, inputs = guess(problem, p)
        states = np.asarray(states)
        if states.ndim == 2 and states.shape[1] == problem.system.nx - 1:
            h = problem.initial_states(p)[0, -1]
            states = np.hstack([states, np.full((len(states), 1), h)])
        return states, inputs

    return stretched
