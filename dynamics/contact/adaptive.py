"""The adaptive contact law, whose mu is a function of the distance to contact and known before a step is solved."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import casadi as ca

from dynamics.contact.closure import Schedule
from dynamics.contact.interior_point import scalar_solution
from dynamics.contact.law import ContactLaw, by_mu, by_sigma, law_parameter
from dynamics.contact.normal import expected_excess
from dynamics.errors import InputError
from dynamics.settings import setting
from dynamics.systems import ContactSystem, ParameterTable

MU_FLOOR = 1e-10
"""mu [N s m] of the quartic law if no contact is inactive."""
ACTIVE_IMPULSE = 1.0
"""Impulse [N s] above which a contact is active for the quartic law."""
_QUARTIC = {"mu_max": 1e-2, "scale": 100.0, "power": 4.0}
DEFAULT_PARAMETERS = {"gaussian": {"sigma": 0.02}, "quartic": _QUARTIC, "quartic-per-contact": _QUARTIC}
"""Mapping from the name of mu(z) to the default values of its parameters."""


def gaussian_mu(z: ca.SX, F: ca.SX, sigma: ca.SX | float) -> ca.SX:
    """Return mu(z) for which the softened contact equals Gaussian randomized smoothing.

    ``kappa = (sigma pdf(z/sigma) - z tail(z/sigma)) / F = E[S_0(z + w)]``, w ~ N(0, sigma²), and
    ``mu = kappa (z + F kappa) > 0``: mu is even in z and at most sigma²/(2 pi F). This corrects eq. 5.1 of
    adaptive barrier smoothing, whose printed tail, sign and scale are wrong.
    """
    # Not fabs: its derivative at 0 is 0 in CasADi, and the second derivative of mu would be wrong.
    distance = ca.if_else(z < 0, -z, z)
    mean_impulse = sigma * expected_excess(distance / sigma) / F
    return mean_impulse * (distance + F * mean_impulse)


def quartic_mu(distance: ca.SX, mu_max: ca.SX | float, scale: ca.SX | float, power: ca.SX | float) -> ca.SX:
    """Return ``mu_max (scale d² + 1)^-power`` (adaptive barrier smoothing, eq. C.2), with d the ``distance`` [m]."""
    return mu_max * (scale * distance**2 + 1) ** (-power)


@dataclass(eq=False, repr=False)
class Adaptive(ContactLaw):
    """Contact law ``lam_i gap_i = mu_i(z)``; z is the gap at lam = 0, a function of state and input.

    ``law="gaussian"``: :func:`gaussian_mu` of each contact, parameter ``contact.sigma`` [m].
    ``law="quartic"``: :func:`quartic_mu` of the smallest |z| over the inactive contacts, parameters
    ``contact.mu_max``, ``contact.scale``, ``contact.power``. In adaptive barrier smoothing, eq. C.2,
    a contact is active when its softened impulse exceeds 1 N s, which depends on mu itself; here
    that impulse is the closed form of the single contact at ``mu_max``, known before the step. If no contact is
    inactive, mu is 1e-10. ``law="quartic-per-contact"`` uses |z| of each contact. ``law=f``: any function ``f(z, F)
    -> mu`` of CasADi expressions.

    ``gradient="total"`` differentiates mu as well; ``"frozen"`` treats it as a constant, as in algorithm 2 of
    adaptive barrier smoothing. The result is then not the gradient of the rollout, and a direct transcription
    rejects the law.
    """

    name: ClassVar[str] = "adaptive"
    summary: ClassVar[str] = "lam gap = mu(z), large near contact and close to zero far from it"

    law: str | Callable[[ca.SX, ca.SX], ca.SX] = setting("gaussian", "mu(z)", words=tuple(DEFAULT_PARAMETERS))
    sigma: float | None = setting(None, "gaussian: width of the noise; 0.02 if not given", "m", above=0)
    mu_max: float | None = setting(None, "quartic: mu at a distance of 0; 0.01 if not given", "N s m", above=0)
    scale: float | None = setting(None, "quartic: factor of the distance squared; 100 if not given", "1/m²", above=0)
    power: float | None = setting(None, "quartic: exponent by which mu falls with it; 4 if not given", above=0)
    gradient: str = setting(
        "total", "derivative of mu; frozen treats mu as a constant, for shooting only", words=("total", "frozen")
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        parameters = {name: getattr(self, name) for name in ("sigma", "mu_max", "scale", "power")}
        defaults = DEFAULT_PARAMETERS.get(str(self.law), {})
        for name, value in parameters.items():
            if value is not None and name not in defaults:
                names = ", ".join(defaults) or "no parameter"
                raise InputError(f"adaptive: {name} does not belong to law {self.law!r}; it takes {names}")
        self.values = {
            name: default if parameters[name] is None else parameters[name] for name, default in defaults.items()
        }

    @property
    def frozen(self) -> bool:
        """Whether gradients treat mu as a constant."""
        return self.gradient == "frozen"

    def schedule(self, impulse: float, gap: float) -> Schedule | None:
        """Return the homotopy along ``contact.sigma`` or ``contact.mu_max``; None if mu(z) is a user's function."""
        if self.law == "gaussian":
            return by_sigma(gap)
        return by_mu("mu_max", impulse, gap) if self.values else None

    def settings(self) -> dict[str, float | int | str]:
        """Return the name of mu(z), the gradient's kind and the parameter values, for the run's record."""
        label = self.law if isinstance(self.law, str) else getattr(self.law, "__name__", "user")
        return {"law": label, "gradient": self.gradient, **self.values}

    def at(self, **values: float) -> Adaptive:
        """Return the same law with some parameter values replaced."""
        return Adaptive(law=self.law, gradient=self.gradient, **{**self.values, **values})

    def parameters(self, system: ContactSystem) -> ParameterTable:
        """Return the parameters ``contact.<name>`` of the chosen mu(z)."""
        meaning = {
            "sigma": (system.gap_unit, "standard deviation of the matched noise on the gap"),
            "mu_max": ("N s m", "mu at zero distance"),
            "scale": ("1/m^2", "exponent of the decrease of mu with distance"),
            "power": ("1", "decay exponent"),
        }
        return ParameterTable(law_parameter(n, v, *meaning[n]) for n, v in self.values.items())

    def target(self, system: ContactSystem, z: ca.SX, F: ca.SX, p: ParameterTable) -> ca.SX:
        """Return mu(z) of each contact, shape (n, 1)."""
        if callable(self.law):
            mu = self.law(z, F)
            return ca.SX.ones(z.numel()) * mu if mu.numel() == 1 else mu
        diagonal = ca.diag(F)
        if self.law == "gaussian":
            return gaussian_mu(z, diagonal, p["contact.sigma"])
        arguments = [p[f"contact.{name}"] for name in ("mu_max", "scale", "power")]
        if self.law == "quartic-per-contact":
            return quartic_mu(ca.fabs(z), *arguments)
        impulse = scalar_solution(z, diagonal, arguments[0])
        inactive = impulse <= ACTIVE_IMPULSE
        distance = ca.mmin(ca.if_else(inactive, ca.fabs(z), 1e30))
        has_inactive = ca.mmax(inactive) > 0
        mu = ca.if_else(has_inactive, quartic_mu(ca.if_else(has_inactive, distance, 0), *arguments), MU_FLOOR)
        return ca.SX.ones(z.numel()) * mu
