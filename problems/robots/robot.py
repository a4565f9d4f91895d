"""A robot's file as a machine and the numbers beside it."""

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
    """A robot of a file: its ``machine``, whose q is MuJoCo's qpos and v its qvel, and the rest.

    ``distances`` maps q (nq, 1) to the signed distance of every contact (nc, 1) [m].
    ``joints`` names the file's joint of every entry of q, and ``actuators`` the motors and servos in
    the order of inputs. ``home`` (nq,) is q of the file's keyframe ``home``, without one of its
    joints at their references. ``friction`` has Coulomb's coefficient of every contact by name, in
    the order of the machine's; ``grounds`` are numbers of those with level ground. ``camera`` is
    one that sees all of the robot. ``ignored`` has a sentence for everything in the file that plays
    no part, ``notes`` one for what could be read otherwise.
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
        """The range of every input (nu, 2), infinite where there is none."""
        return np.array([actuator.range for actuator in self.actuators]).reshape(-1, 2)

    @property
    def coefficients(self) -> ca.SX:
        """Coulomb's coefficient of every contact (nc, 1), as ``SpatialMachine.system`` takes."""
        return ca.SX(ca.DM(list(self.friction.values())))

    @property
    def mass(self) -> float:
        """Mass of all bodies [kg]."""
        return float(self.machine.tree().total_mass)

    @property
    def floats(self) -> bool:
        """True where the root moves freely along z and along x or y."""
        return "z" in self._ways and len(self._ways) > 1

    def standing(self) -> np.ndarray:
        """Return home (nq,), lifted or lowered to where a floating robot first touches the ground [m]."""
        pose = self.home.copy()
        if self.floats and self.grounds:
            index, sign = self._ways["z"]
            pose[index] -= sign * np.array(self.distances(pose))[[*self.grounds]].min()
        return pose

    def displaced(self, pose: np.ndarray, way: ca.SX | float) -> ca.SX:
        """Return a pose (nq, 1) with the root ``way`` [m] further along x, or y if it has no x.

        Where the root is fixed every hinge and slide is ``way`` further, up to its limit [rad, m].
        """
        goal, tree = ca.SX(pose), self.machine.tree()
        if self.floats:
            index, sign = self._ways.get("x") or self._ways["y"]
            goal[index] += sign * way
            return goal
        for body in self.machine.bodies:
            if body.joint in ("hinge", "slide"):
                low, high = body.limits or (-np.inf, np.inf)
                entry = tree.q_of[body.name]
                goal[entry] = ca.fmin(ca.fmax(goal[entry] + way, low), high)
        ties = self.machine.coupled_joints()
        return ties.close(tree, goal) if ties else goal

    def held(self, pose: np.ndarray) -> np.ndarray:
        """Return inputs (nu,) that ask for a pose: its positions of servos, and 0 of motors."""
        tree = self.machine.tree()
        return np.array(
            [pose[tree.q_of[name]][0] if tree.bodies[name].servo is not None else 0.0 for name in tree.actuated]
        )

    @cached_property
    def _ways(self) -> dict[str, tuple[int, float]]:
        """Index into q and sign of what moves the root along the world's axes, unhindered."""
        tree, slides, above = self.machine.tree(), {}, None
        for body in self.machine.bodies:
            if body.joint == "free":
                return {axis: (tree.q_of[body.name].start + k, 1.0) for k, axis in enumerate("xyz")}
        for body in self.machine.bodies:
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
        """Return place and normal of every contact, to draw its force."""
        return spatial_frames(self.machine, self.camera, state, friction)

    def document(self) -> dict[str, Any]:
        """Return all that was read, as plain data: bodies, motors, contacts, home, and what was not read."""
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
