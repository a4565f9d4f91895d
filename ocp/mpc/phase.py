"""Base class of feedback phases, which compute the next plan from a measured state, and the phase without plans."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from ocp.errors import InputError, abbreviated
from ocp.mpc.stages import Plan
from ocp.problem.rollout import Gains

if TYPE_CHECKING:
    from ocp.mpc.compiled_sample import PhaseSample


@dataclass(frozen=True)
class Sample:
    """Data of one sample: measured state (nx,), last input (nu,), parameters (N+1, np), and bounds (nu,) on u.

    ``shift`` is the number of steps, 0 or 1, by which an exchange that the last sample chose is shifted: 1 at samples
    on a whole step of the plan, so at every sample if there is one per step.
    """

    x: np.ndarray
    u_before: np.ndarray
    p: np.ndarray
    bounds: tuple[np.ndarray, np.ndarray]
    shift: int = 1


@dataclass(frozen=True)
class Answer:
    """A phase's answer to a measurement: the input to apply, and the plan that begins with this input.

    ``plan`` is None for a phase without plans. ``note`` describes anything unusual. ``violated`` is true if the
    plan violates a constraint.
    """

    u: np.ndarray
    plan: Plan | None
    status: str = "solved"
    note: str = ""
    merit: float = np.nan
    violated: bool = False


class Phase(ABC):
    """Base class of algorithms that compute an input from a measurement.

    ``prepare`` does the work at the shifted plan that does not need the measurement, and ``feedback`` does the
    rest. ``plans`` is true if the phase computes plans over a receding horizon. ``gain`` (nu, nx) is the
    feedback gain for the step by which the shifted plan is extended. ``programs`` and ``qp_iterations`` are the
    numbers of quadratic programs of the last sample, and of their iterations. ``compiled`` is the compiled code of a
    sample, None without a C compiler and for phases without it.
    """

    plans: ClassVar[bool] = True
    gain: np.ndarray | None = None
    programs: int = 0
    qp_iterations: int = 0
    compiled: PhaseSample | None = None

    @abstractmethod
    def prepare(self, plan: Plan, sample: Sample) -> None:
        """Evaluate, linearise and factorise at a plan, with the parameters of ``sample``."""

    def prepare_best(self, plans: Sequence[Plan], sample: Sample) -> None:
        """Prepare the best of several plans; by default the first one."""
        self.prepare(plans[0], sample)

    @abstractmethod
    def feedback(self, sample: Sample) -> Answer:
        """Return the input and plan that answer a measurement."""

    def warm_up(self, sample: Sample) -> Answer:
        """Answer the first measurement, when the plan belongs to another contact law or another state."""
        return self.feedback(sample)


def numbers(label: str, value: Any, *shapes: tuple[int, ...], finite: bool = False) -> np.ndarray:
    """Return ``value`` as an array of floats of one of the ``shapes``, or of any shape if none is given.

    Raises :class:`~ocp.errors.InputError` for any other value, and if ``finite`` also for NaN and infinity.
    """
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{label} must be numbers, got {abbreviated(value)}") from None
    if finite and not np.isfinite(array).all():
        raise InputError(f"{label} must be finite, got {abbreviated(value)}")
    if shapes and array.shape not in shapes:
        expected = " or ".join(" x ".join(map(str, shape)) for shape in shapes)
        raise InputError(f"{label} must have {expected} numbers, got {array.size}")
    return array


Law = Callable[[np.ndarray, int], np.ndarray]
"""Feedback ``u = law(x, k)`` of the state (nx,) at sample k, counted from 0."""


class FixedPolicy(Phase):
    """Phase that evaluates the feedback ``u = law(x, k)``, or gains, and clips the input to its bounds."""

    plans = False

    def __init__(self, law: Law | Gains, nu: int) -> None:
        self.law: Law = (lambda x, k: law.input(k, x)) if isinstance(law, Gains) else law
        self.nu, self.count = nu, 0

    def prepare(self, plan: Plan, sample: Sample) -> None:
        """Do nothing; there is no plan."""

    def feedback(self, sample: Sample) -> Answer:
        """Evaluate the feedback law; raise :class:`~ocp.errors.InputError` unless it returns nu numbers."""
        u = np.ravel(self.law(sample.x, self.count))
        u = numbers("the policy's input", u, (self.nu,))
        self.count += 1
        if not np.isfinite(u).all():
            note = "the policy's input is not finite; the previous input is used"
            return Answer(np.clip(sample.u_before, *sample.bounds), None, "kept", note)
        return Answer(np.clip(u, *sample.bounds), None)
