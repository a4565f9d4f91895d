"""MuJoCo as an external simulator: the same machine up to rounding, soft contact, and replays of plans."""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from dynamics.systems import Link, Machine, Parameter, ParameterTable, Part, Sphere, shapes, space
from ocp import InputError, Problem
from ocp.mpc.plants import Plant
from ocp.simulators.mujoco_world import MujocoWorld
from ocp.simulators.replay import SOLREF_BAND_S, STEP_BAND_S, replay_in_simulator
from problems import get

H = 0.01
BALL = Machine((Link("ball", None, 2.0, 0.1, joint="free"),), (Sphere("ball", "ball", (0, 0), 0.2),))
PENDULUM = Machine(
    (
        Link(
            "upper", None, 1.0, 0.02, com=(0.1, -0.3), anchor=(0.2, 0.1), offset=0.4, spring=2.0, damping=0.1, gear=3.0
        ),
        Link(
            "rod",
            "upper",
            0.5,
            0.01,
            com=(0.0, -0.1),
            anchor=(0.0, -0.5),
            offset=-0.7,
            joint="slide",
            axis=(0.6, 0.8),
            spring=40.0,
            damping=0.3,
            armature=0.05,
        ),
        Link("other", None, 0.4, 0.01, com=(0.0, 0.2), limits=(-1.0, 1.0)),
        Link("end", "rod", 0.3, 0.02, com=(0.1, 0.0), anchor=(0.1, -0.2), gear=2.0),
    ),
    (),
    gravity=(0.5, -9.0),
)


def problem_of(machine: Any, h: float = H, N: int = 1, **given: Any) -> Problem:
    """Return a problem without cost for a machine, with the parameter h and friction 0.5."""
    p = ParameterTable([Parameter("h", h, "s"), Parameter("friction", 0.5, "1")])
    given = {"friction": p["friction"], **given}
    system = machine.system("own", p, h=p["h"], **given)
    start = ca.SX.zeros(system.nx)
    return Problem("own", system, N, ca.SX(0), ca.SX(0), start, p)


def world(problem: Problem) -> MujocoWorld:
    return MujocoWorld(problem, problem.parameters.defaults)


def run(problem: Problem, x: Any, steps: int, *soft: float) -> np.ndarray:
    """Return the states (steps + 1, nx) of a motion without inputs in MuJoCo."""
    there, found = world(problem), [np.array(x, dtype=float)]
    u = np.zeros(problem.system.nu)
    for _ in range(steps):
        found.append(there.step(found[-1], u, *soft))
    return np.array(found)


@pytest.mark.one_case_in(3)
@pytest.mark.parametrize("name", ["hopper", "half-cheetah", "idto-hopper", "spinner", "finger-disc"])
def test_a_named_machine_is_the_same_in_mujoco(name: str) -> None:
    world(get(name))  # The constructor checks M, forces and distances.


def test_joints_stand_in_our_order_whatever_the_tree() -> None:
    there = world(problem_of(PENDULUM, friction=None))
    assert there.mjcf.joints == ["upper", "rod", "other", "end"]
    assert list(there._q) == [0, 1, 3, 2]  # MuJoCo numbers joints depth-first.


@pytest.mark.one_case_in(5)
@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda m: m.body_mass.__setitem__(2, 9.0), "the mass matrix differs"),
        (lambda m: m.opt.gravity.__setitem__(2, -1.0), "the bias force differs"),
        (lambda m: m.geom_size.__setitem__(1, 0.5), "the distance of 'torso' differs"),
        (lambda m: m.actuator_gear.__setitem__(1, 7.0), "the force at rest differs"),
        (lambda m: m.jnt_stiffness.__setitem__(4, 7.0), "the force at rest differs"),
    ],
)
def test_what_differs_is_named(change: Any, named: str) -> None:
    there = world(get("hopper"))
    change(there.model)
    with pytest.raises(InputError, match=named):
        there.check()


def test_a_system_with_something_added_is_told() -> None:
    problem = problem_of(BALL)
    row = problem.system.residual + ca.vertcat(ca.SX.zeros(3), H * 1.0, ca.SX.zeros(2))
    with pytest.raises(InputError, match="with nothing added"):
        world(replace(problem, system=replace(problem.system, residual=row)))


