"""What a machine looks like: links as capsules, spheres as discs, the ground."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import cache
from itertools import pairwise

import casadi as ca
import numpy as np

from dynamics.systems import Machine
from problems.drawing import Capsule, ContactFrame, Disc, HalfPlane, Shape

_THICKNESS = 0.03
_JOINT = (0.0, 0.0)


def machine_shapes(machine: Machine, state: np.ndarray) -> list[Shape]:
    """Draw the machine at ``state`` (q, v, ...): bars, spheres and the ground."""
    segments, _ = _places(machine)
    ends = np.array(segments(np.asarray(state)[: segments.numel_in(0)])).T
    links = [Capsule(x1, z1, x2, z2, _THICKNESS) for x1, z1, x2, z2 in ends.tolist()]
    spheres = [
        Disc(float(x), float(z), sphere.radius)
        for (x, z), sphere in zip(sphere_centres(machine, state), machine.spheres, strict=True)
    ]
    return [HalfPlane(0, 0, 0, 1), *links, *spheres]


def machine_frames(
    machine: Machine, state: np.ndarray, spheres: Collection[str], friction: float
) -> list[ContactFrame]:
    """Frames of the contacts of ``spheres`` with the ground."""
    centres = sphere_centres(machine, state)
    return [
        ContactFrame(float(x), float(z) - sphere.radius, 0.0, 1.0, friction)
        for (x, z), sphere in zip(centres, machine.spheres, strict=True)
        if sphere.name in spheres
    ]


def sphere_centres(machine: Machine, state: Sequence[float] | np.ndarray) -> np.ndarray:
    """Centre (x, z) of every sphere at ``state`` (q, v, ...), shape (spheres, 2) [m]."""
    _, discs = _places(machine)
    return np.array(discs(np.asarray(state)[: discs.numel_in(0)])).T


@cache
def _places(machine: Machine) -> tuple[ca.Function, ca.Function]:
    """Map q to the ends of every bar, (4, bars), and to the spheres' centres, (2, spheres).

    A link's bars run from its joint to its spheres and to the joints it carries; the link that
    floats is drawn through these, from back to front.
    """
    chain = machine.chain()
    q = ca.SX.sym("q", chain.nq)
    rows = []
    for link in machine.links:
        joints = [other.anchor for other in machine.links if other.parent == link.name]
        own = [s.centre for s in machine.spheres if s.link == link.name]
        points = sorted({(float(x), float(z)) for x, z in own + joints})
        bars = pairwise(points) if link.parent is None else [(_JOINT, p) for p in points]
        rows += [
            ca.vertcat(*(chain.position(q, link.name, end) for end in ends))
            for ends in bars
            if ends[0] != ends[1]
        ]
    centres = [chain.position(q, s.link, s.centre) for s in machine.spheres]
    return (
        ca.Function("links", [q], [ca.horzcat(*rows)]),
        ca.Function("spheres", [q], [ca.horzcat(*centres)]),
    )
