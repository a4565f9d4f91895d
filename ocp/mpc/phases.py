"""Table of the feedback phases of a controller."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from dynamics.contact import Barrier, ContactLaw, Exact
from dynamics.learned.laws import LearnedLaw
from ocp.errors import InputError
from ocp.mpc.full_phase import Full
from ocp.mpc.newton_phase import MAX_WARM_UP_PROGRAMS, NewtonPhase, Relaxed
from ocp.mpc.phase import FixedPolicy, Phase
from ocp.mpc.qpcc_phase import QPCC, FixedActiveSet
from ocp.mpc.rollouts import CandidateRollouts
from ocp.mpc.stages import StageModel
from ocp.routes.homotopy import RouteResult
from ocp.routes.session import Session


@dataclass(frozen=True)
class PhaseParts:
    """Parts of a controller from which a phase is built; ``solved`` is None if no first plan was solved."""

    session: Session
    model: StageModel
    rollouts: CandidateRollouts
    exact: bool
    iterations: int
    budget: int | None
    solved: RouteResult | None


def soft_phase(
    model: StageModel, rollouts: CandidateRollouts, exact: bool, iterations: int = 1, budget: int | None = None
) -> NewtonPhase:
    """Return a phase with soft constraints: :class:`QPCC` for the exact law, :class:`Relaxed` for smoothed laws."""
    return (QPCC if exact else Relaxed)(model, rollouts, iterations, budget)


def _newton(phase: type[NewtonPhase]) -> Callable[[PhaseParts, Any], Phase]:
    return lambda parts, law: phase(parts.model, parts.rollouts, parts.iterations, parts.budget)


def _full(parts: PhaseParts, law: Any) -> Phase:
    softer = soft_phase(parts.model, parts.rollouts, parts.exact, MAX_WARM_UP_PROGRAMS, parts.budget)
    assert parts.solved is not None
    return Full(parts.session, parts.model, parts.solved, softer)


@dataclass(frozen=True)
class PhaseEntry:
    """Table entry of a phase: name, summary, kind of contact law of its plans, and constructor.

    ``exact`` is true for the exact law, false for smoothed laws, and None if the phase accepts any law.
    ``plans`` is true if the phase computes plans.
    """

    name: str
    summary: str
    exact: bool | None
    build: Callable[[PhaseParts, Any], Phase]
    plans: bool = True

    def law(self, law: ContactLaw | None) -> ContactLaw:
        """Return ``law``; if None, the exact law, or the barrier law with mu = 1e-2 for a smoothed phase.

        Raises :class:`~ocp.errors.InputError` for a law that the phase cannot use.
        """
        if isinstance(law, LearnedLaw):
            raise InputError(
                f"{law.name} has no pairs of force and gap, which every phase plans with; choose"
                " exact, barrier, adaptive or randomized"
            )
        if law is None:
            return Barrier(mu=1e-2) if self.exact is False else Exact()
        if self.exact is not None and isinstance(law, Exact) != self.exact:
            right = "the exact law" if self.exact else "a smoothed law such as barrier"
            phase = "relaxed" if self.exact else "qpcc"
            raise InputError(
                f"phase {self.name} plans under {right}, not under {law.name}; choose another law, or phase {phase}"
            )
        return law


PHASES = {
    entry.name: entry
    for entry in (
        PhaseEntry("full", "solve the whole problem, warm-started from the last solution", None, _full),
        PhaseEntry("qpcc", "one quadratic program, active set exchanged by multipliers", True, _newton(QPCC)),
        PhaseEntry("qp", "one quadratic program, active set of the last plan", True, _newton(FixedActiveSet)),
        PhaseEntry("relaxed", "one Newton step on a smoothed law", False, _newton(Relaxed)),
        PhaseEntry(
            "policy",
            "evaluate a policy or the regulator's gains; no plan",
            None,
            lambda parts, law: FixedPolicy(law, parts.model.nu),
            plans=False,
        ),
    )
}
"""Mapping from names to the feedback phases of a controller."""
