"""Robots from files agree with MuJoCo in frames, masses, forces, energies and distances; reported features."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from dynamics.contact import Exact
from dynamics.systems import ParameterTable
from problems import robots
from problems.robots import Robot

mujoco: Any = import_module("mujoco")
ROOT = Path(__file__).parents[4]
GYM = Path(import_module("gymnasium").__file__ or "").parent / "envs/mujoco/assets"
FILES = {
    **{k: GYM / f"{k}.xml" for k in ("ant", "swimmer", "reacher", "humanoid", "hopper")},
    **{k: GYM / f"{k}.xml" for k in ("half_cheetah", "walker2d", "inverted_double_pendulum")},
    "pusher": GYM / "pusher_v5.xml",
    "our hopper": ROOT / "examples/hopper.xml",
    **{k: ROOT / f"tests/data/{k}.xml" for k in ("arm", "crane", "servos")},
    **{k: ROOT / f"tests/data/{k}.urdf" for k in ("finger", "leg")},
}
NEAR = 1e-9
CAPSULE_ON_BOX = [mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_BOX]


@pytest.fixture(autouse=True)
def _quiet() -> Iterator[None]:
    """Replace MuJoCo's handler of warnings, which writes a file."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda message: None)
    yield
    mujoco.set_mju_user_warning(before)


@cache
def loaded(name: str) -> tuple[Robot, Any]:
    return robots.load(FILES[name]), mujoco.MjModel.from_xml_path(str(FILES[name]))


def states(model: Any, count: int) -> Iterator[Any]:
    rng, data = np.random.default_rng(7), mujoco.MjData(model)
    model.opt.density = model.opt.viscosity = 0
    model.actuator_forcelimited[:] = 0
    # Our model has neither in ball joints.
    for j in np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_BALL):
        model.jnt_stiffness[j] = 0
        model.dof_armature[model.jnt_dofadr[j] :][:3] = 0
    for _ in range(count):
        data.qpos[:], data.qvel[:] = rng.uniform(-2, 2, model.nq), rng.uniform(-5, 5, model.nv)
        mujoco.mj_normalizeQuat(model, data.qpos)
        mujoco.mj_forward(model, data)
        yield data


def mass(model: Any, data: Any) -> np.ndarray:
    M, column = np.zeros((model.nv, model.nv)), np.zeros(model.nv)
    for i, unit in enumerate(np.eye(model.nv)):
        mujoco.mj_mulM(model, data, column, unit)
        M[:, i] = column
    return M


def relative(ours: Any, theirs: Any) -> float:
    ours, theirs = np.array(ours).ravel(), np.array(theirs).ravel()
    return float(np.abs(ours - theirs).max() / max(1e-3, np.abs(theirs).max()))


