"""Machines with the constants of a publication, and their pictures."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import casadi as ca
import numpy as np

from dynamics.systems import WORLD, Link, Machine
from dynamics.systems.planar.machine import link_pose
from problems.drawing import ContactFrame, Shape, Stadium, Wall, solid

START_TOLERANCE = 1e-9
"""Maximum depth in the ground [m], and maximum excess over a joint limit [rad], at the start."""


@dataclass(frozen=True, eq=False)
class PublishedMachine(Machine):
    """A machine with the constants of the simulation environment that publishes it.

    ``pose`` is the pose at which the machine's values are checked, one value for each coordinate [m, rad];
    ``friction`` is Coulomb's coefficient with the ground, ``h`` the environment's time step [s]. The
    start is ``lift`` [m] above the pose, with noise up to ``noise`` in every coordinate and velocity.
    """

    pose: tuple[float, ...]
    friction: float
    h: float
    lift: float
    noise: float

    def reset(self, seed: int = 0) -> np.ndarray:
        """Return a start state (q, v) of the environment, (2 nq,): the pose lifted, plus noise.

        The noise of every entry is uniform in [-noise, noise], whether in m, rad, m/s or rad/s.
        """
        start = np.concatenate([self.pose, np.zeros(len(self.pose))])
        start[1] += self.lift
        return start + np.random.default_rng(seed).uniform(-self.noise, self.noise, len(start))

    def check_start(self, q: Sequence[float], spheres: Collection[str]) -> None:
        """Check that at the pose ``q`` (nq,) none of ``spheres`` is in the ground and every joint is within its limits.

        Raises ``ValueError`` with the sphere or the joint, and a correction of the start, in its message.
        """
        chain = self.tree()
        touches = self.contacts(ca.SX(q), spheres)
        depths = {name: -float(touches[name].phi) for name in spheres}
        deepest = max(depths, key=lambda name: depths[name])
        if depths[deepest] > START_TOLERANCE:
            raise ValueError(
                f"the {deepest} starts {depths[deepest]:.3g} m inside the ground; raise the start"
                f" by as much, to a height of {q[1] + depths[deepest]:.6g} m"
            )
        for index, low, high in chain.limits:
            if not low - START_TOLERANCE <= q[index] <= high + START_TOLERANCE:
                raise ValueError(
                    f"the joint {chain.coordinates[index].name} starts at {q[index]:.3g} rad, past"
                    f" its limits of {low:.3g} to {high:.3g} rad; start it between them or leave"
                    " limits out"
                )


BAR_RADIUS = 0.03
"""Radius of the bars that represent links in a drawing [m]."""
JOINT_ORIGIN = (0.0, 0.0)
"""Position of a link's joint in the link's frame [m]."""


def machine_shapes(machine: Machine, state: np.ndarray) -> list[Shape]:
    """Draw the machine at ``state`` (q, v, ...): bars, spheres, parts and the ground."""
    bars_and_poses = _bars_and_poses(machine)
    bars, poses = (np.array(out).T.tolist() for out in bars_and_poses(state[: bars_and_poses.numel_in(0)]))
    links = [Stadium(x1, z1, x2, z2, BAR_RADIUS) for x1, z1, x2, z2 in bars]
    parts = (*machine.spheres, *machine.parts)
    outlines = (
        solid(part.shape, x, z, angle, "environment" if part.link == WORLD else "object")
        for part, (x, z, angle) in zip(parts, poses, strict=True)
    )
    return [Wall(0, 0, 0, 1), *links, *outlines]


def machine_frames(
    machine: Machine, state: np.ndarray, spheres: Collection[str] | None, friction: float
) -> list[ContactFrame]:
    """Return the contact frames of ``spheres`` (None for all) on the ground, and of the collision pairs."""
    frames = _frames(machine, None if spheres is None else tuple(spheres))
    rows = np.array(frames(state[: frames.numel_in(0)])).T.tolist()
    return [ContactFrame(x, z, nx, nz, friction) for x, z, nx, nz in rows]


@cache
def _frames(machine: Machine, spheres: tuple[str, ...] | None) -> ca.Function:
    """Return the function from q to the point and the normal of every contact, (4, contacts)."""
    chain = machine.tree()
    q = ca.SX.sym("q", chain.nq)
    contacts = machine.contacts(q, spheres).values()
    columns = [ca.vertcat(contact.point, contact.normal) for contact in contacts]
    return ca.Function("frames", [q], [ca.densify(ca.horzcat(ca.SX(4, 0), *columns))])


def _rod(link: Link) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the ends of the thin rod, along ``com``, that has the link's mass, inertia and centre of mass."""
    x, z = (float(c) for c in link.com)
    away = math.hypot(x, z)
    axis = (x / away, z / away) if away else (1.0, 0.0)
    half_length = math.sqrt(3 * float(link.inertia) / float(link.mass))
    dx, dz = half_length * axis[0], half_length * axis[1]
    return (x - dx, z - dz), (x + dx, z + dz)


@cache
def _bars_and_poses(machine: Machine) -> ca.Function:
    """Return the function from q to the ends of every bar, (4, bars), and to the poses of all parts, (3, parts)."""
    # Bars go from a link's joint to its spheres and next joints; the floating link's bars connect these.
    chain = machine.tree()
    q = ca.SX.sym("q", chain.nq)
    bars, poses = [ca.SX(4, 0)], [ca.SX(3, 0)]
    for link in machine.links:
        joints = [child.anchor for child in machine.links if child.parent == link.name]
        centres = [s.centre for s in machine.spheres if s.link == link.name]
        points = sorted({(float(x), float(z)) for x, z in centres + joints})
        ends = [*pairwise(points)] if link.parent is None else [(JOINT_ORIGIN, p) for p in points]
        if not ends and all(part.link != link.name for part in (*machine.spheres, *machine.parts)):
            ends = [_rod(link)]
        to_world = chain.pose(q, link.name).to_world
        bars += [ca.vertcat(to_world(start), to_world(end)) for start, end in ends if start != end]
    for part in (*machine.spheres, *machine.parts):
        pose = link_pose(chain, q, part.link)
        poses.append(ca.vertcat(pose.position, pose.angle))
    return ca.Function("places", [q], [ca.densify(ca.horzcat(*columns)) for columns in (bars, poses)])
