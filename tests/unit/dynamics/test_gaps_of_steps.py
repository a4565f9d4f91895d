"""The gaps that a step returns are those of its next state, wherever a foot is near a box."""

from __future__ import annotations

import casadi as ca
import numpy as np

from dynamics.contact import Exact
from dynamics.systems import WORLD, Link, Machine, ParameterTable, Part, Sphere
from dynamics.systems.shapes import Box

LEG = Machine(
    links=(
        Link("boom", None, mass=0.2, inertia=1.0, joint="slide", axis=(1.0, 0.0)),
        Link("trunk", "boom", mass=2.0, inertia=1.0, joint="slide", axis=(0.0, 1.0)),
        Link("thigh", "trunk", mass=0.4, inertia=0.003, com=(0.0, -0.12), gear=30.0),
        Link("shank", "thigh", mass=0.2, inertia=0.002, com=(0.0, -0.1), anchor=(0.0, -0.25), gear=30.0),
    ),
    spheres=(Sphere("foot", "shank", (0.0, -0.25), 0.02),),
    parts=(Part("step", WORLD, Box((0.3, 0.075), centre=(0.5, 0.075))),),
    collision_pairs=(("foot", "step"),),
)


def test_gaps_are_those_of_the_next_state_before_above_and_beside_a_box() -> None:
    """Above the box the contact's tangent is that of the ground, and in front of the box it is not."""
    system = LEG.system("leg", ParameterTable(), h=0.02, friction=0.8)
    gap_at = ca.Function("gap", [system.x, system.u, system.x_next, system.lam], [system.gap])
    solve, rng = Exact().close(system).solve, np.random.default_rng(3)
    checked = 0
    for _ in range(60):
        q = np.array([rng.uniform(-0.2, 0.9), rng.uniform(0.35, 0.7), rng.uniform(-0.8, 0.8), rng.uniform(0, 1.2)])
        x = np.concatenate([q, rng.normal(size=4)])
        u = rng.uniform(-1, 1, system.nu)
        if np.min(np.array(gap_at(x, u, x, np.zeros(system.nlam))).ravel()[:2]) < 0:
            continue
        x_next, lam, gap, error = (np.array(value).ravel() for value in solve(x, u, []))
        if error.max() < 1e-8:
            checked += 1
            np.testing.assert_allclose(gap, np.array(gap_at(x, u, x_next, lam)).ravel(), atol=1e-7)
    assert checked > 20