def forces(robot: Robot, q: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return the generalised forces (nv,) of motors and servos, without their damping."""
    tree = robot.machine.tree()
    force = np.zeros(tree.nv)
    for name, value in zip(tree.actuated, u, strict=True):
        body, at = tree.bodies[name], tree.v_of[name]
        servo = body.servo is not None
        force[at] = body.servo * (value - q[tree.q_of[name]]) if servo else body.gear * value
    return force


def check_dynamics(robot: Robot, model: Any, count: int = 100) -> None:
    """Check M, bias, energy, forces of springs and dampers, and the motion of every body against MuJoCo."""
    tree = robot.machine.tree()
    q, v = ca.SX.sym("q", tree.nq), ca.SX.sym("v", tree.nv)
    assert (tree.nq, tree.nv, len(robot.joints)) == (model.nq, model.nv, model.nq)
    stiff, damped, rest = (
        tree.per_velocity(lambda body, key=key: getattr(body, key)) for key in ("spring", "damping", "rest")
    )
    passive = -stiff * (tree.position_of(q) - rest) - damped * v
    moved = [b for b in range(1, model.nbody) if model.body_jntnum[b]]
    poses = [tree.pose(q, model.body(b).name or f"body {b}") for b in moved]
    ours = ca.Function(
        "ours",
        [q, v],
        [tree.mass(q), tree.bias(q, v), tree.energy(q, v), passive, *(x for p in poses for x in p)],
    )
    fixed: dict[int, np.ndarray] = {}
    for data in states(model, count):
        M, bias, energy, force, *frames = ours(data.qpos, data.qvel)
        assert relative(M, mass(model, data)) < NEAR
        assert relative(bias, data.qfrc_bias) < NEAR
        held = forces(robot, data.qpos, np.zeros(len(robot.actuators))) + np.array(force).ravel()
        assert relative(held, data.qfrc_spring + data.qfrc_damper + data.qfrc_actuator) < NEAR
        mujoco.mj_energyPos(model, data)
        mujoco.mj_energyVel(model, data)
        assert abs(float(energy) - data.energy.sum()) < NEAR * max(1, abs(data.energy).max())
        for b, R, p in zip(moved, map(np.array, frames[::2]), frames[1::2], strict=True):
            # MuJoCo's frame relative to ours is the same in all poses.
            place = R.T @ (data.xpos[b] - np.array(p).ravel())
            theirs = np.column_stack([R.T @ data.xmat[b].reshape(3, 3), place])
            np.testing.assert_allclose(theirs, fixed.setdefault(b, theirs), atol=1e-11)


@pytest.mark.cheap_cases("arm", "finger")
@pytest.mark.parametrize("name", FILES)
def test_masses_forces_energies_and_frames_are_those_of_mujoco(name: str) -> None:
    check_dynamics(*loaded(name))


@pytest.mark.cheap_cases("crane", "hopper", "our hopper", "arm")
@pytest.mark.parametrize(
    "name", ["ant", "crane", "humanoid", "hopper", "half_cheetah", "walker2d", "our hopper", "arm"]
)
def test_distances_are_those_of_mujoco(name: str) -> None:
    """From a plane the smallest of all distances is compared, for two round parts their only distance."""
    robot, model = loaded(name)
    groups = {}
    for pair in robot.machine.collision_pairs:
        label = re.compile(re.escape(" on ".join(pair)) + r"( \d+)?")
        groups[pair] = [k for k, one in enumerate(robot.friction) if label.fullmatch(one)]
    assert sorted(k for own in groups.values() for k in own) == list(range(len(robot.friction)))
    seen = set()
    for data in states(model, 20):
        ours = np.array(robot.distances(data.qpos)).ravel()
        for pair, own in groups.items():
            one, other = (model.geom(geom).id for geom in pair)
            theirs = mujoco.mj_geomDistance(model, data, one, other, 50.0, None)
            if [model.geom_type[g] for g in (one, other)] == CAPSULE_ON_BOX:
                # Only its ends touch.
                assert ours[own].min() >= theirs - 1e-10
            elif theirs > 0 or model.geom_type[other] == mujoco.mjtGeom.mjGEOM_PLANE:
                assert ours[own].min() == pytest.approx(theirs, rel=NEAR, abs=1e-10), pair
                seen.add(pair)
    assert groups and len(seen) > 0.8 * len(groups)


@pytest.mark.one_case_in(2)
@pytest.mark.parametrize("name", FILES)
def test_limits_motors_and_home_are_those_of_the_file(name: str) -> None:
    robot, model = loaded(name)
    tree = robot.machine.tree()
    for _, at, _, low, high in tree.limits:
        np.testing.assert_allclose(np.array([low, high], float), model.joint(robot.joints[at]).range)
    limited = (model.jnt_limited > 0) & (model.jnt_type > 1)
    assert len(tree.limits) == limited.sum()
    home = np.array(model.key_qpos[0] if model.nkey else model.qpos0)
    limited = np.flatnonzero(model.jnt_limited * (model.jnt_type >= 2))
    at = model.jnt_qposadr[limited]
    home[at] = np.clip(home[at], *model.jnt_range[limited].T)
    np.testing.assert_array_equal(robot.home, home)
    if not model.nu:
        return
    joints = [model.joint(robot.joints[tree.q_of[body].start]).id for body in tree.actuated]
    order = [model.actuator_trnid[:, 0].tolist().index(joint) for joint in joints]
    driven = [tree.bodies[body] for body in tree.actuated]
    unit = np.where([b.servo is not None for b in driven], model.actuator_gear[order, 0], 1)
    ranges = np.sort(model.actuator_ctrlrange[order] / unit[:, None], axis=1)
    unbounded = ~model.actuator_ctrllimited[order].astype(bool)
    ranges[unbounded] = -np.inf, np.inf
    np.testing.assert_allclose(robot.controls, ranges)
    data, rng = mujoco.MjData(model), np.random.default_rng(1)
    u = np.clip(rng.uniform(-0.3, 0.4, len(order)), *robot.controls.T)
    model.actuator_forcelimited[:] = 0
    data.qpos[:] = robot.home
    data.ctrl[order] = u * unit
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(forces(robot, robot.home, u), data.qfrc_actuator, atol=1e-12)


def test_a_short_step_without_contact_is_mujocos() -> None:
    """Accelerations with motors, dampers and velocity forces agree; implicit terms differ by order h."""
    robot, model = loaded("arm")
    h, data = 1e-6, mujoco.MjData(model)
    system = robot.machine.system("arm", ParameterTable([]), h=h, friction=robot.coefficients)
    x = np.array([-0.5, 0.4, 1.0, -2.0])
    data.qpos[:], data.qvel[:], data.ctrl[:] = x[:2], x[2:], [0.3, -0.2]
    after = np.array(Exact().close(system).solve(x, data.ctrl, [])[0]).ravel()
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose((after - x)[2:] / h, data.qacc, rtol=1e-4)


def test_pairs_that_are_left_out_never_meet() -> None:
    """In random poses within the limits none of these pairs is in contact."""
    robot, model = loaded("crane")
    del robot
    data, rng = mujoco.MjData(model), np.random.default_rng(3)
    far, floor = model.geom("far").id, model.geom("floor").id
    low, high = model.jnt_range[[0, 1, 3]].T
    at = model.jnt_qposadr[[0, 1, 3]]
    for _ in range(200):
        data.qpos[at] = rng.uniform(low, high)
        data.qpos[2:6] = rng.normal(size=4)
        mujoco.mj_normalizeQuat(model, data.qpos)
        mujoco.mj_forward(model, data)
        assert mujoco.mj_geomDistance(model, data, floor, far, 50.0, None) > 0


def test_a_floating_robot_stands_and_a_fixed_one_turns_within_its_limits() -> None:
    hopper, arm = loaded("our hopper")[0], loaded("arm")[0]
    stood = hopper.standing()
    assert float(np.array(hopper.distances(stood)).min()) == pytest.approx(0, abs=1e-12)
    assert hopper.floats and not arm.floats
    goal = np.array(ca.evalf(hopper.displaced(stood, 0.3))).ravel()
    np.testing.assert_allclose(goal - stood, [0.3, 0, 0, 0, 0, 0])
    np.testing.assert_allclose(np.array(ca.evalf(arm.displaced(arm.home, 3.0))).ravel(), [3, 2.4])


def test_armature_counts_in_mass_and_energy_and_not_on_a_floating_link() -> None:
    from dynamics.systems import Link
    from dynamics.systems.planar.chain import Chain

    plain, geared = (Chain([Link("a", None, 1.0, 0.1, (0.2, 0), armature=J)]) for J in (0.0, 0.3))
    q, v, a = ca.SX(0.4), ca.SX(2.0), ca.SX(-1.0)
    more = {
        "mass": (lambda chain: chain.mass(q), 0.3),
        "energy": (lambda chain: chain.energy(q, v), 0.3 * 2.0**2 / 2),
        "force": (lambda chain: chain.inverse_dynamics(q, v, a), -0.3),
        "bias": (lambda chain: chain.bias(q, v), 0.0),
        "weight": (lambda chain: chain.total_mass, 0.0),
    }
    for what, (value, expected) in more.items():
        added = float(ca.evalf(value(geared) - value(plain)))
        assert added == pytest.approx(expected, abs=1e-12), what
    with pytest.raises(ValueError, match="armature must not be negative"):
        Link("a", None, 1.0, 0.1, armature=-1)
    with pytest.raises(ValueError, match="floats freely"):
        Link("a", None, 1.0, 0.1, joint="free", armature=0.1)
