"""What a feedback phase is: it turns a measured state into the next plan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from ocp.errors import InputError, abbreviated
from ocp.mpc.stages import Plan


@dataclass(frozen=True)
class Sample:
    """A measurement: state (nx,), last input (nu,), parameters (N+1, np), bounds on u (nu,)."""

    x: np.ndarray
    u_before: np.ndarray
    p: np.ndarray
    bounds: tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Answer:
    """The input to apply and the plan behind it; ``why`` says what was not as usual.

    ``violated``: the plan violates a constraint.
    """

    u: np.ndarray
    plan: Plan | None
    status: str = "solved"
    why: str = ""
    merit: float = np.nan
    violated: bool = False


class Phase(Protocol):
    """One way to answer a measurement.

    ``prepare`` does all that needs no measurement, for the plan shifted by one step; ``feedback``
    does the rest.
    """

    def prepare(self, plan: Plan, sample: Sample) -> None:
        """Evaluate, linearise and factorise at a plan, with the parameters of ``sample``."""
        ...

    def feedback(self, sample: Sample) -> Answer:
        """Answer a measurement."""
        ...


def numbers(what: str, value: Any, size: int) -> np.ndarray:
    """Return ``value`` as an array (size,), which may hold NaN.

    Raises :class:`~ocp.errors.InputError` for what is not ``size`` numbers.
    """
    try:
        array = np.asarray(value, dtype=float).ravel()
    except (TypeError, ValueError):
        raise InputError(f"{what} must be {size} numbers, got {abbreviated(value)}") from None
    if array.size != size:
        raise InputError(f"{what} must have {size} numbers, got {array.size}")
    return array
