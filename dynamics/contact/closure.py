"""The interface between contact laws and steps: mu, and the disturbances at which contact is solved."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import casadi as ca

from dynamics.systems import ContactSystem, ParameterTable


@dataclass(frozen=True, eq=False)
class Branch:
    """One disturbance ``(x + noise_x, u + noise_u)`` at which contact is solved, with its weight."""

    weight: float
    noise_x: ca.SX
    noise_u: ca.SX


@dataclass(frozen=True)
class Schedule:
    """Homotopy to the exact law: the smoothing ``parameter``, its ``first_value``, and its ``factor`` per stage.

    ``is_mu`` says that the parameter is the central-path parameter itself.
    """

    parameter: str
    first_value: float
    factor: float
    is_mu: bool = False


class Closure(ABC):
    """A relation ``lam_i gap_i = mu_i`` that closes a system in place of ``0 <= lam ⟂ gap >= 0``.

    :meth:`target` gives mu, and :meth:`nodes` the disturbances at which the contact is solved, several if the law
    averages over noise.
    """

    name: ClassVar[str]
    exact: ClassVar[bool] = False

    @abstractmethod
    def target(self, system: ContactSystem, z: ca.SX, F: ca.SX, p: ParameterTable) -> ca.SX:
        """Return mu (nlam, 1), given ``z``, the gap at lam = 0, and ``F``, the compliance."""

    @property
    def frozen(self) -> bool:
        """Whether gradients treat mu as a constant (algorithm 2 of adaptive barrier smoothing)."""
        return False

    def schedule(self, impulse: float, gap: float) -> Schedule | None:
        """Return the homotopy from this law to the exact one; None if no parameter of the law tends to zero.

        ``impulse`` and ``gap`` are characteristic magnitudes of a pair's lam and gap, in their units.
        """
        return None

    def nodes(self, system: ContactSystem, p: ParameterTable) -> list[Branch]:
        """Return the disturbances at which contact is solved, with weights; by default no disturbance with weight 1."""
        zero_x, zero_u = ca.SX.zeros(system.nx), ca.SX.zeros(system.nu)
        return [Branch(1.0, zero_x, zero_u)]
