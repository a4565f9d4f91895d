"""Contact laws (exact, barrier, adaptive, randomized) and the step of a system closed by one of them."""

from dynamics.contact.adaptive import Adaptive
from dynamics.contact.affine_step import AffineStep
from dynamics.contact.barrier import Barrier
from dynamics.contact.exact import Exact
from dynamics.contact.implicit_step import ImplicitStep
from dynamics.contact.law import ContactLaw
from dynamics.contact.randomized import Randomized
from dynamics.contact.step import Step

__all__ = [
    "Adaptive",
    "AffineStep",
    "Barrier",
    "ContactLaw",
    "Exact",
    "ImplicitStep",
    "Randomized",
    "Step",
]