def test_a_motion_without_contact_is_ours_in_the_limit() -> None:
    x = np.array([0.3, 0.05, 0.2, -0.4, 0.5, 0.0, -0.3, 1.0])
    off = []
    for n in (16, 32):
        problem = problem_of(PENDULUM, 0.2 / n, n, friction=None)
        theirs = run(problem, x, n, 0.02, 5e-5)[-1]
        step, ours = problem.exact_step, x
        for _ in range(n):
            ours = np.array(step.solve(ours, np.zeros(2), step.p.pack({"h": 0.2 / n}))[0]).ravel()
        off.append(ours - theirs)
    # The error of our step is linear in h, so that extrapolation leaves a small one.
    assert abs(off[1]).max() < 0.1 and abs(2 * off[1] - off[0]).max() < 0.1 * abs(off[1]).max()


def test_a_ball_rests_where_contact_carries_it() -> None:
    end = run(problem_of(BALL), [0, 0.25, 0, 0, 0, 0], 100)[-1]
    assert 0 < 0.2 - end[1] < 2e-3 and abs(end[3:]).max() < 1e-3
    hard = run(problem_of(BALL), [0, 0.25, 0, 0, 0, 0], 100, 0.005, 5e-4)[-1]
    assert 0 < 0.2 - hard[1] < 0.2 * (0.2 - end[1])


def test_a_block_slides_as_far_as_coulomb_says() -> None:
    block = Machine(
        (Link("block", None, 1.0, 0.01, joint="free"),),
        (),
        parts=(Part("block", "block", shapes.Box((0.2, 0.1))), Part("floor", "world", shapes.HalfPlane())),
        collision_pairs=(("block", "floor"),),
    )
    x = run(problem_of(block), [0, 0.1, 0, 1.0, 0, 0], 50)
    assert x[-1, 0] == pytest.approx(1.0 / (2 * 0.5 * 9.81), rel=0.05)
    assert abs(x[-1, 3]) < 0.01
    frictionless = run(problem_of(block, friction=None), [0, 0.1, 0, 1.0, 0, 0], 50)
    assert frictionless[-1, 3] == pytest.approx(1.0, abs=1e-9)


def test_parts_meet_only_whom_they_meet_here() -> None:
    parts = (
        Part("tip", "arm", shapes.Capsule((0, 0), (0, -0.3), 0.05)),
        Part("slope", "world", shapes.HalfPlane((0, -1), (-0.6, 0.8))),
        Part("idle", "arm", shapes.Box((1, 1), 0.1)),
    )
    machine = Machine(
        (Link("arm", None, 1.0, 0.1),),
        (Sphere("a", "arm", (0, -0.2), 0.1), Sphere("b", "arm", (0, -0.1), 0.1)),
        parts=parts,
        collision_pairs=(("slope", "tip"),),
    )
    there = world(problem_of(machine, spheres=("b",)))
    assert there.mjcf.pairs == {"b": ("b", "z = 0"), "slope on tip": ("slope", "tip")}
    assert 'name="idle"' not in there.mjcf.text
    with pytest.raises(InputError, match=r"part 'idle' is a rounded Box, which MuJoCo does not support"):
        world(problem_of(replace(machine, collision_pairs=(("idle", "slope"),))))


def test_states_beyond_positions_and_velocities_follow_the_model() -> None:
    problem = get("idto-hopper")
    x = problem.initial_states(problem.parameters.values)[0]
    after = world(problem).step(x, np.zeros(problem.system.nu))
    assert after[-1] == pytest.approx(0.05 * -0.25, rel=1e-12)
    cheetah = get("half-cheetah")
    x = cheetah.initial_states(cheetah.parameters.values)[0]
    there = world(cheetah)
    assert there.step(x, np.zeros(6))[-1] == x[-1]
    assert there.model.opt.timestep == pytest.approx(x[-1] / 12)


