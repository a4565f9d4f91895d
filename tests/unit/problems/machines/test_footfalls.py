"""Costs of sliding: the work of friction and of low motion, against forces, distances and differences."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from dynamics.contact import Exact
from dynamics.systems import ContactSystem, Link, Machine, ParameterTable, Sphere
from dynamics.systems.space import Body, Plane, SpatialMachine, SpatialPart
from dynamics.systems.space import Sphere as Ball
from ocp.errors import InputError
from problems import get
from problems.bodies.quadruped import quadruped
from problems.machines.footfalls import clearance_cost, slip_cost

H, FRICTION, MASS, G = 0.05, 0.4, 2.0, 9.81


def block(edges: int = 4) -> ContactSystem:
    """Return a point of mass 2 kg above a plane, which slides and does not turn."""
    bodies = tuple(
        Body(axis, above, MASS if axis == "z" else 0.0, joint="slide", axis=direction, gear=1.0)
        for axis, above, direction in (
            ("x", None, (1.0, 0.0, 0.0)),
            ("y", "x", (0.0, 1.0, 0.0)),
            ("z", "y", (0.0, 0.0, 1.0)),
        )
    )
    parts = (SpatialPart("point", "z", Ball(0.0)), SpatialPart("floor", "world", Plane()))
    machine = SpatialMachine(bodies, parts, (("point", "floor"),))
    return machine.system("block", ParameterTable(), h=H, friction=FRICTION, edges=edges)


def cost_of(system: ContactSystem, cost: ca.SX, x: np.ndarray, lam: np.ndarray | float = 0.0) -> float:
    return float(ca.Function("cost", [system.x, system.lam], [cost])(x, lam))


@pytest.mark.parametrize("edges", [4, 8])
def test_a_sliding_block_dissipates_friction_times_weight_times_distance(edges: int) -> None:
    system = block(edges)
    solve = Exact().close(system).solve
    x = np.array([0, 0, 0, 0.8, 0, 0])
    x_next, lam = (np.array(value).ravel() for value in solve(x, 0, [])[:2])
    speed = 0.8 - FRICTION * G * H
    assert x_next[3:5] == pytest.approx([speed, 0], abs=1e-9)
    # f N v over a step: the impulse of the weight is m g h.
    assert cost_of(system, slip_cost(system), x, lam) == pytest.approx(FRICTION * MASS * G * H * speed, rel=1e-8)


@pytest.mark.parametrize(("x", "u"), [([0, 0, 0, 0, 0, 0], [5, 0, 0]), ([0, 0, 0.2, 1, 1, 0], [0, 0, 0])])
def test_a_block_that_sticks_or_flies_dissipates_nothing(x: list[float], u: list[float]) -> None:
    system = block()
    lam = Exact().close(system).solve(x, u, [])[1]
    assert cost_of(system, slip_cost(system), np.array(x), np.array(lam)) == pytest.approx(0, abs=1e-9)


def test_low_motion_costs_what_feet_move_along_the_ground() -> None:
    """Speeds are those of the feet's lowest points, by differences of positions of points fixed to the shins."""
    machine, clearance = quadruped(), 0.05
    system = machine.system("dog", ParameterTable(), h=H, friction=FRICTION)
    tree, rng, e = machine.tree(), np.random.default_rng(3), 1e-6
    q, v = ca.SX.sym("q", tree.nq), ca.SX.sym("v", tree.nv)
    feet = {part.name: part for part in machine.parts if part.name in ("fl", "fr", "hl", "hr")}
    centres = [tree.pose(q, feet[leg].body) for leg in feet]
    poses = ca.Function("poses", [q], [ca.horzcat(*(ca.horzcat(R, p) for R, p in centres))])
    move = ca.Function("move", [q, v], [tree.advance(q, v, centred=False)])
    for _ in range(3):
        pose = np.r_[0, 0, 0.33, 1, 0, 0, 0, rng.uniform([-0.2, 0.5, -1.5] * 4, [0.2, 0.9, -1.2] * 4)]
        speed, expected = rng.normal(size=tree.nv), 0.0
        now, ahead_behind = poses(pose).full(), [poses(move(pose, s * e * speed)).full() for s in (1, -1)]
        for k in range(4):
            R, origin = now[:, 4 * k : 4 * k + 3], now[:, 4 * k + 3]
            lowest = origin + R @ [0, 0, -0.2] - [0, 0, 0.02]
            local = R.T @ (lowest - origin)
            ends = [places[:, 4 * k : 4 * k + 4] for places in ahead_behind]
            ahead, behind = (end[:, :3] @ local + end[:, 3] for end in ends)
            slip = ((ahead - behind) / (2 * e))[:2]
            expected += max(0.0, 1 - lowest[2] / clearance) ** 2 * float(slip @ slip)
        assert expected > 0
        got = cost_of(system, clearance_cost(system, clearance), np.r_[pose, speed])
        assert got == pytest.approx(expected, rel=1e-6)


