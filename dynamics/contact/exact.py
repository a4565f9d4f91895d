"""The exact law: complementarity itself."""

from __future__ import annotations

from typing import ClassVar

import casadi as ca

from dynamics.contact.law import ContactLaw
from dynamics.systems import ContactSystem, ParameterTable


class Exact(ContactLaw):
    """``0 <= lam ⟂ gap >= 0``, that is mu = 0."""

    name: ClassVar[str] = "exact"
    summary: ClassVar[str] = "0 <= lam ⟂ gap >= 0, no smoothing"
    exact: ClassVar[bool] = True

    def parameters(self, system: ContactSystem) -> ParameterTable:
        """No parameters."""
        return ParameterTable()

    def target(self, system: ContactSystem, z: ca.SX, F: ca.SX, p: ParameterTable) -> ca.SX:
        """Zero."""
        return ca.SX.zeros(z.numel())
