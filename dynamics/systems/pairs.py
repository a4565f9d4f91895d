"""What each complementarity pair of a system stands for, and the forces that pairs add up to."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import casadi as ca

Kind = Literal["normal", "friction", "slip", "limit"]


@dataclass(frozen=True)
class Pair:
    """One pair ``lam ⟂ gap``: its kind, and the number of the contact or limit it belongs to.

    ``normal``: an impulse along the normal (or along an edge of the friction cone) against a
    distance. ``friction``: an impulse along the tangent against the slip in its direction.
    ``slip``: the slip against what is left of the friction cone. ``limit``: the impulse of a joint
    limit against the way to it.
    """

    kind: Kind
    contact: int


@dataclass(frozen=True, eq=False)
class ContactForces:
    """What the pairs of every contact add up to, for audits and pictures.

    ``normal`` and ``tangential`` (points, 1) are impulses [N s], expressions in (x, u, lam) and the
    parameters; ``slip`` (points, 1) the tangential velocity [m/s] that the law of friction sees, in
    (x, u, x_next); ``friction`` (points, 1) Coulomb's coefficients.
    """

    names: tuple[str, ...]
    normal: ca.SX
    tangential: ca.SX
    slip: ca.SX
    friction: ca.SX


@dataclass(frozen=True, eq=False)
class EnergyBook:
    """Energy [J] of a state, and the work [J] done over one step by all but contact.

    ``energy`` is an expression in x, ``work`` in (x, u, x_next): actuation and damping. What is
    left of ``energy(x_next) - energy(x) - work`` is what contact gave or took, and the
    integrator's error. ``momentum`` (2, 1) [N s] is an expression in x, ``external`` (2, 1) [N s]
    the impulse from outside over one step, contact included, in (x, u, x_next, lam); what
    ``momentum`` gains beyond it is the integrator's error, of the order of h² in a step.
    """

    energy: ca.SX
    work: ca.SX
    momentum: ca.SX
    external: ca.SX


def deciding_pairs(pairs: tuple[Pair, ...]) -> list[int]:
    """For every pair the number of the pair whose distance decides its mu.

    A friction or slip pair goes with the normal pair of its contact: how soft a contact is depends
    on how near it is, not on how fast it slides. Edges of a cone, normal pairs both, decide for
    themselves, and so do the pairs of a contact whose normal force is known.
    """
    normal = {pair.contact: i for i, pair in enumerate(pairs) if pair.kind == "normal"}
    return [
        normal.get(pair.contact, i) if pair.kind in ("friction", "slip") else i
        for i, pair in enumerate(pairs)
    ]
