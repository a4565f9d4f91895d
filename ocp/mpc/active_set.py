"""Active sets of plans: the choice of one side of each complementarity pair, such that equations are independent."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ocp.mpc.stages import Plan, StageModel


@dataclass(frozen=True)
class Coulomb:
    """Indices of the complementarity pairs of one contact with Coulomb friction, of m forces along its directions."""

    normal: int
    friction: tuple[int, ...]
    slip: int

    @property
    def is_spatial(self) -> bool:
        """Whether the friction cone is a pyramid."""
        return len(self.friction) > 2


class ActiveSets:
    """Rules for active sets (N, n): True for a closed pair, whose gap is zero and whose force is free.

    Dry friction in the plane has two forces ``beta_i`` along opposite directions and the slip speed ``gamma``,
    ``0 <= beta_i ⟂ gamma + d_i' v >= 0`` and ``0 <= gamma ⟂ mu lam - sum beta >= 0``. The slip pair, of gamma,
    is always closed. In a sticking contact both friction pairs are closed, so that ``v = gamma = 0`` and
    ``beta_i >= 0`` is the friction cone ``|f| <= mu lam``. In a sliding contact only the pair of the braking
    force is closed. In an open contact one friction pair is closed as well; there ``beta = 0`` at any slip speed.

    The pyramid of a contact in space has m = 4 or 8 forces. One that slides has all pairs closed whose force brakes:
    one at a corner of the pyramid, two along its edge. One that sticks has all closed, which is m equations for
    ``v = gamma = 0``; the compliance of closed pairs shares the changes among the forces that cancel each other, so
    that ``beta >= 0`` is a part of the cone, centred at the plan's force. These pairs are not exchanged alone.
    """

    def __init__(self, model: StageModel) -> None:
        self.model = model
        pairs = model.problem.system.pairs
        self.contacts: list[Coulomb] = []
        for branch in range(model.step.branches):
            first = branch * len(pairs)
            for owner in {pair.contact for pair in pairs}:
                indices_by_kind = {
                    kind: [first + i for i, pair in enumerate(pairs) if (pair.contact, pair.kind) == (owner, kind)]
                    for kind in ("normal", "friction", "slip")
                }
                normal, friction, slip = indices_by_kind.values()
                if len(normal) == len(slip) == 1 and len(friction) > 1:
                    self.contacts.append(Coulomb(normal[0], tuple(friction), slip[0]))

    def of(self, plan: Plan) -> np.ndarray:
        """Return a plan's active set: a pair is closed if its scaled force is larger than its scaled gap."""
        lam_size, gap_size = self.model.sizes
        dominance = plan.lam / lam_size - plan.gap / gap_size
        closed = dominance > 0
        for contact in self.contacts:
            f, touches = list(contact.friction), closed[:, [contact.normal]]
            brakes = np.arange(len(f)) == dominance[:, f].argmax(axis=1)[:, None]
            sticks = touches & (dominance[:, [contact.slip]] <= 0)
            closed[:, f] = brakes | sticks | (contact.is_spatial & touches & closed[:, f])
            closed[:, contact.slip] = True
        return closed

    def exchange(self, closed: np.ndarray, pairs: np.ndarray) -> np.ndarray:
        """Return the active set ``closed`` with the sides of the pairs in the mask ``pairs`` (N, n) exchanged.

        If a contact opens, the pair of one of its friction forces stays closed.
        """
        exchanged = closed ^ pairs
        for contact in self.contacts:
            f = list(contact.friction)
            exchanged[~exchanged[:, f].any(axis=1), f[0]] = True
            is_later = exchanged[:, f].cumsum(axis=1) > 1
            exchanged[:, f] &= exchanged[:, [contact.normal]] | ~is_later
            exchanged[:, contact.slip] = True
        return exchanged

    def frictionless(self, closed: np.ndarray) -> np.ndarray:
        """Return a mask (N, n) of the friction and slip pairs of open contacts, which constrain nothing."""
        frictionless = np.zeros_like(closed)
        for contact in self.contacts:
            indices = [*contact.friction, contact.slip]
            frictionless[:, indices] = ~closed[:, [contact.normal]]
        return frictionless

    def exchangeable(self, closed: np.ndarray) -> np.ndarray:
        """Return a mask (N, n) of the pairs that may be exchanged alone.

        These are all pairs except slip pairs, the only closed friction pair of a contact, and those of a contact in
        space that sticks.
        """
        exchangeable = ~self.frictionless(closed)
        for contact in self.contacts:
            f = list(contact.friction)
            count = closed[:, f].sum(axis=1, keepdims=True)
            exchangeable[:, f] &= ~closed[:, f] | ((count > 1) & ~(contact.is_spatial & (count == len(f))))
            exchangeable[:, contact.slip] = False
        return exchangeable
