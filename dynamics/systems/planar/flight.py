"""Impulse of a chain's velocity-dependent forces over one step, which does not gain energy at any speed."""

from __future__ import annotations

import casadi as ca

from dynamics.systems.elimination import solve_without_pivoting
from dynamics.systems.planar.chain import Chain


def gyroscopic_impulse(chain: Chain, q: ca.SX, v: ca.SX, h: ca.SX | float) -> ca.SX:
    """Impulse (nq, 1) [N s] of Coriolis and centrifugal forces, ``-h C(q, v) v`` up to O(h²).

    With w = J v, the velocities of all links, m, their masses and inertias, and M = J' m J:

    1. ``w = J(q - h v) v`` at the previous pose, from which q was reached,
    2. ``M(qm) vm = J(qm)' m w`` and ``w' = 2 J(qm) vm - w`` halfway, ``qm = q - h v / 2``,
    3. ``M(q) v' = J(q)' m w'``, and the impulse is ``M(q) (v' - v)``.

    Between these steps the links move freely. In step 2 the joints reflect w about the velocities that they
    allow, which preserves the kinetic energy; step 3 projects w' onto the velocities allowed at q, which loses
    energy of at most O(h⁴). So ``v'' M(q) v' <= v' M(q - h v) v`` at any h and v, whereas the explicit
    ``-h C(q, v) v`` gains energy without bound; momentum of a free chain is conserved exactly. The cost is three
    evaluations of a pose and one linear solve. Compare the symmetric projection of Hairer, Lubich and Wanner,
    Geometric Numerical Integration, 2006, V.4.1.
    """
    q_before, q_half = q - h * v, q - h * v / 2
    w = chain.link_velocities(q_before, v)
    momentum_half = chain.link_momenta(q_half, w) + chain.armature * v
    vm = solve_without_pivoting(chain.mass(q_half), momentum_half)
    link_v_half, link_v = chain.link_velocities(q_half, vm), chain.link_velocities(q, v)
    momentum_change = {link: 2 * link_v_half[link] - w[link] - link_v[link] for link in w}
    return chain.link_momenta(q, momentum_change) + 2 * chain.armature * (vm - v)
