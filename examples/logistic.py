"""A contact law: the exact one averaged over logistic noise in the gap."""

from dataclasses import dataclass
from typing import ClassVar

import casadi as ca

from dynamics.contact import ContactLaw
from dynamics.contact.closure import Schedule
from dynamics.contact.law import law_parameter
from dynamics.settings import setting
from dynamics.systems import LAW_PREFIX, ContactSystem, ParameterTable


def softplus(t: ca.SX) -> ca.SX:
    """``log(1 + exp(t))``, without overflow."""
    size = ca.if_else(t < 0, -t, t)
    return (t + size) / 2 + ca.log1p(ca.exp(-size))


@dataclass(eq=False, repr=False)
class Logistic(ContactLaw):
    """``lam_i gap_i = mu_i(z)`` with z the gap at lam = 0 and F the compliance of the contact.

    The exact law ``S_0(z) = max(0, -z)/F``, averaged over logistic noise of scale ``width`` [m], is
    ``kappa = width softplus(-z/width)/F``, and ``mu = kappa (z + F kappa)`` is what makes it the
    softened contact: ``width² softplus(-z/width) softplus(z/width)/F``. It tends to the exact law:
    ``0 <= kappa - S_0 <= width log(2)/F``. Its tail is exponential, between the barrier law's
    1/z and a Gaussian's.
    """

    name: ClassVar[str] = "logistic"
    summary: ClassVar[str] = "lam gap = mu(z), the average over logistic noise"

    width: float = setting(0.01, "scale of the noise", "m", hint="for width = 0 use the exact law", above=0)

    def parameters(self, system: ContactSystem) -> ParameterTable:
        """``contact.width``."""
        width = law_parameter("width", self.width, system.gap_unit, "scale of the noise")
        return ParameterTable([width])

    def schedule(self, impulse: float, gap: float) -> Schedule:
        """Along ``contact.width``, gently, since narrow noise sees nothing far."""
        return Schedule(LAW_PREFIX + "width", 3 * gap, 0.5)

    def target(self, system: ContactSystem, z: ca.SX, F: ca.SX, p: ParameterTable) -> ca.SX:
        """mu of every contact, by its own compliance."""
        width = p[LAW_PREFIX + "width"]
        return width**2 / ca.diag(F) * softplus(-z / width) * softplus(z / width)
