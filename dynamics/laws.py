"""The table of all contact laws, analytic and learned."""

from __future__ import annotations

from dynamics.contact import Adaptive, Barrier, ContactLaw, Exact, Randomized
from dynamics.learned.laws import Ewda, Mlp

# Mapping from the name that requests use to the class of the contact law.
LAWS: dict[str, type[ContactLaw]] = {law.name: law for law in (Exact, Barrier, Adaptive, Randomized, Ewda, Mlp)}
