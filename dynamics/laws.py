"""Every law that closes a system by name: those of contact, and those that were learned."""

from __future__ import annotations

from dynamics.contact import Adaptive, Barrier, ContactLaw, Exact, Randomized
from dynamics.learned.laws import Ewda, Mlp

# Contact laws by the name that requests use.
LAWS: dict[str, type[ContactLaw]] = {law.name: law for law in (Exact, Barrier, Adaptive, Randomized, Ewda, Mlp)}