def test_motion_above_the_clearance_is_free() -> None:
    system = block()
    cost = clearance_cost(system, 0.1)
    assert cost_of(system, cost, np.array([0, 0, 0.1, 3, 0, 0])) == 0
    assert cost_of(system, cost, np.array([0, 0, 0.05, 3, 4, 0])) == pytest.approx(25 / 4)


def test_planar_machines_have_both_costs_and_machines_without_friction_neither() -> None:
    machine = Machine(
        links=(Link("body", None, mass=MASS, inertia=0.1, joint="free"),),
        spheres=(Sphere("foot", "body", (0, 0), 0.1),),
    )
    system = machine.system("m", ParameterTable(), h=H, friction=FRICTION)
    x = np.array([0, 0.1, 0, 0.8, 0, 0.0])
    lam = np.array(Exact().close(system).solve(x, 0, [])[1]).ravel()
    x_next = np.array(Exact().close(system).solve(x, 0, [])[0]).ravel()
    slip = x_next[3] - 0.1 * x_next[5]
    assert slip > 0.1
    assert cost_of(system, slip_cost(system), x, lam) == pytest.approx(FRICTION * MASS * G * H * slip, rel=1e-6)
    assert cost_of(system, clearance_cost(system, 0.1), x) == pytest.approx(0.64)
    smooth = machine.system("m", ParameterTable(), h=H, friction=None)
    for cost in (slip_cost, lambda system: clearance_cost(system, 0.1)):
        with pytest.raises(InputError, match="need contacts with friction"):
            cost(smooth)
    with pytest.raises(InputError, match="linearised friction cone"):
        slip_cost(machine.system("m", ParameterTable(), h=H, friction=FRICTION, cone="edges"))


@pytest.mark.costly
def test_weights_of_zero_leave_no_trace_and_others_add_their_costs() -> None:
    plain, weighted = get("quadruped", N=2), get("quadruped", N=2, w_slip=0.3, w_clear=2.0, clearance=0.4)
    assert not plain.uses_impulses and weighted.uses_impulses
    system, rng = weighted.system, np.random.default_rng(0)
    x = plain.initial_states(plain.parameters.values)[0] + 0.01 * rng.normal(size=system.nx)
    lam, u = rng.uniform(0, 1, system.nlam), np.zeros(system.nu)
    stage = [float(p.cost_terms(x, u, 0, lam, p.parameters.values)[0]) for p in (plain, weighted)]
    symbols = [system.x, system.lam, weighted.parameters.vector]
    terms = ca.vertcat(slip_cost(system), system.h * clearance_cost(system, 0.4))
    slip, low = np.array(ca.Function("terms", symbols, [terms])(x, lam, weighted.parameters.values)).ravel()
    assert slip > 0.01 and low > 1e-6
    assert stage[1] - stage[0] == pytest.approx(0.3 * slip + 2.0 * low, rel=1e-9)
