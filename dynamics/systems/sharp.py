"""The sharpest contact that a system has: what a plan made with its model is refereed by."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

if TYPE_CHECKING:
    from dynamics.systems.system import ContactSystem

ITSELF = "the model itself"
TRUE_GAPS = "true gaps"
COULOMB = "Coulomb friction with maximum dissipation"
_PROBES = 5
_SAME = 1e-9


@dataclass(frozen=True, eq=False)
class Sharp:
    """How a model leads to its sharpest sibling: ``note`` states what that one does better.

    ``build`` makes it: the same x, u, x_next and parameters, lam and gap its own, so that the same
    states and inputs can be replayed. None where nothing sharper than the model is known.
    """

    note: str = ITSELF
    build: Callable[[], ContactSystem] | None = None


def by_true_distance(system: ContactSystem) -> Sharp | None:
    """Sharpen a system written by hand, without a builder; None without geometry.

    Where its gaps are those of frictionless contacts, one for each distance ``phi`` [m], and equal
    phi for bodies that rest, they are taken for expansions of phi, and the true ones put in their
    place. A gap with the law of a bounce or of a spring in it is left as it is.
    """
    phi = system.phi
    if phi is None:
        return None
    plain = (
        system.forces is None
        and system.gap_unit == "m"
        and phi.numel() == system.nlam == sum(pair.kind == "normal" for pair in system.pairs)
        and ca.depends_on(system.gap, system.x_next)
        and not ca.depends_on(system.gap, system.lam)
    )
    affine = not ca.depends_on(ca.jacobian(phi, system.x), system.x)
    if not plain or affine or not _is_distance_at_rest(system, phi):
        return Sharp()
    there = ca.substitute(phi, system.x, system.x_next)
    if ca.is_equal(there, system.gap, 100):
        return Sharp()
    return Sharp(TRUE_GAPS, lambda: replace(system, gap=there, sharp=Sharp()))


def _is_distance_at_rest(system: ContactSystem, phi: ca.SX) -> bool:
    """Whether the gap is phi where neither state nor positions change, at a few random poses."""
    both = ca.Function(
        "both",
        [system.x, system.u, system.parameters.vector],
        [ca.substitute(system.gap, system.x_next, system.x), phi],
    )
    poses = np.array(ca.DM(ca.jacobian_sparsity(phi, system.x), 1)).any(axis=0)
    rng = np.random.default_rng(0)
    for _ in range(_PROBES):
        x = np.where(poses, rng.normal(size=system.nx), 0.0)
        gap, distance = (
            np.array(v) for v in both(x, np.zeros(system.nu), system.parameters.values)
        )
        if not np.allclose(gap, distance, rtol=_SAME, atol=_SAME):
            return False
    return True
