"""Whether a step's contacts leave single multipliers open, found from their structure."""

from __future__ import annotations

from itertools import combinations

import casadi as ca
import numpy as np

from dynamics.systems.pairs import Pair

_PROBES = 3
_ZERO = 1e-9
_MOST = 10
"""Contacts up to which every set of them is looked at where F has not full rank."""


def has_open_multipliers(
    pairs: tuple[Pair, ...], contact: ca.Function, parameters: np.ndarray
) -> bool:
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
    if n > _MOST:
        return True
    sets = (list(rows) for size in range(1, n + 1) for rows in combinations(range(n), size))
    return any(_may_close_at_once(probes, rows) for rows in sets)


def _probes(contact: ca.Function, parameters: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """F and z at random states and inputs, where they are numbers."""
    sizes = contact.numel_in(0), contact.numel_in(1)
    rng, found = np.random.default_rng(0), []
    for _ in range(_PROBES):
        F, z = contact(*(rng.normal(size=size) for size in sizes), parameters)
        found.append((np.array(F), np.array(z).ravel()))
    return [(F, z) for F, z in found if np.all(np.isfinite(F)) and np.all(np.isfinite(z))]


def _may_close_at_once(probes: list[tuple[np.ndarray, np.ndarray]], rows: list[int]) -> bool:
    """Whether the block of F is singular and nothing keeps these gaps from closing together."""
    apart = []
    for F, z in probes:
        left, size, _ = np.linalg.svd(F[np.ix_(rows, rows)])
        unmoved = left[:, size <= _ZERO * max(1.0, size.max())]
        if not unmoved.shape[1]:
            return False
        apart.append(float(np.linalg.norm(unmoved.T @ z[rows])))
    constant = np.ptp(apart) <= _ZERO * max(apart)
    return not (constant and min(apart) > _ZERO)
