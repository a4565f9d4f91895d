"""The protocol of a contact law: how it closes the complementarity of a system."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import casadi as ca
import numpy as np

from dynamics.contact.step import Branch, Step
from dynamics.systems import ContactSystem, Parameter, ParameterTable


@dataclass(frozen=True)
class Schedule:
    """The knob that leads a law to the exact one: followed from ``wide`` down by ``factor``.

    ``is_mu`` says that the knob is the central-path parameter itself.
    """

    knob: str
    wide: float
    factor: float
    is_mu: bool = False


def by_mu(knob: str, impulse: float, gap: float) -> Schedule:
    """Follow a central-path parameter from where impulse and gap have their own sizes."""
    return Schedule(f"contact.{knob}", impulse * gap, 0.2, knob == "mu")


def by_sigma(gap: float) -> Schedule:
    """Follow a width of noise, gently: its tail is Gaussian, so narrow noise sees nothing far."""
    return Schedule("contact.sigma", 3 * gap, 0.55)


class ContactLaw(ABC):
    """A closure ``lam_i gap_i = mu_i`` of ``0 <= lam ⟂ gap >= 0``.

    A law says what mu is (:meth:`target`), which of its knobs a study may turn (:meth:`knobs`,
    each named ``contact.<knob>`` and a parameter of every graph), and, where it averages over
    noise, at which disturbances the contact is solved (:meth:`nodes`).
    """

    name: ClassVar[str]
    summary: ClassVar[str]
    exact: ClassVar[bool] = False

    @abstractmethod
    def knobs(self, system: ContactSystem) -> ParameterTable:
        """Parameters of the law for this system, with units and values."""

    @abstractmethod
    def target(self, system: ContactSystem, z: ca.SX, F: ca.SX, knobs: ParameterTable) -> ca.SX:
        """Return mu, shape (nlam, 1), from the gap at lam = 0 ``z`` and the compliance ``F``."""

    @property
    def frozen(self) -> bool:
        """Whether gradients treat mu as a constant (algorithm 2 of adaptive barrier smoothing)."""
        return False

    def schedule(self, impulse: float, gap: float) -> Schedule | None:
        """How the law is followed down to the exact one, from a problem's characteristic sizes.

        ``impulse`` and ``gap`` are in the units of a pair's members. None where no knob leads there
        as it falls to zero.
        """
        return None

    def settings(self) -> dict[str, float | int | str]:
        """Return what was chosen, for the run's record."""
        return {key: value for key, value in vars(self).items() if value is not None}

    def nodes(self, system: ContactSystem, knobs: ParameterTable) -> list[Branch]:
        """Disturbances at which the contact is solved, with their weights; one without noise."""
        zero_x, zero_u = ca.SX.zeros(system.nx), ca.SX.zeros(system.nu)
        return [Branch(1.0, zero_x, zero_u)]

    def close(self, system: ContactSystem) -> Step:
        """Close the contact of ``system``: one :class:`~dynamics.contact.step.Step`."""
        knobs = self.knobs(system)
        return Step.build(system, self, knobs)

    def at(self, **values: float) -> ContactLaw:
        """Return the same law with other values of its settings."""
        arguments = {**self.settings(), **values}
        return type(self)(**arguments)  # pyright: ignore[reportCallIssue]


def knob(name: str, value: float, unit: str, description: str) -> Parameter:
    """Make the parameter ``contact.<name>`` of a law.

    Raises ``ValueError`` unless ``value`` is positive and finite.
    """
    return Parameter(f"contact.{name}", positive("contact", name, value), unit, description)


def positive(law: str, name: str, value: float, hint: str = "") -> float:
    """Return ``value`` as a positive finite float or say what was wrong."""
    number = float(value)
    if not (math.isfinite(number) and number > 0):
        tail = f"; {hint}" if hint else ""
        raise ValueError(f"{law}: {name} must be positive and finite, got {value}{tail}")
    return number


def whole(law: str, name: str, value: float, low: int, high: int) -> int:
    """Return ``value`` as an integer in [low, high] or say what was wrong."""
    if not float(value).is_integer() or not low <= value <= high:
        raise ValueError(f"{law}: {name} must be a whole number from {low} to {high}, got {value}")
    return int(np.int64(value))
