"""Rigid links in the vertical plane, and the trees they form."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import casadi as ca

Number = float | ca.SX
Vector = tuple[Number, Number]
Joint = Literal["hinge", "slide", "free"]


@dataclass(frozen=True, eq=False)
class Link:
    """One rigid link and the joint that carries it; every number may be a CasADi symbol.

    World axes are x forward and z up, angles count about +y:
    ``R(a)(x, z) = (x cos a + z sin a, -x sin a + z cos a)``. The link's frame has its origin in
    the joint, and the angle ``a = a_parent + offset + q`` (hinge; slide without the ``q``).

    ``mass`` [kg], ``inertia`` about the centre of mass [kg m²], ``com`` that centre in the link's
    frame [m], ``anchor`` the joint in the parent's frame [m] (the world's where ``parent`` is
    None), ``offset`` a fixed angle [rad].

    ``joint``: a ``hinge`` turns by q [rad]; a ``slide`` moves along ``axis``, a unit vector in
    the parent's frame, by q [m]; ``free`` has the coordinates x, z [m] and angle [rad] of a link
    without parent. ``spring`` and ``damping`` act on every coordinate of the joint, at rest at
    q = 0 [N m/rad, N m s/rad; N/m, N s/m for lengths]; ``gear`` is the force or torque of one
    unit of input, None where no motor is; ``limits`` bound q from below and above.
    """

    name: str
    parent: str | None
    mass: Number
    inertia: Number
    com: Vector = (0.0, 0.0)
    anchor: Vector = (0.0, 0.0)
    offset: Number = 0.0
    joint: Joint = "hinge"
    axis: Vector = (1.0, 0.0)
    spring: Number = 0.0
    damping: Number = 0.0
    gear: Number | None = None
    limits: tuple[Number, Number] | None = None


def root_first(links: Sequence[Link]) -> tuple[Link, ...]:
    """Order ``links`` so that each follows its parent.

    Raises ``ValueError`` where the links are no tree (a cycle, an unknown parent, a name used
    twice) or a link makes no sense (mass or inertia not positive, limits reversed, a free joint
    with a parent, a motor or limits).
    """
    by_name: dict[str, Link] = {}
    for link in links:
        if link.name in by_name:
            raise ValueError(f"two links are named {link.name!r}; give each link its own name")
        _check(link)
        by_name[link.name] = link
    ordered: dict[str, Link] = {}
    for link in links:
        for ancestor in reversed(_path_to_root(link, by_name)):
            ordered[ancestor.name] = ancestor
    return tuple(ordered.values())


def _path_to_root(link: Link, by_name: dict[str, Link]) -> list[Link]:
    path = [link]
    while (parent := path[-1].parent) is not None:
        if parent not in by_name:
            raise ValueError(
                f"link {path[-1].name!r} hangs on {parent!r}, which is no link;"
                f" choose its parent from {', '.join(by_name)}"
            )
        if parent in (seen.name for seen in path):
            ring = " -> ".join([*(seen.name for seen in path), parent])
            raise ValueError(f"the links form a cycle, {ring}; a tree needs a link without parent")
        path.append(by_name[parent])
    return path


def _check(link: Link) -> None:
    for what, value in (("mass", link.mass), ("inertia", link.inertia)):
        if not isinstance(value, ca.SX) and not value > 0:
            raise ValueError(f"link {link.name!r} has {what} {value:g}; expected a positive number")
    if link.limits is not None and not any(isinstance(bound, ca.SX) for bound in link.limits):
        low, high = link.limits
        if not low < high:
            raise ValueError(
                f"link {link.name!r} has limits {low:g} to {high:g}; expected the lower one first"
            )
    if link.joint == "free" and (link.parent or link.gear is not None or link.limits):
        raise ValueError(
            f"link {link.name!r} floats freely, so it takes no parent, gear or limits;"
            " leave them out or choose a hinge or a slide"
        )
