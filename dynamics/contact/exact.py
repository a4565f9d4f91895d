"""The exact contact law, complementarity without smoothing."""

from __future__ import annotations

from typing import ClassVar

import casadi as ca

from dynamics.contact.law import ContactLaw
from dynamics.systems import ContactSystem, ParameterTable


class Exact(ContactLaw):
    """Contact law ``0 <= lam ⟂ gap >= 0``, the limit mu = 0."""

    name: ClassVar[str] = "exact"
    summary: ClassVar[str] = "0 <= lam ⟂ gap >= 0, no smoothing"
    exact: ClassVar[bool] = True

    def parameters(self, system: ContactSystem) -> ParameterTable:
        """Return an empty table: the law has no parameters."""
        return ParameterTable()

    def target(self, system: ContactSystem, z: ca.SX, F: ca.SX, p: ParameterTable) -> ca.SX:
        """Return mu = 0 of each contact, shape (n, 1)."""
        return ca.SX.zeros(z.numel())
