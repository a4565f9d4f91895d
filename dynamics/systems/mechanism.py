"""The interface of machines in the plane and in space, and a record of the machine that a system was built from."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypedDict

import casadi as ca

from dynamics.systems.planar.links import Branch, root_first

if TYPE_CHECKING:
    from dynamics.systems.contact_rows import Cone
    from dynamics.systems.parameters import ParameterTable
    from dynamics.systems.planar.chain import Chain
    from dynamics.systems.shapes import Contact
    from dynamics.systems.space.contact import SpatialContact
    from dynamics.systems.space.tree import Tree
    from dynamics.systems.system import ContactSystem

WORLD = "world"
"""Name of the link or body of parts that never move."""


class PlacedShape(NamedTuple):
    """A shape of a machine, in the frame of its ``owner``: a link, a body, or the :data:`WORLD`."""

    name: str
    owner: str
    shape: Any


class StepOptions(TypedDict, total=False):
    """Settings of a step, in the plane and in space.

    One unit of input is ``scale`` times the gear [N m, N]; ``cone`` is the formulation of the
    friction cone; with ``linearised``, gaps are linearised at the current pose.
    """

    scale: float
    cone: Cone
    linearised: bool


class Multibody(ABC):
    """A machine in the plane or in space: trees of bodies, shapes on them, and pairs of shapes that may touch.

    ``collision_pairs`` are pairs of names of shapes; their contact is called ``<one> on <other>``.
    """

    collision_pairs: tuple[tuple[str, str], ...]

    @property
    @abstractmethod
    def members(self) -> Sequence[Any]:
        """Links of a machine in the plane, bodies of a machine in space."""

    @property
    @abstractmethod
    def shapes(self) -> tuple[PlacedShape, ...]:
        """All shapes that may touch each other or the ground."""

    @abstractmethod
    def tree(self) -> Chain | Tree:
        """Return the equations of motion of the machine."""

    @abstractmethod
    def contacts(self, q: ca.SX, spheres: Collection[str] | None = None) -> Mapping[str, Contact | SpatialContact]:
        """Return a mapping from names to contacts at the pose ``q`` (nq, 1).

        In the plane ``spheres`` are the names of the spheres that may touch the ground, by default all.
        """

    @abstractmethod
    def system(
        self,
        name: str,
        parameters: ParameterTable,
        *,
        h: ca.SX | float,
        friction: ca.SX | float | None,
        **options: Any,
    ) -> ContactSystem:
        """Return one step of ``h`` [s].

        ``friction`` is Coulomb's coefficient, None without friction; ``options`` are those of
        :class:`StepOptions`.
        """

    def meeting_shapes(self) -> Iterator[tuple[tuple[str, str], PlacedShape, PlacedShape]]:
        """Yield each collision pair and its two shapes; if one of them is fixed to the world, it comes second."""
        by_name = {placed.name: placed for placed in self.shapes}
        for pair in self.collision_pairs:
            first, second = (by_name[name] for name in pair)
            yield (pair, second, first) if first.owner == WORLD else (pair, first, second)


@dataclass(frozen=True, eq=False)
class Mechanism:
    """The ``machine`` that a system was built from, and settings of its step.

    One unit of input is ``scale`` times a joint's gear; ``spheres`` are the names of the spheres that may
    touch the ground, None for all. ``gyroscopic`` is the integration of Coriolis and centrifugal forces in the plane.
    """

    machine: Multibody
    scale: float = 1.0
    spheres: tuple[str, ...] | None = None
    gyroscopic: Literal["explicit", "implicit"] = "explicit"


def check_parts(
    kind: str,
    members: Sequence[Branch],
    moving: Sequence[tuple[str, str]],
    parts: Sequence[tuple[str, str]],
    collision_pairs: Sequence[tuple[str, str]],
) -> None:
    """Raise ``ValueError`` for links or bodies that form no tree, and for invalid names of parts or pairs.

    ``moving`` and ``parts`` are pairs (name, link or body); only ``parts`` may be fixed to the world.
    """
    names = [member.name for member in root_first(members)]
    if WORLD in names:
        raise ValueError(f"a {kind} is named {WORLD!r}, which never moves; give it another name")
    for name, owner in (*moving, *parts):
        if owner not in names and not (owner == WORLD and (name, owner) in parts):
            raise ValueError(f"{name!r} is on {kind} {owner!r}, which does not exist; choose from {', '.join(names)}")
    counts = Counter(name for name, _ in (*moving, *parts))
    if repeated := [name for name, count in counts.items() if count > 1]:
        raise ValueError(f"two parts are named {repeated[0]!r}; give each part its own name")
    owners = dict((*moving, *parts))
    for pair in collision_pairs:
        for name in pair:
            if name not in owners:
                raise ValueError(f"{name!r} is not a part; choose from {', '.join(owners)}")
        if len({owners[name] for name in pair}) == 1:
            raise ValueError(f"{' and '.join(pair)} are on the same {kind} and never touch")
