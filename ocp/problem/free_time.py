"""A free final time: the step size of every step is one unknown, between two bounds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from dynamics.systems import ContactSystem, Signal
from dynamics.systems.pairs import RefereeModel
from ocp.errors import InputError
from ocp.problem.parts import Constraint, FreeStart, column

_KEPT = ("u_before", "u_lower", "u_upper", "x_lower", "x_upper")


@dataclass(frozen=True, eq=False)
class FreeStep:
    """``lower <= h <= upper`` [s], see :func:`free`."""

    lower: ca.SX
    upper: ca.SX


def free(lower: ca.SX | float, upper: ca.SX | float) -> FreeStep:
    """A step size that is chosen too: ``Problem(h=free(0.01, 0.05))`` frees the final time ``N h``.

    ``lower`` and ``upper`` [s] are numbers or expressions in the parameters. The system's step size
    must be a parameter, ``p["h"]``, whose value is then where the search begins. Costs and
    constraints in ``p["h"]`` follow the chosen one: ``p["h"] * u**2`` is an integral over the free
    time, and a terminal cost ``N * p["h"]`` is the final time.

    Raises :class:`~ocp.errors.InputError` for bounds that are not two positive numbers in order.
    """
    ends = [column(f"{side} of a free step size", value, 1) for side, value in (("lower", lower), ("upper", upper))]
    if all(end.is_constant() for end in ends):
        low, high = (float(end) for end in ends)
        if not (0 < low <= high < np.inf):
            raise InputError(f"a free step size needs 0 < lower <= upper [s], got {low:g} and {high:g}")
    return FreeStep(*ends)


def with_free_step(problem: Any, step: FreeStep) -> dict[str, Any]:
    """The fields of a :class:`~ocp.problem.problem.Problem` whose last state is the step size.

    Raises :class:`~ocp.errors.InputError` where h is no parameter, or a bound depends on it.
    """
    name, system = problem.name, problem.system
    given = [s for s in ca.vertsplit(problem.parameters.vector) if ca.is_equal(s, ca.SX(system.h))]
    if not given:
        raise InputError(
            f"{name}: the step size is free, but that of the system is not a parameter; build the system with h=p['h']"
        )
    rows = (*problem.path, *problem.terminal)
    bounds = {what: getattr(problem, what) for what in _KEPT}
    bounds |= {f"{side} of {one.name}": getattr(one, side) for one in rows for side in ("lower", "upper")}
    for what, bound in bounds.items():
        if bound is not None and ca.depends_on(ca.SX(bound), given[0]):
            raise InputError(
                f"{name}: {what} depends on the step size, which is free; write it as a constraint"
                " whose expression has the step size"
            )
    h, h_next = ca.SX.sym("h"), ca.SX.sym("h_next")

    def put(value: Any) -> Any:
        return ca.substitute(ca.SX(value), given[0], h)

    def constraint(one: Constraint) -> Constraint:
        return replace(one, expression=put(one.expression))

    nx, start = system.nx, problem.start
    start = FreeStart(problem.x0, problem.x0) if start is None else start
    return {
        "system": _stretched(system, put, h, h_next),
        "stage_cost": put(problem.stage_cost),
        "terminal_cost": put(problem.terminal_cost),
        "x0": ca.vertcat(problem.x0, given[0]),
        "x_lower": ca.vertcat(_every(problem.x_lower, nx), step.lower),
        "x_upper": ca.vertcat(_every(problem.x_upper, nx), step.upper),
        "path": tuple(constraint(one) for one in problem.path),
        "terminal": tuple(constraint(one) for one in problem.terminal),
        "start": FreeStart(
            lower=ca.vertcat(_every(start.lower, nx), step.lower),
            upper=ca.vertcat(_every(start.upper, nx), step.upper),
            periodic=start.periodic,
        ),
        "guess": None if problem.guess is None else _stretched_guess(problem.guess),
    }


def _every(bound: ca.SX | float, nx: int) -> ca.SX:
    value = ca.SX(bound)
    return ca.repmat(value, nx // value.numel(), 1)


def _stretched(system: ContactSystem, put: Callable[[Any], Any], h: ca.SX, h_next: ca.SX) -> ContactSystem:
    """The system with h in place of its parameter, and ``h_next = h`` as its last state."""

    def each(part: Any) -> Any:
        changed = {
            one.name: put(getattr(part, one.name)) for one in fields(part) if isinstance(getattr(part, one.name), ca.SX)
        }
        return replace(part, **changed)

    referee_model, note, sharpest = None, system.referee_note, system.most_exact
    if note is not None:
        same = sharpest is system
        referee_model = RefereeModel(note, None if same else lambda: _stretched(sharpest, put, h, h_next))
    parts = {what: each(part) for what in ("forces", "energy_balance") if is_dataclass(part := getattr(system, what))}
    return replace(
        each(system),
        x=ca.vertcat(system.x, h),
        x_next=ca.vertcat(system.x_next, h_next),
        residual=ca.vertcat(put(system.residual), h_next - h),
        h=h,
        states=(*system.states, Signal("h", "s", "step size")),
        referee_model=referee_model,
        **parts,
    )


def _stretched_guess(guess: Callable[..., Any]) -> Callable[..., Any]:
    """The guess with the start's step size beside its states, where it has none."""

    def stretched(problem: Any, p: np.ndarray) -> Any:
        states, inputs = guess(problem, p)
        states = np.asarray(states)
        if states.ndim == 2 and states.shape[1] == problem.system.nx - 1:
            h = problem.initial_states(p)[0, -1]
            states = np.hstack([states, np.full((len(states), 1), h)])
        return states, inputs

    return stretched
