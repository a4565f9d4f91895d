"""Rigid links in the vertical plane, and trees of links."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol, TypeVar, get_args

import casadi as ca

from dynamics.systems.checks import (
    parse_number,
    parse_point,
    require_limits,
    require_not_negative,
    require_positive,
    require_text,
)

Number = float | ca.SX
Vector = tuple[Number, Number]
Joint = Literal["hinge", "slide", "free"]


@dataclass(frozen=True, eq=False)
class Link:
    """A rigid link and the joint to its parent; every number may be a CasADi symbol.

    World axes are x forward and z up, angles are about +y:
    ``R(a)(x, z) = (x cos a + z sin a, -x sin a + z cos a)``. The link's frame has its origin in the joint, and
    the angle ``a = a_parent + offset + q``, without ``q`` for a slide.

    ``mass`` [kg], ``inertia`` about the centre of mass [kg m²], ``com`` its position in the
    link's frame [m], ``anchor`` the joint in the parent's frame [m] (in the world's frame if ``parent`` is None),
    ``offset`` a fixed angle [rad].

    ``joint``: a ``hinge`` turns by q [rad]; a ``slide`` moves along ``axis``, a unit vector in
    the parent's frame, by q [m]; ``free`` has the coordinates x, z [m] and angle [rad] of a link
    without parent. ``spring`` and ``damping`` act on every coordinate of the joint, at rest at
    q = 0 [N m/rad, N m s/rad; N/m, N s/m for lengths]; ``gear`` is the force or torque of one
    unit of input, None without a motor; ``limits`` bound q from below and above; ``armature`` is
    the inertia of the rotor, which adds to the joint's diagonal entry of the mass matrix and has no
    weight [kg m²; kg for lengths].

    Raises ``ValueError`` for an invalid argument: a mass or inertia that is not positive, a
    negative armature, reversed limits, a free joint with a parent, a motor, limits or an armature.
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
    armature: Number = 0.0

    def __post_init__(self) -> None:
        require_text("the name of a link", self.name)
        owner = f"link {self.name!r}:"
        require_positive(f"{owner} mass", self.mass)
        require_positive(f"{owner} inertia", self.inertia)
        for attribute in ("com", "anchor", "axis"):
            parse_point(f"{owner} {attribute}", getattr(self, attribute))
        for attribute in ("offset", "spring", "damping"):
            parse_number(f"{owner} {attribute}", getattr(self, attribute))
        require_not_negative(f"{owner} armature", self.armature)
        if self.joint not in get_args(Joint):
            kinds = ", ".join(map(repr, get_args(Joint)))
            raise ValueError(f"{owner} joint must be one of {kinds}, got {self.joint!r}")
        require_limits(owner, self.limits)
        is_fixed = self.parent or self.gear is not None or self.limits
        if self.joint == "free" and (is_fixed or not ca.SX(self.armature).is_zero()):
            raise ValueError(
                f"link {self.name!r} floats freely, so it takes no parent, gear, limits or"
                " armature; leave them out or choose a hinge or a slide"
            )


class Member(Protocol):
    """Interface of a link or body of a tree: its name and the name of its parent."""

    @property
    def name(self) -> str:
        """Name of the link or body."""
        ...

    @property
    def parent(self) -> str | None:
        """Name of the parent, None at the root of a tree."""
        ...


Branch = TypeVar("Branch", bound=Member)


def root_first(links: Sequence[Branch]) -> tuple[Branch, ...]:
    """Return ``links`` in an order in which each follows its parent.

    Raises ``ValueError`` if the links do not form a tree: for a cycle, an unknown parent, a repeated name.
    """
    by_name: dict[str, Branch] = {}
    for link in links:
        if link.name in by_name:
            raise ValueError(f"two links are named {link.name!r}; give each link its own name")
        by_name[link.name] = link
    ordered: dict[str, Branch] = {}
    for link in links:
        for ancestor in reversed(_path_to_root(link, by_name)):
            ordered[ancestor.name] = ancestor
    return tuple(ordered.values())


def _path_to_root(link: Branch, by_name: dict[str, Branch]) -> list[Branch]:
    path = [link]
    while (parent := path[-1].parent) is not None:
        if parent not in by_name:
            raise ValueError(
                f"link {path[-1].name!r} has the parent {parent!r}, which is not a link;"
                f" choose its parent from {', '.join(by_name)}"
            )
        if parent in (link_on_path.name for link_on_path in path):
            ring = " -> ".join([*(link_on_path.name for link_on_path in path), parent])
            raise ValueError(f"the links form a cycle, {ring}; a tree needs a link without parent")
        path.append(by_name[parent])
    return path
