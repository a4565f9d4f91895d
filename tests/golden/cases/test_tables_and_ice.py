"""Plans of bodies on tables, next to weak springs, and on patches of ice."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from dynamics.systems import (
    ParameterTable,
)
from ocp import solve
from ocp.problem.problem import Problem, Scaling
from problems.scenes import Body, Box, Disc, Goal, Obstacle, Polygon, Pusher, Scene, Union
from tests.golden.cases.test_plans import TABLE


def corner(N: int, stiffness: float = 150.0) -> Problem:
    """Return a problem of a finger that pushes an L on a table past a post."""
    shape = Union(
        [
            Polygon([(-0.12, -0.08), (0.12, -0.08), (0.12, 0.0), (-0.12, 0.0)]),
            Polygon([(-0.12, 0.0), (-0.04, 0.0), (-0.04, 0.12), (-0.12, 0.12)]),
        ]
    )
    things = Scene(
        [
            Pusher("finger", Disc(0.03), at=(-0.25, 0.0), stiffness=stiffness),
            Body("ell", shape, at=(0.0, 0.0), mass=0.8, inertia=0.01, table=0.3),
            Obstacle("post", Disc(0.05), at=(0.3, -0.03)),
            Goal("ell", at=(0.4, 0.1), angle=1.2),
        ],
        friction={("finger", "ell"): 0.3},
    )
    system = things.quasi_dynamic("corner", TABLE, h=TABLE["h"])
    off = things.coordinates_of("ell", system.x)[:2] - ca.SX([0.4, 0.1])
    du = ca.SX.sym("du", system.nu)
    return Problem(
        "corner",
        system,
        N,
        0.01 * ca.sumsqr(off) + 0.05 * ca.sumsqr(du),
        20 * ca.sumsqr(off),
        things.at_rest(system),
        TABLE,
        du=du,
        u_before=things.hold,
        scaling=Scaling(impulse=0.3, gap=0.1, x=0.5, u=0.5),
    )


@pytest.mark.slow
def test_a_body_on_a_table_that_is_not_at_its_best_gets_a_verdict() -> None:
    found = solve(corner(6), search=False, settings={"max_iter": 40})
    assert found.verdict
    assert not found.route.failures


@pytest.mark.slow
@pytest.mark.parametrize("stiffness", [1e-9, 1e-3])
def test_a_finger_on_next_to_no_spring_gets_a_verdict(stiffness: float) -> None:
    found = solve(corner(2, stiffness), settings={"max_iter": 20})
    assert found.verdict
    assert not found.route.failures


HAND, DRY, ICE, EDGE, END, STEPS, STEP = 0.01, 0.6, 0.05, 1.0, 2.0, 40, 0.05


def iced() -> Problem:
    """Return a problem of a hand that pushes a block to rest from dry floor onto ice beyond ``EDGE``."""
    things = Scene(
        [
            Pusher("hand", Disc(0.1), at=(-0.2, 0.1), mass=HAND, axis=(1.0, 0.0)),
            Body("block", Disc(0.1), at=(0.0, 0.1), mass=1.0),
            Obstacle("dry", Box((2.0, 0.5)), at=(EDGE - 2.0, -0.5)),
            Obstacle("ice", Box((2.0, 0.5)), at=(EDGE + 2.0, -0.5)),
            Goal("block", at=(END, 0.1)),
        ],
        friction={("block", "dry"): DRY, ("block", "ice"): ICE},
        non_colliding=[("hand", "dry"), ("hand", "ice")],
    )
    system = things.time_stepping("iced", ParameterTable(), h=STEP, gravity=(0, -9.81))
    off, v = things.coordinates_of("block", system.x)[0] - END, system.x[system.nx // 2 :]
    return Problem(
        "iced",
        system,
        STEPS,
        0.01 * STEP * system.u**2,
        100 * off**2 + 10 * ca.sumsqr(v),
        things.at_rest(system),
        ParameterTable(),
        u_lower=-15,
        u_upper=15,
        scaling=Scaling(impulse=0.5, gap=0.1, u=5),
    )


def ice_peer(on_dry: int, released: int) -> float:
    """Return the cost of a plan with ``on_dry`` steps on dry floor and a push of ``released`` steps.

    It is a convex program: hand and block move forward together, then the block slides on alone.
    """
    opti = ca.Opti()
    force, x, v = opti.variable(STEPS), opti.variable(STEPS + 1), opti.variable(STEPS + 1)
    hand = opti.variable(STEPS + 1)
    opti.subject_to([x[0] == 0, v[0] == 0, hand[0] == 0])
    for k in range(STEPS):
        brake = (DRY if k < on_dry else ICE) * 9.81 * STEP
        push = HAND * (hand[k] - hand[k + 1]) + STEP * force[k]
        opti.subject_to(x[k + 1] == x[k] + STEP * v[k + 1])
        opti.subject_to(v[k + 1] >= 0)
        if k < released:
            opti.subject_to([hand[k + 1] == v[k + 1], push >= 0, v[k + 1] - v[k] == push - brake])
        else:
            opti.subject_to([push == 0, hand[k + 1] <= v[k + 1], v[k + 1] - v[k] == -brake])
        # A step has the friction at its end.
        opti.subject_to(x[k + 1] <= EDGE if k < on_dry else x[k + 1] >= EDGE)
    opti.subject_to(opti.bounded(-15, force, 15))
    end = 100 * (x[STEPS] - END) ** 2 + 10 * (v[STEPS] ** 2 + hand[STEPS] ** 2)
    opti.minimize(0.01 * STEP * ca.sumsqr(force) + end)
    opti.solver("ipopt", {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes"}})
    try:
        return float(opti.solve().value(opti.f))
    except RuntimeError:
        return np.inf


@pytest.mark.slow
def test_a_block_from_floor_onto_ice_costs_no_more_than_pushing_it_along() -> None:
    peers = [ice_peer(n, r) for n in range(12, 30) for r in (15, 20, 25)]
    assert np.isfinite(min(peers))
    found = solve(iced())
    assert found.success
    assert found.cost == pytest.approx(min(peers), rel=1e-4)
