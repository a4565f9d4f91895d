"""What a robot's file says, as a machine and the numbers beside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from dynamics.systems import Link, Machine
from dynamics.systems.chain import Chain
from dynamics.systems.space import Body, SpatialMachine
from dynamics.systems.space.tree import Tree
from problems.drawing import ContactFrame, HalfPlane, Shape
from problems.machines.machine import machine_frames, machine_shapes

_GROUND = HalfPlane(0, 0, 0, 1)


@dataclass(frozen=True, eq=False)
class Robot:
    """A robot of a file: its ``machine``, and what that does not hold.

    With qpos the coordinates of the file as MuJoCo has them, in the order ``joints`` [m, rad],

        q = signs * (qpos - rests),

    where a sign is -1 for a hinge about -y and for a root that slides along -x or -z, and a rest is
    where the joint's spring rests, mostly 0; in space q is qpos and v is qvel. ``home`` (nq,) is q
    of the file's keyframe ``home``, without one of its joints at their references. ``friction`` has
    Coulomb's coefficient of every contact by name, in the order of the machine's. ``controls``
    (nu, 2) is the range of every input, infinite where there is none; ``motors`` names the inputs
    as the file does.
    ``ignored`` has a sentence for everything in the file that plays no part, ``notes`` one for what
    could be read otherwise.
    """

    path: Path
    machine: Machine | SpatialMachine
    joints: tuple[str, ...]
    signs: np.ndarray
    rests: np.ndarray
    home: np.ndarray
    friction: Mapping[str, float]
    motors: tuple[str, ...]
    controls: np.ndarray
    ignored: tuple[str, ...]

    notes: tuple[str, ...] = field(default=(), kw_only=True)

    @property
    def links(self) -> Sequence[Link | Body]:
        """What moves, in the order of q."""
        raise NotImplementedError

    @property
    def tree(self) -> Chain | Tree:
        """Equations of motion."""
        raise NotImplementedError

    @property
    def grounds(self) -> list[int]:
        """Numbers of the contacts with level ground."""
        raise NotImplementedError

    def shapes(self, state: np.ndarray) -> list[Shape]:
        """Draw the machine at ``state`` (q, v, ...), with the ground where the file has one."""
        raise NotImplementedError

    def frames(self, state: np.ndarray, friction: float) -> list[ContactFrame]:
        """Place and normal of every contact, to draw its force."""
        raise NotImplementedError

    @property
    def floats(self) -> bool:
        """Whether the root moves freely over the ground."""
        return any(link.joint == "free" for link in self.links)

    @property
    def coefficients(self) -> ca.DM:
        """Coulomb's coefficient of every contact (nc, 1), as ``Machine.system`` takes them."""
        return ca.DM(list(self.friction.values()))

    @cached_property
    def distances(self) -> ca.Function:
        """Map q (nq, 1) to the signed distance of every contact (nc, 1) [m]."""
        tree: Any = self.tree
        q = ca.SX.sym("q", tree.nq)
        found = [contact.phi for contact in self.machine.contacts(tree, q).values()]
        return ca.Function("distances", [q], [ca.densify(ca.vertcat(ca.SX(0, 1), *found))])

    def standing(self) -> np.ndarray:
        """Home (nq,), lifted or lowered to where a floating robot first touches the ground [m]."""
        pose = self.home.copy()
        if self.floats and self.grounds:
            pose[self._index("z")] -= np.array(self.distances(pose))[self.grounds].min()
        return pose

    def displaced(self, pose: np.ndarray, way: ca.SX | float) -> ca.SX:
        """Return a pose (nq, 1) with the root ``way`` [m] further along x.

        Where the root is fixed every hinge and slide is ``way`` further, up to its limit [rad, m].
        """
        goal = ca.SX(pose)
        if self.floats:
            goal[self._index("x")] += way
            return goal
        for index, signal in enumerate(self.tree.coordinates):
            link = next((one for one in self.links if one.name == signal.name), None)
            if link is not None:
                low, high = link.limits or (-np.inf, np.inf)
                goal[index] = ca.fmin(ca.fmax(goal[index] + way, low), high)
        return goal

    @property
    def mass(self) -> float:
        """Mass of all links [kg]."""
        return float(self.tree.total_mass)

    def _index(self, axis: str) -> int:
        """Index of the root's coordinate ``x`` or ``z``."""
        root = next(link for link in self.links if link.joint == "free")
        names = [signal.name for signal in self.tree.coordinates]
        return names.index(f"{root.name}_{axis}")

    def document(self) -> dict[str, Any]:
        """All that was read, as plain data: links, motors, contacts, home, and what was not."""
        names = [signal.name for signal in self.tree.coordinates]
        gaps = np.array(self.distances(self.home)).ravel()
        bounds = [
            [end if np.isfinite(end) else None for end in row] for row in self.controls.tolist()
        ]
        geared = [link for link in self.links if link.gear is not None]
        return {
            "file": str(self.path),
            "links": [
                {
                    "name": link.name, "parent": link.parent or "world", "joint": link.joint,
                    "mass": _plain(link.mass), "inertia": _plain(link.inertia),
                    "limits": None if link.limits is None else [_plain(v) for v in link.limits],
                    "spring": _plain(link.spring), "damping": _plain(link.damping),
                    "armature": _plain(link.armature),
                }
                for link in self.links
            ],
            "coordinates": [
                {"name": name, "joint": joint, "sign": int(sign), "rest": rest, "home": home}
                for name, joint, sign, rest, home in zip(
                    names, self.joints, self.signs, self.rests.tolist(), self.home.tolist(),
                    strict=True,
                )
            ],
            "motors": [
                {"name": name, "link": link.name, "gear": _plain(link.gear), "least": low,
                 "most": high}
                for name, link, (low, high) in zip(self.motors, geared, bounds, strict=True)
            ],
            "contacts": [
                {"name": name, "friction": friction, "distance": gap}
                for (name, friction), gap in zip(self.friction.items(), gaps.tolist(), strict=True)
            ],
            "notes": list(self.notes),
            "ignored": list(self.ignored),
        }  # fmt: skip


def _plain(value: Any) -> Any:
    return list(map(float, value)) if isinstance(value, tuple) else float(value)


@dataclass(frozen=True, eq=False)
class PlanarRobot(Robot):
    """A robot whose machine lies in the plane of x and z."""

    machine: Machine

    @property
    def links(self) -> tuple[Link, ...]:
        """What moves, in the order of q."""
        return self.machine.links

    @property
    def tree(self) -> Chain:
        """Equations of motion."""
        return self.machine.chain()

    @property
    def grounds(self) -> list[int]:
        """Numbers of the contacts with level ground."""
        return list(range(len(self.machine.spheres)))

    def shapes(self, state: np.ndarray) -> list[Shape]:
        """Draw the machine at ``state`` (q, v, ...), with the ground where the file has one."""
        found = machine_shapes(self.machine, state)
        return found if self.machine.spheres else [one for one in found if one != _GROUND]

    def frames(self, state: np.ndarray, friction: float) -> list[ContactFrame]:
        """Place and normal of every contact, to draw its force."""
        return machine_frames(self.machine, state, None, friction)
