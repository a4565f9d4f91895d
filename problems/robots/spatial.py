"""Robots in space: a compiled file as bodies, parts and numbers beside them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from dynamics.systems.space import Body, Plane, SpatialMachine
from dynamics.systems.space.tree import Tree
from problems.drawing import ContactFrame, Shape
from problems.machines.perspective import Camera
from problems.machines.spatial import spatial_frames, spatial_shapes
from problems.robots.bodies import bodies
from problems.robots.leftovers import leftovers
from problems.robots.robot import Robot
from problems.robots.solids import solids
from problems.robots.source import Source, listed


@dataclass(frozen=True, eq=False)
class SpatialRobot(Robot):
    """A robot whose machine moves in space; q is MuJoCo's qpos and v its qvel."""

    machine: SpatialMachine

    @property
    def links(self) -> tuple[Body, ...]:
        """What moves, in the order of q."""
        return self.machine.bodies

    @property
    def tree(self) -> Tree:
        """Equations of motion."""
        return self.machine.tree()

    @property
    def grounds(self) -> list[int]:
        """Numbers of the contacts with level ground."""
        level = {
            part.name for part in self.machine.parts
            if isinstance(part.shape, Plane) and part.shape.normal == (0, 0, 1)
        }  # fmt: skip
        labels = [f"{a} on {b}" for a, b in self.machine.meetings if b in level]
        return [k for k, name in enumerate(self.friction) if _belongs(name, labels)]

    def shapes(self, state: np.ndarray) -> list[Shape]:
        """Draw the machine at ``state`` (q, v, ...) as a camera before its home sees it."""
        return spatial_shapes(self.machine, self.camera, state)

    def frames(self, state: np.ndarray, friction: float) -> list[ContactFrame]:
        """Place and normal of every contact, to draw its force."""
        return spatial_frames(self.machine, self.camera, state, friction)

    @cached_property
    def camera(self) -> Camera:
        """One that sees all bodies at home."""
        q = ca.DM(self.standing())
        at = np.array([ca.DM(ca.evalf(self.tree.pose(ca.SX(q), b.name)[1])) for b in self.links])
        at = at.reshape(-1, 3)
        middle, size = (at.min(axis=0) + at.max(axis=0)) / 2, float(np.ptp(at, axis=0).max())
        x, y, z = middle.tolist()
        return Camera.around((x, y, z), max(size, 0.1))


def spatial_robot(model: Any, source: Source, file: Path, gravity: np.ndarray) -> SpatialRobot:
    """Take over a compiled file; raises ``ValueError`` for what no body can express."""
    tree = bodies(model)
    found = solids(model, tree, urdf=source.urdf)
    gx, gy, gz = gravity.tolist()
    pairs, still = dict(found.friction), []
    machine = SpatialMachine(tree.bodies, found.parts, tuple(pairs), gravity=(gx, gy, gz))
    q = ca.SX.sym("q", machine.tree().nq)
    friction: dict[str, float] = {}
    contacts = machine.contacts(machine.tree(), q)
    # Contacts stand in the order of the pairs.
    names = list(contacts)
    for pair, coefficient in found.friction.items():
        label = f"{pair[0]} on {pair[1]}"
        own = [names.pop(0)]
        while names and _belongs(names[0], [label]):
            own.append(names.pop(0))
        if any(ca.depends_on(contacts[name].phi, q) for name in own):
            friction |= dict.fromkeys(own, coefficient)
        else:
            still.append(label)
            del pairs[pair]
    machine = SpatialMachine(tree.bodies, found.parts, tuple(pairs), gravity=(gx, gy, gz))
    ignored = [*source.ignored, *tree.ignored, *found.ignored, *leftovers(model, found.geoms)]
    if still:
        ignored.append(f"{listed('contact', still)}: no joint moves it")
    return SpatialRobot(
        file, machine, tree.joints, np.ones(model.nq), np.zeros(model.nq), home_of(model), friction,
        tuple(motor.name for motor in tree.motors),
        np.array([motor.range for motor in tree.motors]).reshape(-1, 2), tuple(ignored),
    )  # fmt: skip


def home_of(model: Any) -> np.ndarray:
    """The keyframe ``home`` of a compiled file, or its reference (nq,)."""
    keys = {model.key(k).name: k for k in range(model.nkey)}
    return np.array(model.key_qpos[keys["home"]] if "home" in keys else model.qpos0)


def _belongs(contact: str, labels: list[str]) -> bool:
    """Whether a contact is one of those that meetings have, by their ``labels``."""
    head, _, number = contact.rpartition(" ")
    return contact in labels or (number.isdecimal() and head in labels)
