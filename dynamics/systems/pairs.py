"""Complementarity pairs of a system: kinds, forces, uniqueness; and its sharpest contact."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING, Literal

import casadi as ca
import numpy as np

if TYPE_CHECKING:
    from dynamics.systems.system import ContactSystem


Kind = Literal["normal", "friction", "slip", "limit", "table"]


@dataclass(frozen=True)
class Pair:
    """One pair ``lam ⟂ gap``: its kind, and the number of the contact or limit it belongs to.

    ``normal``: an impulse along the normal (or along an edge of the friction cone) against a
    distance. ``friction``: an impulse along the tangent against the slip in its direction.
    ``slip``: the slip against what is left of the friction cone. ``limit``: the impulse of a joint
    limit against the way to it. ``table``: ways that a body slides on a table against what is left
    of the friction there; all of one body have one number.
    """

    kind: Kind
    contact: int


@dataclass(frozen=True, eq=False)
class ContactForces:
    """Total forces of the pairs of every contact, for audits and pictures.

    ``normal`` and ``tangential`` (points, 1) are impulses [N s], expressions in (x, u, lam) and the
    parameters; ``slip`` (points, 1) the tangential velocity [m/s] that the law of friction sees, in
    (x, u, x_next); ``friction`` (points, 1) Coulomb's coefficients. In space ``tangential`` and
    ``slip`` are (2 points, 1), along first and then along second tangents, and friction's pyramid
    has so many ``edges``.
    """

    names: tuple[str, ...]
    normal: ca.SX
    tangential: ca.SX
    slip: ca.SX
    friction: ca.SX
    edges: int = 2


@dataclass(frozen=True, eq=False)
class EnergyBalance:
    """Energy [J] of a state, and the work [J] done over one step by all but contact.

    ``energy`` is an expression in x, ``work`` in (x, u, x_next): actuation and damping. What is
    left of ``energy(x_next) - energy(x) - work`` is what contact gave or took, and the
    integrator's error. ``momentum`` (2 or 3, 1) [N s] is an expression in x, ``external`` [N s]
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
    return [normal.get(pair.contact, i) if pair.kind in ("friction", "slip") else i for i, pair in enumerate(pairs)]


# Random states at which F is looked at.
_N_PROBES = 3
# Relative size of a singular value, and of a gap, that counts as zero.
_RANK_TOLERANCE = 1e-9
_MAX_ENUMERATED_CONTACTS = 10
"""Contacts up to which every set of them is looked at where F has not full rank."""


def has_open_multipliers(pairs: tuple[Pair, ...], contact: ca.Function, parameters: np.ndarray) -> bool:
    """Whether contacts may leave multipliers open, so that F is no P-matrix.

    ``contact`` maps (x, u, p) to F (n, n) and z (n, 1), the gap being ``z + F lam``.
    Friction may, and the edges of a friction cone, which are one contact where it closes. Of other
    contacts a set may whose block of F is singular, at any state and the parameters' defaults,
    unless its gaps have a combination ``n' gap = n' z`` that no multiplier moves and that is the
    same everywhere and not zero, as the distance of two walls: such a set never closes at once.
    """
    owners = [pair.contact for pair in pairs if pair.kind == "normal"]
    if any(pair.kind == "friction" for pair in pairs) or len(set(owners)) < len(owners):
        return True
    n, probes = len(pairs), _probes(contact, parameters)
    if all(np.linalg.matrix_rank(F) == n for F, _ in probes):
        return False
    if n > _MAX_ENUMERATED_CONTACTS:
        return True
    sets = (list(rows) for size in range(1, n + 1) for rows in combinations(range(n), size))
    return any(_may_close_at_once(probes, rows) for rows in sets)


def _probes(contact: ca.Function, parameters: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """F and z at random states and inputs, where they are numbers."""
    sizes = contact.numel_in(0), contact.numel_in(1)
    rng, samples = np.random.default_rng(0), []
    for _ in range(_N_PROBES):
        F, z = contact(*(rng.normal(size=size) for size in sizes), parameters)
        samples.append((np.array(F), np.array(z).ravel()))
    return [(F, z) for F, z in samples if np.all(np.isfinite(F)) and np.all(np.isfinite(z))]


def _may_close_at_once(probes: list[tuple[np.ndarray, np.ndarray]], rows: list[int]) -> bool:
    """Whether the block of F is singular and nothing keeps these gaps from closing together."""
    gap_sizes = []
    for F, z in probes:
        left_vectors, size, _ = np.linalg.svd(F[np.ix_(rows, rows)])
        unmoved = left_vectors[:, size <= _RANK_TOLERANCE * max(1.0, size.max())]
        if not unmoved.shape[1]:
            return False
        gap_sizes.append(float(np.linalg.norm(unmoved.T @ z[rows])))
    constant = np.ptp(gap_sizes) <= _RANK_TOLERANCE * max(gap_sizes)
    return not (constant and min(gap_sizes) > _RANK_TOLERANCE)


# Notes on the most exact model: what it improves.
ITSELF = "the model itself"
TRUE_GAPS = "true gaps"
COULOMB = "Coulomb friction with maximum dissipation"
# Random poses at which a gap is compared with a distance.
_N_REST_POSES = 5
# Tolerance of this comparison, relative and absolute [m].
_REST_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False)
class RefereeModel:
    """The most exact model of the same system: ``note`` states its improvement.

    ``build`` makes it: the same x, u, x_next and parameters, lam and gap its own, so that the same
    states and inputs can be replayed. None where nothing sharper than the model is known.
    """

    note: str = ITSELF
    build: Callable[[], ContactSystem] | None = None


def by_true_distance(system: ContactSystem) -> RefereeModel | None:
    """Sharpen a system written by hand, without a builder; None without geometry.

    Where its gaps are those of frictionless contacts, one for each distance ``phi`` [m], and equal
    phi for bodies that rest, they are taken for expansions of phi, and the true ones put in their
    place. A gap with the law of a bounce or of a spring in it is left as it is.
    """
    phi = system.phi
    if phi is None:
        return None
    is_frictionless = (
        system.forces is None
        and system.gap_unit == "m"
        and phi.numel() == system.nlam == sum(pair.kind == "normal" for pair in system.pairs)
        and ca.depends_on(system.gap, system.x_next)
        and not ca.depends_on(system.gap, system.lam)
    )
    affine = not ca.depends_on(ca.jacobian(phi, system.x), system.x)
    if not is_frictionless or affine or not _is_distance_at_rest(system, phi):
        return RefereeModel()
    phi_next = ca.substitute(phi, system.x, system.x_next)
    if ca.is_equal(phi_next, system.gap, 100):
        return RefereeModel()
    return RefereeModel(TRUE_GAPS, lambda: replace(system, gap=phi_next, referee_model=RefereeModel()))


def _is_distance_at_rest(system: ContactSystem, phi: ca.SX) -> bool:
    """Whether the gap is phi where neither state nor positions change, at a few random poses."""
    gaps_at_rest = ca.Function(
        "both",
        [system.x, system.u, system.parameters.vector],
        [ca.substitute(system.gap, system.x_next, system.x), phi],
    )
    poses = np.array(ca.DM(ca.jacobian_sparsity(phi, system.x), 1)).any(axis=0)
    rng = np.random.default_rng(0)
    for _ in range(_N_REST_POSES):
        x = np.where(poses, rng.normal(size=system.nx), 0.0)
        gap, distance = (np.array(v) for v in gaps_at_rest(x, np.zeros(system.nu), system.parameters.values))
        if not np.allclose(gap, distance, rtol=_REST_TOLERANCE, atol=_REST_TOLERANCE):
            return False
    return True