def test_a_machine_in_space_is_the_same_in_mujoco() -> None:
    bodies = (
        space.Body(
            "base", None, 2.0, (0.1, 0.2, 0.25, 0.01, -0.02, 0.03), (0.1, 0.0, -0.05), joint="free", damping=0.2
        ),
        space.Body(
            "fixed",
            "base",
            0.3,
            (0.01, 0.01, 0.01),
            position=(0.1, 0.2, 0.0),
            quaternion=(0.8, 0.0, 0.6, 0.0),
            joint="fixed",
        ),
        space.Body(
            "arm",
            "fixed",
            0.5,
            (0.02, 0.02, 0.01),
            (0.0, 0.0, 0.2),
            (0.0, 0.1, 0.3),
            axis=(0.6, 0.0, 0.8),
            spring=3.0,
            rest=0.2,
            gear=5.0,
            limits=(-1.0, 2.0),
            armature=0.1,
        ),
        space.Body("hand", "arm", 0.4, (0.01, 0.02, 0.015), position=(0.0, 0.0, 0.4), joint="ball"),
        space.Body("rail", None, 1.0, (0.1, 0.1, 0.1), joint="slide", servo=50.0, damping=2.0),
    )
    parts = (
        space.SpatialPart("foot", "base", space.Box((0.2, 0.1, 0.05), (0.0, 0.0, -0.1))),
        space.SpatialPart("tip", "hand", space.Sphere(0.05, (0.0, 0.0, 0.1))),
        space.SpatialPart("bar", "rail", space.Capsule((0, 0, 0), (0, 0.5, 0), 0.05)),
        space.SpatialPart("floor", "world", space.Plane()),
    )
    met = (("foot", "floor"), ("tip", "floor"), ("tip", "bar"))
    problem = problem_of(space.SpatialMachine(bodies, parts, met))
    there = world(problem)
    x = np.array(ca.DM.zeros(problem.system.nx)).ravel()
    x[2], x[3], x[8] = 0.2, 1.0, 1.0
    for _ in range(3):
        x = there.step(x, np.array([0.1, 0.2]))
    assert np.linalg.norm(x[3:7]) == pytest.approx(1.0, abs=1e-12)


TURN = (np.cos(0.4), 0.6 * np.sin(0.4), 0.0, 0.8 * np.sin(0.4))
HEAVY = {"mass": 1.0, "inertia": (0.02, 0.03, 0.04, 0.001, 0.002, -0.003), "com": (0.1, 0.2, 0.3)}
MASSLESS: dict[str, Any] = {
    "slide, slide, hinge": (
        space.Body("x", None, 0.0, joint="slide", axis=(1.0, 0.0, 0.0)),
        space.Body("z", "x", 0.0, joint="slide", axis=(0.0, 0.0, 1.0)),
        space.Body("wheel", "z", **HEAVY, gear=2.0, damping=0.1),
    ),
    "turned and moved": (
        space.Body("root", None, **HEAVY, joint="free"),
        space.Body(
            "a",
            "root",
            0.0,
            position=(0.1, -0.2, 0.3),
            quaternion=TURN,
            axis=(0.6, 0.0, 0.8),
            armature=0.1,
            spring=3.0,
            rest=0.2,
            limits=(-2.0, 2.0),
            servo=5.0,
        ),
        space.Body("b", "a", 0.0, position=(0.4, 0.1, 0.0), quaternion=TURN, axis=(0.0, 0.0, 1.0)),
        space.Body("c", "b", **HEAVY, position=(0.0, 0.2, -0.1), quaternion=TURN, joint="slide"),
        space.Body("d", "b", **HEAVY),
        space.Body("e", "d", 0.0, joint="slide", position=(0.3, 0.2, 0.1)),
        space.Body("f", "e", **HEAVY, position=(0.1, 0.0, 0.0), quaternion=TURN, gear=2.0),
    ),
}


def test_bodies_without_mass_share_one_with_several_joints() -> None:
    """The simulator's constructor compares M, forces and distances."""
    tyre = space.SpatialPart("tyre", "wheel", space.Sphere(0.2, (0.0, 0.1, 0.0)))
    ground = space.SpatialPart("ground", "world", space.Plane())
    machine = space.SpatialMachine(MASSLESS["slide, slide, hinge"], (tyre, ground), (("tyre", "ground"),))
    there = world(problem_of(machine))
    assert there.mjcf.joints == ["x", "z", "wheel"] and there.model.nbody == 2
    # b carries two bodies and remains; MuJoCo requires mass in every moving body.
    bodies = tuple(
        replace(body, mass=0.01, inertia=(1e-4,) * 3) if body.name == "b" else body
        for body in MASSLESS["turned and moved"]
    )
    there = world(problem_of(space.SpatialMachine(bodies), friction=None))
    assert there.mjcf.joints == [body.name for body in bodies]
    assert there.model.nbody == 1 + len(bodies) - 2


