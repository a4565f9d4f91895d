"""The log-barrier contact law, with the same constant mu for all contacts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import casadi as ca

from dynamics.contact.closure import Schedule
from dynamics.contact.law import ContactLaw, by_mu, law_parameter
from dynamics.errors import InputError
from dynamics.settings import setting
from dynamics.systems import ContactSystem, ParameterTable

DEFAULT_MU = 1e-3
"""Default mu [N s m], used if neither mu nor kappa is given."""


@dataclass(eq=False, repr=False)
class Barrier(ContactLaw):
    """Contact law ``lam_i gap_i = mu``, the optimality condition of a log-barrier on each gap.

    Give ``mu`` [N s m] or the barrier weight ``kappa`` [1/J] of Suh et al. on pathologies of
    differentiable simulators, eq. 4, which the system converts: ``mu = h / kappa`` for a gap in position,
    ``1 / kappa`` for quasi-dynamics; without both mu is :data:`DEFAULT_MU`. For one contact the law
    equals randomized smoothing of the exact law with heavy-tailed noise, Student's t with two degrees
    of freedom and scale ``sqrt(2 F mu)``; its tail is the force at a distance.

    Raises ``ValueError`` if both are given, or if the one given is not positive and finite; :meth:`close` also raises
    ``ValueError`` for a system without a conversion for kappa.
    """

    name: ClassVar[str] = "barrier"
    summary: ClassVar[str] = "lam gap = mu, a fixed log-barrier"

    mu: float | None = setting(
        None,
        f"lam gap; {DEFAULT_MU:g} where kappa is not given either",
        "N s m",
        hint="for mu = 0 use the exact law",
        above=0,
    )
    kappa: float | None = setting(
        None, "weight of the log-barrier, in place of mu; mu is proportional to 1/kappa", "1/J", above=0
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.mu is not None and self.kappa is not None:
            raise InputError("barrier: give mu or kappa, not both; each determines the other")
        if self.mu is None and self.kappa is None:
            self.mu = DEFAULT_MU

    def schedule(self, impulse: float, gap: float) -> Schedule | None:
        """Return the homotopy along ``contact.mu``; None for kappa, which grows towards the exact law."""
        return by_mu("mu", impulse, gap) if self.mu is not None else None

    def parameters(self, system: ContactSystem) -> ParameterTable:
        """Return the parameter ``contact.mu`` or ``contact.kappa``."""
        if self.mu is not None:
            return ParameterTable([law_parameter("mu", self.mu, "N s m", "central-path parameter")])
        if system.mu_per_kappa is None:
            raise ValueError(
                f"barrier: system {system.name!r} has no log-barrier energy that converts kappa; give mu instead"
            )
        assert self.kappa is not None
        return ParameterTable([law_parameter("kappa", self.kappa, "1/J", "log-barrier weight")])

    def target(self, system: ContactSystem, z: ca.SX, F: ca.SX, p: ParameterTable) -> ca.SX:
        """Return mu, the same for all contacts, shape (n, 1)."""
        if "contact.mu" in p:
            return ca.SX.ones(z.numel()) * p["contact.mu"]
        assert system.mu_per_kappa is not None
        return ca.SX.ones(z.numel()) * system.mu_per_kappa / p["contact.kappa"]
