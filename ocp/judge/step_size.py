"""The step size of a model: a parameter, a state, or a fixed part of the model that cannot be refined."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import casadi as ca

from dynamics.systems import ContactSystem


@dataclass(frozen=True)
class StepSize:
    """Source of a model's step size h: the name of a ``parameter``, or the index of a ``state``.

    A step size of kind "fixed" cannot be refined; ``reason`` says why.
    """

    kind: Literal["fixed", "parameter", "state"]
    parameter: str = ""
    state: int = -1
    reason: str = ""


def step_size_kind(system: ContactSystem) -> StepSize:
    """Return the source of a system's step size, which says whether it may be refined."""
    if not system.refinable:
        return StepSize("fixed", reason="the step size is part of the model")
    if any(signal.unit == "N s" for signal in system.inputs):
        return StepSize("fixed", reason="an input is an impulse per step, which depends on the step size")
    state = index_of_symbol(system.h, system.x)
    if state is not None:
        return StepSize("state", state=state)
    index = index_of_symbol(system.h, system.parameters.vector)
    if index is None:
        return StepSize("fixed", reason="the step size is not a parameter of the model")
    return StepSize("parameter", system.parameters.names[index])


def step_state(system: ContactSystem) -> list[int]:
    """Return the index of the state that is the step size, in a list that is empty if no state is."""
    step_size = step_size_kind(system)
    return [step_size.state] if step_size.kind == "state" else []


def index_of_symbol(symbol: ca.SX | float, symbols: ca.SX) -> int | None:
    """Return the index of a symbol in a column of symbols, or None if the column does not contain it."""
    expression = ca.SX(symbol)
    return next((i for i in range(symbols.numel()) if ca.is_equal(expression, symbols[i])), None)
