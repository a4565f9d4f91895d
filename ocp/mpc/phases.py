"""The feedback phases by name."""

from __future__ import annotations

from dataclasses import dataclass

from dynamics.contact import Barrier, ContactLaw, Exact
from dynamics.learned.laws import LearnedLaw
from ocp.errors import InputError
from ocp.mpc.newton_phase import NewtonPhase
from ocp.mpc.qpcc_phase import QPCC, FixedActiveSet
from ocp.mpc.relaxed_phase import Relaxed

NEWTON: dict[str, type[NewtonPhase]] = {"qpcc": QPCC, "qp": FixedActiveSet, "relaxed": Relaxed}
"""Phases that solve a quadratic program."""


@dataclass(frozen=True)
class PhaseEntry:
    """A phase's name, what it does, and the kind of law that it plans under."""

    name: str
    summary: str
    exact: bool | None

    def law(self, given: ContactLaw | None) -> ContactLaw:
        """The law, by default the exact one, or for a smoothed phase the barrier at mu = 1e-2.

        Raises :class:`~ocp.errors.InputError` for a law that the phase cannot use.
        """
        if isinstance(given, LearnedLaw):
            raise InputError(
                f"{given.name} has no pairs of force and gap, which every phase plans with; choose"
                " exact, barrier, adaptive or randomized"
            )
        if given is None:
            return Barrier(mu=1e-2) if self.exact is False else Exact()
        if self.exact is not None and isinstance(given, Exact) != self.exact:
            right = "the exact law" if self.exact else "a smoothed law such as barrier"
            other = "relaxed" if self.exact else "qpcc"
            raise InputError(
                f"phase {self.name} plans under {right}, not under {given.name}; choose another law, or phase {other}"
            )
        return given


PHASES = {
    entry.name: entry
    for entry in (
        PhaseEntry("full", "solve the whole problem, warm from the solution before", None),
        PhaseEntry("qpcc", "one quadratic program, active set exchanged by multipliers", True),
        PhaseEntry("qp", "one quadratic program, active set of the plan before", True),
        PhaseEntry("relaxed", "one Newton step on a smoothed law", False),
        PhaseEntry("policy", "evaluate a policy or the regulator's gains; no plan", None),
    )
}
