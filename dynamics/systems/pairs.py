"""Complementarity pairs of a system (kinds, forces, uniqueness), and the most exact model of a system."""

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
    """One complementarity pair ``lam ⟂ gap``: its kind, and the index of its contact or limit.

    The kinds are, as lam and gap: ``normal``, an impulse along the normal (or along an edge of the
    friction cone) and a distance; ``friction``, an impulse along the tangent and the slip in its direction;
    ``slip``, the slip and the margin of the friction cone; ``limit``, the impulse of a joint limit and the
    distance from it; ``table``, a distance that a body slides on a table and the margin of friction there. All
    table pairs of one body have the same index.
    """

    kind: Kind
    contact: int


@dataclass(frozen=True, eq=False)
class ContactForces:
    """Total impulses at each contact, for audits and figures.

    ``normal`` and ``tangential`` (points, 1) are impulses [N s], expressions in (x, u, lam) and the
    parameters; ``slip`` (points, 1) is the tangential velocity [m/s] that the friction law uses, in
    (x, u, x_next); ``friction`` (points, 1) are Coulomb's coefficients. In space ``tangential`` and
    ``slip`` are (2 points, 1), along first and then along second tangents; ``edges`` is the number
    of edges of the friction pyramid.
    """

    names: tuple[str, ...]
    normal: ca.SX
    tangential: ca.SX
    slip: ca.SX
    friction: ca.SX
    edges: int = 2


@dataclass(frozen=True, eq=False)
class EnergyBalance:
    """Energy [J] and momentum of a state, and the work and the external impulse of one step.

    ``energy`` is an expression in x, ``work`` [J] of actuation and damping in (x, u, x_next);
    ``energy(x_next) - energy(x) - work`` is the energy that contact adds or removes, plus the
    integrator's error. ``momentum`` (2 or 3, 1) [N s] is an expression in x, ``external`` [N s]
    the external impulse over one step, contact included, in (x, u, x_next, lam); the change of
    ``momentum`` beyond it is the integrator's error, of the order of h² in a step.
    """

    energy: ca.SX
    work: ca.SX
    momentum: ca.SX
    external: ca.SX


def deciding_pairs(pairs: tuple[Pair, ...]) -> list[int]:
    """Return, for each pair, the index of the pair whose distance sets its mu.

    For a friction or slip pair this is the normal pair of its contact: the smoothing of a contact depends on
    its distance, not on its sliding speed. For edges of a cone, which are normal pairs, and for pairs of a contact
    whose normal force is known, the index is the pair's own.
    """
    normal = {pair.contact: i for i, pair in enumerate(pairs) if pair.kind == "normal"}
    return [normal.get(pair.contact, i) if pair.kind in ("friction", "slip") else i for i, pair in enumerate(pairs)]


# Number of random states at which F is evaluated.
_N_PROBES = 3
# Relative size up to which a singular value or the change of a gap counts as zero.
_RANK_TOLERANCE = 1e-9
_MAX_ENUMERATED_CONTACTS = 10
"""Maximum number of pairs for which all subsets are checked if F does not have full rank."""


def has_open_multipliers(pairs: tuple[Pair, ...], contact: ca.Function, parameters: np.ndarray) -> bool:
    """Return whether multipliers may be non-unique, in which case F is not a P-matrix.

    ``contact`` maps (x, u, p) to F (n, n) and z (n, 1), the gap being ``z + F lam``. Multipliers may be
    non-unique with friction, and with edges of a friction cone, which close at the same time. Multipliers of other
    contacts may be non-unique if a set of contacts has a singular block of F at random states and default
    parameters, unless a combination ``n' gap = n' z`` of the set's gaps, independent of lam, is a nonzero
    constant, such as the distance between two walls: the contacts of such a set are never closed at the same
    time.
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
    """Return F (n, n) and z (n,) at random states and inputs; samples that are not finite are left out."""
    sizes = contact.numel_in(0), contact.numel_in(1)
    rng, samples = np.random.default_rng(0), []
    for _ in range(_N_PROBES):
        F, z = contact(*(rng.normal(size=size) for size in sizes), parameters)
        samples.append((np.array(F), np.array(z).ravel()))
    return [(F, z) for F, z in samples if np.all(np.isfinite(F)) and np.all(np.isfinite(z))]


def _may_close_at_once(probes: list[tuple[np.ndarray, np.ndarray]], rows: list[int]) -> bool:
    """Return whether the block of F at these ``rows`` is singular and all gaps of the rows may close together."""
    gap_sizes = []
    for F, z in probes:
        left_vectors, size, _ = np.linalg.svd(F[np.ix_(rows, rows)])
        unmoved = left_vectors[:, size <= _RANK_TOLERANCE * max(1.0, size.max())]
        if not unmoved.shape[1]:
            return False
        gap_sizes.append(float(np.linalg.norm(unmoved.T @ z[rows])))
    constant = np.ptp(gap_sizes) <= _RANK_TOLERANCE * max(gap_sizes)
    return not (constant and min(gap_sizes) > _RANK_TOLERANCE)


# Notes on the differences between the most exact model and the system.
ITSELF = "the model itself"
TRUE_GAPS = "true gaps"
COULOMB = "Coulomb friction with maximum dissipation"
# Number of random poses at which a gap is compared with a distance.
_N_REST_POSES = 5
# Relative and absolute [m] tolerance in the comparison of gaps with distances.
_REST_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False)
class RefereeModel:
    """The most exact model of a system; ``note`` says what it adds to the system's own model.

    ``build`` returns this model, with the same x, u, x_next and parameters but its own lam and gap, so that states and
    inputs can be replayed. ``build`` is None if no model is known to be more exact than the system.
    """

    note: str = ITSELF
    build: Callable[[], ContactSystem] | None = None


def by_true_distance(system: ContactSystem) -> RefereeModel | None:
    """Return the most exact model of a system defined without a builder; None for a system without distances ``phi``.

    If all pairs are frictionless contacts, one for each distance ``phi`` [m], and the gaps of bodies at rest
    equal phi, the gaps are assumed to be expansions of phi and are replaced by the true distances phi of the
    next state. Other gaps, such as those of a spring or a law of restitution, are unchanged.
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
    """Return whether the gap equals ``phi`` for bodies at rest, ``x_next = x``, at a few random poses."""
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
