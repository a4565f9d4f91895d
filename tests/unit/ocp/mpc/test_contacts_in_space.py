"""A block on a floor in space sticks, slides or flies: the slopes of each motion are those of its closed form."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import casadi as ca
import numpy as np
import pytest

from dynamics.systems import ParameterTable
from dynamics.systems.space import Body, Plane, SpatialMachine, SpatialPart, Sphere
from ocp.mpc.active_set import ActiveSets
from ocp.mpc.controller import Controller
from ocp.mpc.linearised import LinearClosure, linearise
from ocp.mpc.stages import Plan
from ocp.problem.problem import Problem, Scaling
from tests.unit.ocp.mpc.test_compiled_sample import compare_phases

MASS, FRICTION, STEP, GRAVITY, RADIUS = 2.0, 0.5, 0.1, 9.81, 0.1
"""Mass [kg], Coulomb's coefficient, step [s], gravity [m/s²], and radius [m] of the block's foot."""
GOAL = 0.2
"""Goal of the block along x and y [m]."""
HOLDS = FRICTION * MASS * GRAVITY
"""Largest force [N] along an edge direction of the pyramid at which the block sticks."""


class Motion(NamedTuple):
    """Height of the foot and forces at which a motion is decided, closed friction pairs, and dv/du of the next step."""

    height: float
    force: tuple[float, float]
    closed: int
    slope: np.ndarray


MOTIONS = {
    "sticks": Motion(0.0, (0.3 * HOLDS, -0.2 * HOLDS), 4, np.zeros((2, 2))),
    "slides": Motion(0.0, (3.0 * HOLDS, 0.5 * HOLDS), 1, STEP / MASS * np.eye(2)),
    "flies": Motion(1.0, (HOLDS, HOLDS), 1, STEP / MASS * np.eye(2)),
}


def made(edges: int = 4) -> Problem:
    """Return the problem of a block on three slides, of which the horizontal ones have motors."""
    bodies = (
        Body("x", None, 0.0, joint="slide", axis=(1.0, 0.0, 0.0), gear=1.0),
        Body("y", "x", 0.0, joint="slide", axis=(0.0, 1.0, 0.0), gear=1.0),
        Body("block", "y", MASS, (0.01, 0.01, 0.01), joint="slide", axis=(0.0, 0.0, 1.0)),
    )
    parts = (SpatialPart("foot", "block", Sphere(RADIUS)), SpatialPart("floor", "world", Plane()))
    machine = SpatialMachine(bodies, parts, (("foot", "floor"),))
    p = ParameterTable([])
    system = machine.system("block", p, h=STEP, friction=FRICTION, edges=edges)
    return Problem(
        "block",
        system,
        3,
        stage_cost=1e-6 * ca.sumsqr(system.u) + 1e-2 * ca.sumsqr(system.x[3:]),
        terminal_cost=10 * ca.sumsqr(system.x[:2] - GOAL),
        parameters=p,
        x0=ca.SX([0.0, 0.0, RADIUS, 0.0, 0.0, 0.0]),
        scaling=Scaling(x=0.1, u=HOLDS, impulse=MASS * GRAVITY * STEP, gap=0.1),
    )


@cache
def controller(edges: int = 4) -> Controller:
    """Return a controller of the block."""
    return Controller(made(edges))


@pytest.mark.cheap_cases("sticks-4", "slides-4", "flies-4")
@pytest.mark.parametrize("edges", [4, 8])
@pytest.mark.parametrize("name", MOTIONS)
def test_each_motion_has_the_slopes_of_its_closed_form(name: str, edges: int) -> None:
    """Inputs do not move a foot that sticks; they accelerate the mass of one that slides or flies."""
    motion, model = MOTIONS[name], controller(edges).model
    x = np.array([0.0, 0.0, RADIUS + motion.height, 0.0, 0.0, 0.0])
    u, p = np.tile(motion.force, (model.N, 1)), controller(edges)._horizon[1]
    low, high = controller(edges)._horizon[2][2:4]
    still = np.zeros((1, model.N, model.nu, model.nx))
    plan, *_ = controller(edges).rollouts.roll_out(x, still, u[None], u[0], (low, high), p)
    sets = ActiveSets(model)
    closed = sets.of(plan)
    [contact] = sets.contacts
    f = list(contact.friction)
    expected_closed = edges if name == "sticks" else motion.closed
    assert (closed[:, f].sum(axis=1) == expected_closed).all()
    assert closed[:, contact.slip].all()
    lin = linearise(model, plan, model.evaluate(plan, u[0], p), LinearClosure.from_active_set(plan, closed))
    assert abs(lin.x_next.by_u[:, 3:5] - motion.slope).max() < 1e-6
    assert abs(lin.x_next.value).max() < 1e-6
    # A pair that is exchanged leaves the contact with a closed friction pair, and an open contact with one.
    for which in np.eye(model.n, dtype=bool):
        other = sets.exchange(closed, np.broadcast_to(which, closed.shape))
        assert other[:, f].any(axis=1).all()
        assert (other[~other[:, contact.normal]][:, f].sum(axis=1) == 1).all()


def test_a_foot_that_slides_along_an_edge_closes_both_its_forces() -> None:
    """Forces along two directions act only where the slip is between them; both pairs are closed then."""
    model = controller().model
    [contact] = ActiveSets(model).contacts
    lam, gap = np.zeros((model.N, model.n)), np.ones((model.N, model.n))
    lam[:, [contact.normal, contact.friction[0], contact.friction[2], contact.slip]] = 1.0
    gap[:, [contact.normal, contact.friction[0], contact.friction[2], contact.slip]] = 0.0
    plan = Plan(np.zeros((model.N + 1, model.nx)), np.zeros((model.N, model.nu)), lam, gap)
    closed = ActiveSets(model).of(plan)
    assert closed[:, list(contact.friction)].tolist() == [[True, False, True, False]] * model.N
    # One of both may be exchanged alone, but not one of a foot that sticks.
    assert ActiveSets(model).exchangeable(closed)[:, list(contact.friction)].all()
    lam[:, contact.slip], gap[:, contact.slip] = 0.0, 1.0
    closed = ActiveSets(model).of(plan)
    assert closed[:, list(contact.friction)].all()
    assert not ActiveSets(model).exchangeable(closed)[:, list(contact.friction)].any()


@pytest.mark.cheap_cases("4")
@pytest.mark.parametrize("edges", [4, 8])
def test_compiled_samples_equal_those_in_numpy(edges: int) -> None:
    """Rules for active sets in space are written twice, in C and in Python."""
    compare_phases(controller(edges))


def test_the_block_is_pushed_towards_its_goal() -> None:
    """Every sample solves a program, its plan ends at the goal, and the cost from there on falls."""
    mpc, x = controller(), controller().start
    mpc.reset()
    u, merits = mpc.u_before, []
    for _ in range(12):
        command = mpc.step(x, u)
        assert command.status in ("solved", "not improved") and command.programs >= 1
        assert command.plan is not None and abs(command.plan.x[-1, :2] - GOAL).max() < 0.01 * GOAL
        u, merits = command.u, [*merits, command.merit]
        x = mpc.rollouts.step(x[None], u[None], mpc._p)[0]
    assert (np.diff(merits) < 0).all()
    assert (x[:2] > GOAL / 4).all()
