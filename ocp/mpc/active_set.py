"""Which side of every pair is held at zero, such that the equations of a step stay independent."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ocp.mpc.stages import Plan, StageModel


@dataclass(frozen=True)
class Coulomb:
    """Places of the pairs of one contact with friction in the plane."""

    normal: int
    friction: tuple[int, int]
    slip: int


class ActiveSets:
    """Active sets (N, n): True where a pair is closed, its gap held at zero, its force free.

    Dry friction in the plane has two forces ``beta_i`` along opposite directions and the slip speed
    ``gamma``, ``0 <= beta_i ⟂ gamma + d_i' v >= 0`` and
    ``0 <= gamma ⟂ mu lam - sum beta >= 0``. The last is always closed: then a contact that sticks
    has both forces closed, ``v = gamma = 0`` and ``beta_i >= 0`` is the cone ``|f| <= mu lam``; one
    that slides has the force closed that brakes it, and so has one without normal force, where
    ``beta = 0`` whatever the slip.
    """

    def __init__(self, model: StageModel) -> None:
        self.model = model
        pairs, self.contacts = model.problem.system.pairs, []
        for branch in range(model.step.branches):
            first = branch * len(pairs)
            for owner in {pair.contact for pair in pairs}:
                own = {
                    kind: [first + i for i, pair in enumerate(pairs) if (pair.contact, pair.kind) == (owner, kind)]
                    for kind in ("normal", "friction", "slip")
                }
                if [len(places) for places in own.values()] == [1, 2, 1]:
                    f = own["friction"]
                    self.contacts.append(Coulomb(own["normal"][0], (f[0], f[1]), own["slip"][0]))

    def of(self, plan: Plan) -> np.ndarray:
        """The active set of a plan: a pair is closed where its force is the larger side."""
        lam_size, gap_size = self.model.sizes
        by = plan.lam / lam_size - plan.gap / gap_size
        closed = by > 0
        for contact in self.contacts:
            f = list(contact.friction)
            brakes = np.arange(2) == by[:, f].argmax(axis=1)[:, None]
            sticks = closed[:, contact.normal] & (by[:, contact.slip] <= 0)
            closed[:, f] = brakes | sticks.reshape(-1, 1)
            closed[:, contact.slip] = True
        return closed

    def exchanged(self, closed: np.ndarray, which: np.ndarray) -> np.ndarray:
        """``closed`` with the sides of the pairs ``which`` (N, n) exchanged.

        A contact that opens slides, and one of two friction forces stays closed.
        """
        found = closed ^ which
        for contact in self.contacts:
            f = list(contact.friction)
            found[~found[:, f].any(axis=1), f[0]] = True
            found[found[:, f].all(axis=1) & ~found[:, contact.normal], f[1]] = False
            found[:, contact.slip] = True
        return found

    def frictionless(self, closed: np.ndarray) -> np.ndarray:
        """Pairs (N, n) of friction and slip whose contact is open; their rows say nothing."""
        found = np.zeros_like(closed)
        for contact in self.contacts:
            places = [*contact.friction, contact.slip]
            found[:, places] = ~closed[:, [contact.normal]]
        return found

    def exchangeable(self, closed: np.ndarray) -> np.ndarray:
        """Pairs (N, n) that may change their side alone: of slip none, of friction one of both."""
        found = ~self.frictionless(closed)
        for contact in self.contacts:
            f = list(contact.friction)
            found[:, f] &= closed[:, f].all(axis=1, keepdims=True) | ~closed[:, f]
            found[:, contact.slip] = False
        return found
