"""The interface of a contact law to a step: mu, and the disturbances at which contact is solved."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import casadi as ca

from dynamics.systems import ContactSystem, ParameterTable


@dataclass(frozen=True, eq=False)
class Branch:
    """One disturbance ``(x + noise_x, u + noise_u)`` at which contact is solved, and its weight."""

    weight: float
    noise_x: ca.SX
    noise_u: ca.SX


@dataclass(frozen=True)
class Schedule:
    """The smoothing parameter of a homotopy to the exact law, from ``wide`` down by ``factor``.

    ``is_mu``: the parameter is the central-path parameter itself.
    """

    parameter: str
    wide: float
    factor: float
    is_mu: bool = False


class Closure(ABC):
    """A closure ``lam_i gap_i = mu_i`` of ``0 <= lam ⟂ gap >= 0``: what mu is, and where.

    :meth:`target` gives mu, :meth:`nodes`, where the law averages over noise, at which
    disturbances the contact is solved.
    """

    name: ClassVar[str]
    exact: ClassVar[bool] = False

    @abstractmethod
    def target(self, system: ContactSystem, z: ca.SX, F: ca.SX, p: ParameterTable) -> ca.SX:
        """Return mu, shape (nlam, 1), from the gap at lam = 0 ``z`` and the compliance ``F``."""

    @property
    def frozen(self) -> bool:
        """Whether gradients treat mu as a constant (algorithm 2 of adaptive barrier smoothing)."""
        return False

    def schedule(self, impulse: float, gap: float) -> Schedule | None:
        """Return the schedule that follows the law down to the exact one, from characteristic sizes.

        ``impulse`` and ``gap`` are in the units of a pair's members. None where no parameter leads
        there as it falls to zero.
        """
        return None

    def nodes(self, system: ContactSystem, p: ParameterTable) -> list[Branch]:
        """Disturbances at which the contact is solved, with their weights; one without noise."""
        zero_x, zero_u = ca.SX.zeros(system.nx), ca.SX.zeros(system.nu)
        return [Branch(1.0, zero_x, zero_u)]
