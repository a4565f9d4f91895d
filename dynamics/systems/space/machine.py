"""Machines in space: trees of bodies whose parts may touch the world and each other."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Unpack

import casadi as ca
import numpy as np

from dynamics.systems.checks import require_items, require_text
from dynamics.systems.mechanism import WORLD, Mechanism, Multibody, PlacedShape, StepOptions, check_parts
from dynamics.systems.memoise import OncePerPose
from dynamics.systems.parameters import ParameterTable
from dynamics.systems.space.body import Body, Vector, require_vector
from dynamics.systems.space.contact import JointAxes, SpatialContact, SpatialPose, at_random_poses, contacts_between
from dynamics.systems.space.coupling import CoupledJoints, Coupling
from dynamics.systems.space.shapes import Shape
from dynamics.systems.space.stepping import ContactPair, SpatialStep
from dynamics.systems.space.tree import Tree
from dynamics.systems.system import ContactSystem

_FIXED = SpatialPose(ca.SX.eye(3), ca.SX(3, 1))
"""Pose of the world."""
EQUAL_CONTACTS_TOLERANCE = 1e-12
"""Maximum relative difference between the rows of two contacts that count as equal."""


@dataclass(frozen=True, eq=False)
class SpatialPart:
    """A ``shape`` fixed to a body, in the body's frame; on the :data:`WORLD` a part never moves."""

    name: str
    body: str
    shape: Shape

    def __post_init__(self) -> None:
        require_text("the name of a part", self.name)
        if not isinstance(self.shape, Shape):
            raise ValueError(
                f"part {self.name!r}: shape must be a Sphere, Capsule, Cylinder, Box, Hull or Plane"
                f" of dynamics.systems.space, got {self.shape!r}"
            )

    @property
    def placed(self) -> PlacedShape:
        """Name, body and shape of the part."""
        return PlacedShape(self.name, self.body, self.shape)


@dataclass(frozen=True, eq=False)
class SpatialMachine(Multibody):
    """A machine in space: a tree of bodies, parts on them, and pairs of parts that may touch.

    ``collision_pairs`` are pairs of names of parts on different bodies; one of the two may be on the
    :data:`WORLD`. Their contacts are called ``<one> on <other>``, with a number appended if a pair has
    several points. Points that all joints move in the same way, such as front and back corners of a box that moves
    in a plane, are one contact. ``gravity`` is an acceleration [m/s²].

    Raises ``ValueError`` for bodies that do not form a tree, and for names that are unknown or used twice.
    """

    bodies: tuple[Body, ...]
    parts: tuple[SpatialPart, ...] = ()
    collision_pairs: tuple[tuple[str, str], ...] = ()
    gravity: Vector = field(default=(0.0, 0.0, -9.81), kw_only=True)
    couplings: tuple[Coupling, ...] = field(default=(), kw_only=True)

    def __post_init__(self) -> None:
        require_items("bodies", Body, self.bodies)
        require_items("parts", SpatialPart, self.parts)
        require_vector("gravity", self.gravity, (3,))
        fixed_parts = [(part.name, part.body) for part in self.parts]
        check_parts("body", self.bodies, [], fixed_parts, self.collision_pairs)

    @property
    def members(self) -> tuple[Body, ...]:
        """Bodies of the machine."""
        return self.bodies

    @property
    def shapes(self) -> tuple[PlacedShape, ...]:
        """Shapes of the parts."""
        return tuple(part.placed for part in self.parts)

    @cached_property
    def _tree(self) -> Tree:
        return Tree(self.bodies, self.gravity)

    def tree(self) -> Tree:
        """Return the equations of motion of the machine."""
        return self._tree

    def coupled_joints(self) -> CoupledJoints | None:
        """Return the couplings of the tree's joints; None if there are none."""
        return CoupledJoints(self.tree(), self.couplings) if self.couplings else None

    def contacts_with_bodies(self, q: ca.SX) -> dict[str, tuple[SpatialContact, str, str]]:
        """Return a mapping from names to contacts at ``q`` (nq, 1), each with the bodies of its shapes A and B."""
        poses, contacts = body_places(self.tree(), q), {}
        for pair, placed_a, placed_b in self.meeting_shapes():
            owners = placed_a.owner, placed_b.owner
            pair_contacts = contacts_between(placed_a.shape, poses[owners[0]], placed_b.shape, poses[owners[1]])
            if pair not in self._points:
                self._points[pair] = distinct_points(self.tree(), self._q, placed_a, placed_b, len(pair_contacts))
            points = [pair_contacts[k] for k in self._points[pair]]
            contacts |= {name: (contact, *owners) for name, contact in name_contacts(*pair, points).items()}
        return contacts

    @cached_property
    def _points(self) -> dict[tuple[str, str], list[int]]:
        """Cache: mapping from a collision pair to the indices of its distinct points."""
        return {}

    @cached_property
    def _q(self) -> ca.SX:
        """Symbolic pose for the comparison of points; all pairs share it, so that the tree is evaluated once."""
        return ca.SX.sym("q", self.tree().nq)

    def contacts(self, q: ca.SX, spheres: Collection[str] | None = None) -> dict[str, SpatialContact]:
        """Return a mapping from names to contacts at the pose ``q`` (nq, 1); ``spheres`` has no effect in space."""
        return {name: contact for name, (contact, *_) in self.contacts_with_bodies(q).items()}

    def system(
        self,
        name: str,
        parameters: ParameterTable,
        *,
        h: ca.SX | float,
        friction: ca.SX | float | None,
        **options: Unpack[SpatialStepOptions],
    ) -> ContactSystem:
        """Return one step of the machine with friction and joint limits, see :class:`SpatialStep`.

        ``friction`` is Coulomb's coefficient, one for all contacts or one for each, None without
        friction. The input of a servo is its target position.
        """
        tree = self.tree()

        def contact_pairs(q: ca.SX) -> list[ContactPair]:
            return [
                ContactPair(label, contact, _motions(tree, q, body_a), _motions(tree, q, body_b), body_b == WORLD)
                for label, (contact, body_a, body_b) in self.contacts_with_bodies(q).items()
            ]

        touches = OncePerPose(contact_pairs)
        step = SpatialStep(name, parameters, tree, touches, h, friction, self.coupled_joints(), **options)
        return replace(step.system(), machine=Mechanism(self, step.scale))