def test_a_plan_that_stands_keeps_its_cost() -> None:
    problem = problem_of(BALL, N=20)
    x = problem.system.x
    problem = replace(problem, stage_cost=ca.sumsqr(x[1]), x0=ca.SX([0, 0.2, 0, 0, 0, 0]))
    given = np.zeros((1, 20, 0)), problem.parameters.defaults, np.array([[0, 0.2, 0, 0, 0, 0]])
    found = replay_in_simulator("mujoco", problem, *given, 20 * 0.2**2)
    assert found.keeps and found.band[0] <= found.cost <= found.band[1]
    assert found.sentence.startswith("In MuJoCo: cost 0.79")
    dearer = replay_in_simulator("mujoco", problem, *given, 1.5 * 20 * 0.2**2)
    assert not dearer.keeps and "does not keep its cost" in dearer.sentence
    # At the settings of the band's corners the cost is one of the band's.
    corners = [
        replay_in_simulator("mujoco", problem, *given, 0.8, {"solref": solref, "h": str(h)})
        for solref in SOLREF_BAND_S
        for h in STEP_BAND_S
    ]
    costs = [corner.cost for corner in corners]
    assert corners[0].sentence.startswith("In MuJoCo at solref 0.005 s and steps of 0.5 ms: cost 0.")
    assert min(*costs, found.cost) == found.band[0] and max(*costs, found.cost) == found.band[1]
    assert corners[0].document["settings"]["solref"] == SOLREF_BAND_S[0] and len(set(costs)) > 1


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"stiffness": 1.0}, "unknown setting of mujoco 'stiffness'"),
        ({"h": "0"}, "h must be"),
        ({"h": 1e-12}, "h must be"),
    ],
)
def test_a_setting_of_a_replay_that_cannot_be_is_refused(settings: dict[str, float | str], words: str) -> None:
    given = np.zeros((1, 1, 0)), {}, np.zeros((1, 6)), 0.0
    with pytest.raises(InputError, match=words):
        replay_in_simulator("mujoco", problem_of(BALL), *given, settings)


def test_a_motion_that_diverges_is_told() -> None:
    problem = problem_of(BALL, N=2)
    start = np.array([[0, 0.2, 0, 0, 1e9, 0]])
    problem = replace(problem, stage_cost=problem.system.x[1])
    given = np.zeros((1, 2, 0)), problem.parameters.defaults
    found = replay_in_simulator("mujoco", problem, *given, start, 1.0)
    assert np.isnan(found.cost) and not found.keeps
    assert found.sentence == "In MuJoCo: the motion diverges."


def test_what_cannot_be_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = problem_of(BALL)
    with pytest.raises(InputError, match="push-disc cannot be tried in MuJoCo: it is not built by"):
        world(get("push-disc"))
    with pytest.raises(InputError, match=r"unknown world 'mujco' \(did you mean 'mujoco'\?\)"):
        replay_in_simulator("mujco", problem, np.zeros((1, 1, 0)), {}, np.zeros((1, 6)), 0.0)
    pressed = replace(problem, stage_cost=ca.sumsqr(problem.system.lam))
    with pytest.raises(InputError, match="cost or constraints depend on contact impulses"):
        world(pressed)
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(InputError, match=r"needs the package mujoco; install 'centralpath\[rob"):
        world(problem)


def test_a_plant_is_the_same_world() -> None:
    problem = get("finger-disc")
    x, u = problem.initial_states(problem.parameters.values)[0], np.array([1.0, -0.5])
    plant = Plant(problem, "mujoco", {"m": 0.7})
    there = MujocoWorld(problem, {**problem.parameters.defaults, "m": 0.7})
    after, lam = plant.step(x, u)
    assert np.array_equal(after, there.step(x, u)) and np.isnan(lam).all()
    assert not np.allclose(after, world(problem).step(x, u), atol=1e-4)


def test_a_fingertip_without_mass_gets_that_of_servos_that_lag_half_a_step() -> None:
    """Critically damped servos with the time constant T move a tip by 1 - (1 + t/T) exp(-t/T) of a command."""
    problem = get("push-cube")
    there = world(problem)
    K, h = problem.parameters.defaults["K"], problem.parameters.defaults["h"]
    T = h / 4
    assert list(there.mjcf.servo_masses.values()) == pytest.approx([K * T**2] * 3)
    x = problem.initial_states(problem.parameters.values)[0]
    held = there.step(x, x[7:10])
    assert held[7:10] == pytest.approx(x[7:10], abs=1e-9)  # Its weight is carried.
    moved = there.step(x, x[7:10] + 0.01, step=1e-5)
    assert moved[7:10] - x[7:10] == pytest.approx(0.01 * (1 - 5 * np.exp(-4)), rel=1e-3)
