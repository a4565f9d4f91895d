"""What a machine looks like: links as capsules, spheres and parts as they are, the ground."""

from __future__ import annotations

from collections.abc import Collection
from functools import cache
from itertools import pairwise

import casadi as ca
import numpy as np

from dynamics.systems import Machine
from problems.drawing import Capsule, ContactFrame, HalfPlane, Shape, solid

_THICKNESS = 0.03
_JOINT = (0.0, 0.0)


def machine_shapes(machine: Machine, state: np.ndarray) -> list[Shape]:
    """Draw the machine at ``state`` (q, v, ...): bars, spheres, parts and the ground."""
    places = _places(machine)
    bars, poses = (np.array(out).T.tolist() for out in places(state[: places.numel_in(0)]))
    links = [Capsule(x1, z1, x2, z2, _THICKNESS) for x1, z1, x2, z2 in bars]
    shapes = (part.shape for part in (*machine.spheres, *machine.parts))
    drawn = (solid(shape, *at) for shape, at in zip(shapes, poses, strict=True))
    return [HalfPlane(0, 0, 0, 1), *links, *drawn]


def machine_frames(
    machine: Machine, state: np.ndarray, spheres: Collection[str] | None, friction: float
) -> list[ContactFrame]:
    """Frames of the contacts: of ``spheres``, all by default, with the ground, and the meetings."""
    frames = _frames(machine, None if spheres is None else tuple(spheres))
    found = np.array(frames(state[: frames.numel_in(0)])).T.tolist()
    return [ContactFrame(x, z, nx, nz, friction) for x, z, nx, nz in found]


@cache
def _frames(machine: Machine, spheres: tuple[str, ...] | None) -> ca.Function:
    """Map q to the place and the normal of every contact, (4, contacts)."""
    chain = machine.chain()
    q = ca.SX.sym("q", chain.nq)
    found = machine.contacts(chain, q, spheres).values()
    columns = [ca.vertcat(contact.point, contact.normal) for contact in found]
    return ca.Function("frames", [q], [ca.densify(ca.horzcat(ca.SX(4, 0), *columns))])


@cache
def _places(machine: Machine) -> ca.Function:
    """Map q to the ends of every bar, (4, bars), and to the poses of all parts, (3, parts)."""
    # Bars run from a link's joint to its spheres and joints; the floating link runs through these.
    chain = machine.chain()
    q = ca.SX.sym("q", chain.nq)
    bars, poses = [ca.SX(4, 0)], [ca.SX(3, 0)]
    for link in machine.links:
        joints = [other.anchor for other in machine.links if other.parent == link.name]
        own = [s.centre for s in machine.spheres if s.link == link.name]
        points = sorted({(float(x), float(z)) for x, z in own + joints})
        ends = pairwise(points) if link.parent is None else [(_JOINT, p) for p in points]
        place = chain.pose(q, link.name).place
        bars += [ca.vertcat(place(start), place(end)) for start, end in ends if start != end]
    for part in (*machine.spheres, *machine.parts):
        pose = chain.pose(q, part.link)
        poses.append(ca.vertcat(pose.position, pose.angle))
    return ca.Function("places", [q], [ca.densify(ca.horzcat(*each)) for each in (bars, poses)])