class SpatialStepOptions(StepOptions, total=False):
    """Settings of a step in space: :class:`StepOptions`, and ``edges`` and ``inertial`` of :class:`SpatialStep`."""

    edges: int
    inertial: bool


def _motions(tree: Tree, q: ca.SX, body: str) -> JointAxes:
    return [] if body == WORLD else tree.joint_axes(q, body)


def body_places(tree: Tree, q: ca.SX) -> dict[str, SpatialPose]:
    """Return a mapping from names of bodies, and :data:`WORLD`, to their frames at the pose ``q`` (nq, 1)."""
    return {WORLD: _FIXED} | {name: SpatialPose(*tree.pose(q, name)) for name in tree.bodies}


def name_contacts(name_a: str, name_b: str, contacts: Sequence[SpatialContact]) -> dict[str, SpatialContact]:
    """Return a mapping from names to the contacts of two parts; with several contacts the names are numbered."""
    numbers = [f" {k}" for k in range(1, len(contacts) + 1)] if len(contacts) > 1 else [""]
    return {f"{name_a} on {name_b}{number}": contact for number, contact in zip(numbers, contacts, strict=False)}


def distinct_points(tree: Tree, q: ca.SX, part_a: PlacedShape, part_b: PlacedShape, count: int) -> list[int]:
    """Return indices of the ``count`` contacts of two parts, without contacts that duplicate another.

    Contacts are duplicates if their distances, and their rows along normal and tangents, agree at random poses of
    the symbol ``q`` (nq, 1). If distances or rows depend on a quaternion, no contacts count as duplicates.
    """
    if count < 2:
        return list(range(count))
    pose_a, pose_b = (
        _FIXED if body == WORLD else SpatialPose(*tree.pose(q, body)) for body in (part_a.owner, part_b.owner)
    )
    pair_contacts = contacts_between(part_a.shape, pose_a, part_b.shape, pose_b)
    axes_a, axes_b = (_motions(tree, q, part.owner) for part in (part_a, part_b))
    rows = [ca.horzcat(contact.phi, *contact.jacobian_rows(axes_a, axes_b, tree.nv)) for contact in pair_contacts]
    stacked = ca.densify(ca.vertcat(*rows))
    if tree.quaternion_entries and ca.depends_on(stacked, q[tree.quaternion_entries]):
        return list(range(count))
    values, distinct = at_random_poses(stacked), list[int]()
    for k, row in enumerate(values):
        allowed = EQUAL_CONTACTS_TOLERANCE * np.abs(row).max()
        if not any(np.abs(row - values[other]).max() <= allowed for other in distinct):
            distinct.append(k)
    return distinct
