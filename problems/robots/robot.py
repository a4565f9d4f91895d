"""A robot from a file: its machine, and further data for problems."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from dynamics.systems.space import SpatialMachine
from problems.drawing import ContactFrame, Shape
from problems.machines.perspective import PinholeCamera
from problems.machines.spatial import spatial_frames, spatial_shapes
from problems.robots.bodies import Actuator


@dataclass(frozen=True, eq=False)
class Robot:
    """A robot from a file: its ``machine``, whose q and v are MuJoCo's qpos and qvel, and further data.

    ``distances`` maps q (nq, 1) to the signed distance of every contact (nc, 1) [m]. ``joints`` are the
    names of the file's joints, one for every entry of q, ``actuators`` the motors and servos in the
    order of inputs. ``home`` (nq,) is q of the file's keyframe ``home``, or else the joints'
    references. ``friction`` maps the name of a contact to Coulomb's coefficient, in the order of the
    machine's contacts; ``grounds`` are the indices of contacts with level ground. ``camera`` shows
    the whole robot. ``ignored`` are sentences about parts of the file that have no effect, and
    ``notes`` sentences about parts that could be interpreted differently.
    """

    path: Path
    machine: SpatialMachine
    distances: ca.Function
    joints: tuple[str, ...]
    actuators: tuple[Actuator, ...]
    home: np.ndarray
    friction: Mapping[str, float]
    grounds: tuple[int, ...]
    camera: PinholeCamera
    ignored: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def controls(self) -> np.ndarray:
        """Range of every input (nu, 2), infinite if it is unbounded."""
        return np.array([actuator.range for actuator in self.actuators]).reshape(-1, 2)

    @property
    def coefficients(self) -> ca.SX:
        """Coulomb's coefficient of every contact (nc, 1), as an argument of ``SpatialMachine.system``."""
        return ca.SX(ca.DM(list(self.friction.values())))

    @property
    def mass(self) -> float:
        """Mass of all bodies [kg]."""
        return float(self.machine.tree().total_mass)

    @property
    def floats(self) -> bool:
        """Whether the root moves freely along z and along x or y."""
        return "z" in self._root_translations and len(self._root_translations) > 1

    @cached_property
    def objects(self) -> frozenset[str]:
        """Names of bodies that no motor moves, such as a box to be pushed; none if the robot has no motor.

        No body of their trees has a motor, or a joint that is coupled to others.
        """
        roots, actuated_roots = dict[str, str](), set[str]()
        coupled = {name for coupling in self.machine.couplings for name in coupling.coefficients}
        for body in self.machine.bodies:
            roots[body.name] = body.name if body.parent is None else roots[body.parent]
            if body.gear is not None or body.servo is not None or body.name in coupled:
                actuated_roots.add(roots[body.name])
        return frozenset(name for name, root in roots.items() if actuated_roots and root not in actuated_roots)

    @cached_property
    def root_bodies(self) -> tuple[str, ...]:
        """Names of the bodies whose joints free the root, in order; the last is the trunk. Empty for a fixed root."""
        chain: list[str] = []
        for body in self.machine.bodies if self.floats else ():
            if body.name not in self.objects and body.parent == (chain[-1] if chain else None):
                chain.append(body.name)
                # Bodies without mass are further joints of the one that they carry.
                if not ca.SX(body.mass).is_zero():
                    break
        return tuple(chain)

    @cached_property
    def root_entries(self) -> tuple[int, ...]:
        """Indices into q of the position and rotation of the root."""
        q_of = self.machine.tree().q_of
        return tuple(i for name in self.root_bodies for i in range(q_of[name].start, q_of[name].stop))

    @cached_property
    def forward(self) -> tuple[int, float]:
        """Index into q of the root's position along x, or y if it cannot move along x, and the sign of that entry."""
        return self._root_translations.get("x") or self._root_translations["y"]

    def standing(self) -> np.ndarray:
        """Return the pose home (nq,); a floating robot is lifted or lowered until it just touches the ground."""
        pose = self.home.copy()
        if self.floats and self.footholds:
            lowest = np.array(self.distances(pose))[[*self.footholds]].min()
            return np.array(ca.evalf(self.raised(pose, -lowest))).ravel()
        return pose

    @cached_property
    def footholds(self) -> tuple[int, ...]:
        """Indices of the robot's own contacts with level ground, without those of :attr:`objects`."""
        if not self.objects:
            return self.grounds
        touching = list(self.machine.contacts_with_bodies(ca.SX(self.home)).values())
        return tuple(i for i in self.grounds if self.objects.isdisjoint(touching[i][1:]))

    def raised(self, pose: np.ndarray, height: ca.SX | float) -> ca.SX:
        """Return a pose (nq, 1) with the root of a floating robot higher by ``height`` [m]."""
        raised_pose, (index, sign) = ca.SX(pose), self._root_translations["z"]
        raised_pose[index] += sign * height
        return raised_pose

    def displaced(self, pose: np.ndarray, distance: ca.SX | float) -> ca.SX:
        """Return a pose (nq, 1) with the root moved by ``distance`` [m] along x, or y if it cannot move along x.

        If the root is fixed, every hinge and slide is moved by ``distance`` [rad, m], up to its limit; those of
        :attr:`objects` stay.
        """
        if self.floats:
            goal, (index, sign) = ca.SX(pose), self.forward
            goal[index] += sign * distance
            return goal
        return self.with_joints_moved(
            pose, {body.name: distance for body in self.machine.bodies if body.name not in self.objects}
        )

    def with_joints_moved(self, pose: np.ndarray, changes: Mapping[str, ca.SX | float]) -> ca.SX:
        """Return a pose (nq, 1) with hinges and slides moved by ``changes`` [rad, m], each up to its limit."""
        goal, tree = ca.SX(pose), self.machine.tree()
        for body in self.machine.bodies:
            if body.joint in ("hinge", "slide") and body.name in changes:
                low, high = body.limits or (-np.inf, np.inf)
                entry = tree.q_of[body.name]
                goal[entry] = ca.fmin(ca.fmax(goal[entry] + changes[body.name], low), high)
        ties = self.machine.coupled_joints()
        return ties.close(tree, goal) if ties else goal

    def holding_inputs(self, pose: np.ndarray) -> np.ndarray:
        """Return inputs (nu,) that hold ``pose``: the joints' positions for servos, and 0 for motors."""
        tree = self.machine.tree()
        return np.array(
            [pose[tree.q_of[name]][0] if tree.bodies[name].servo is not None else 0.0 for name in tree.actuated]
        )

    @cached_property
    def _root_translations(self) -> dict[str, tuple[int, float]]:
        """Mapping from a world axis along which the root moves freely to the coordinate's index in q and its sign."""
        tree, slides, above = self.machine.tree(), {}, None
        robot_bodies = [body for body in self.machine.bodies if body.name not in self.objects]
        for body in robot_bodies:
            if body.joint == "free":
                return {axis: (tree.q_of[body.name].start + k, 1.0) for k, axis in enumerate("xyz")}
        for body in robot_bodies:
            hindered = body.gear is not None or body.servo is not None or body.limits is not None
            if body.joint != "slide" or body.parent != above or hindered:
                break
            # Slides have the axes of their parent, so that these are the world's.
            k = int(np.abs(body.axis).argmax())
            if abs(body.axis[k]) == 1:
                slides["xyz"[k]] = tree.q_of[body.name].start, float(body.axis[k])
            above = body.name
        return slides

    def shapes(self, state: np.ndarray) -> list[Shape]:
        """Draw the machine at ``state`` (q, v, ...)."""
        return spatial_shapes(self.machine, self.camera, state)

    def frames(self, state: np.ndarray, friction: float) -> list[ContactFrame]:
        """Return the frame of every contact at ``state`` (q, v, ...), to draw its force."""
        return spatial_frames(self.machine, self.camera, state, friction)

    def document(self) -> dict[str, Any]:
        """Return the robot as plain data: bodies, coordinates, motors, contacts, notes, and ignored parts."""
        tree = self.machine.tree()
        gaps, home = np.array(self.distances(self.home)).ravel().tolist(), self.home.tolist()
        return {
            "file": str(self.path),
            "links": [vars(body) for body in self.machine.bodies],
            "coordinates": [
                {"name": signal.name, "joint": joint, "home": position}
                for signal, joint, position in zip(tree.coordinates, self.joints, home, strict=True)
            ],
            "motors": [
                {
                    "name": actuator.name,
                    "link": link,
                    "gear": actuator.gear,
                    "servo": actuator.servo,
                    "range": [end if np.isfinite(end) else None for end in actuator.range],
                }
                for actuator, link in zip(self.actuators, tree.actuated, strict=True)
            ],
            "contacts": [
                {"name": name, "friction": friction, "distance": gap}
                for (name, friction), gap in zip(self.friction.items(), gaps, strict=True)
            ],
            "notes": list(self.notes),
            "ignored": list(self.ignored),
        }
