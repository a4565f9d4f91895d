"""Base class of feedback phases, which turn a measured state into the next plan."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

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
    """The input to apply and the plan behind it; ``note`` describes anything unusual.

    ``violated`` is true if the plan violates a constraint.
    """

    u: np.ndarray
    plan: Plan | None
    status: str = "solved"
    note: str = ""
    merit: float = np.nan
    violated: bool = False


class Phase(ABC):
    """One way to answer a measurement.

    ``prepare`` does all that needs no measurement, for the plan shifted by one step; ``feedback``
    does the rest. ``plans`` says whether the horizon recedes; ``gain`` (nu, nx) extends the shifted
    plan by a step.
    """

    plans: ClassVar[bool] = True
    gain: np.ndarray | None = None

    @abstractmethod
    def prepare(self, plan: Plan, sample: Sample) -> None:
        """Evaluate, linearise and factorise at a plan, with the parameters of ``sample``."""

    @abstractmethod
    def feedback(self, sample: Sample) -> Answer:
        """Answer a measurement."""

    def warm_up(self, sample: Sample) -> Answer:
        """Answer the first measurement, whose plan is from another law or state."""
        return self.feedback(sample)


def numbers(what: str, value: Any, *shapes: tuple[int, ...], finite: bool = False) -> np.ndarray:
    """Return ``value`` as an array of one of the ``shapes``, by default of any shape.

    Raises :class:`~ocp.errors.InputError` for anything else.
    """
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{what} must be numbers, got {abbreviated(value)}") from None
    if finite and not np.isfinite(array).all():
        raise InputError(f"{what} must be finite, got {abbreviated(value)}")
    if shapes and array.shape not in shapes:
        expected = " or ".join(" x ".join(map(str, shape)) for shape in shapes)
        raise InputError(f"{what} must have {expected} numbers, got {array.size}")
    return array
