"""Velocities of free bodies: of their origins, as files have them, or of their centres of mass."""

from __future__ import annotations

import casadi as ca

from dynamics.systems.space import rotation
from dynamics.systems.space.tree import Tree


def about_centres(tree: Tree, q: ca.SX, v: ca.SX, sign: int = 1) -> ca.SX:
    """v (nv, 1) with the velocity of a free body's centre of mass in place of its origin's.

    With ``sign`` -1 the other way round.
    """
    found = ca.SX(v)
    for name, centre in tree.centres.items():
        four, spin = q[tree.q_of[name]][3:], v[tree.v_of[name]][3:]
        start = tree.v_of[name].start
        found[start : start + 3] += sign * rotation.matrix(four) @ ca.cross(spin, centre)
    return found


def centre_velocities(tree: Tree, q: ca.SX, v: ca.SX, h: ca.SX | float) -> ca.SX:
    """Return :func:`about_centres` of a state, whose v is that at the pose before, ``q (-) h v``.

    A step of h hands over the velocities of centres of mass exactly by that: it ends with origins'
    velocities at the pose that it set out from.
    """
    before = ca.SX(q)
    for name in tree.centres:
        four = slice(tree.q_of[name].start + 3, tree.q_of[name].stop)
        before[four] = rotation.turned(q[four], -h * v[tree.v_of[name]][3:])
    return about_centres(tree, before, v)
