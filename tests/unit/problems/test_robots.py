"""Robots of files are MuJoCo's: masses, forces, energies, distances, and numbers of joints."""

from __future__ import annotations

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
ROOT = Path(__file__).parents[3]
GYM = Path(import_module("gymnasium").__file__ or "").parent / "envs/mujoco/assets"
FILES = {
    "hopper": GYM / "hopper.xml",
    "half-cheetah": GYM / "half_cheetah.xml",
    "walker": GYM / "walker2d.xml",
    "double pendulum": GYM / "inverted_double_pendulum.xml",
    "our hopper": ROOT / "examples/hopper.xml",
    "arm": ROOT / "tests/data/arm.xml",
    "finger": ROOT / "tests/data/finger.urdf",
    "leg": ROOT / "tests/data/leg.urdf",
}
NEAR = 1e-9


@pytest.fixture(autouse=True)
def _quiet() -> Iterator[None]:
    """MuJoCo's own handler of warnings writes a file."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda message: None)
    yield
    mujoco.set_mju_user_warning(before)


@cache
def loaded(name: str) -> Robot:
    return robots.load(FILES[name])


def states(robot: Robot, model: Any, count: int = 100) -> Iterator[tuple[Any, Any, Any]]:
    """MuJoCo's data at random states, with q and v of ours."""
    rng, data = np.random.default_rng(7), mujoco.MjData(model)
    at = order(robot, model)
    for _ in range(count):
        data.qpos[:], data.qvel[:] = rng.uniform(-2, 2, model.nq), rng.uniform(-5, 5, model.nv)
        mujoco.mj_forward(model, data)
        q = robot.signs * (data.qpos[at] - robot.rests)
        yield data, q, robot.signs * data.qvel[at]


def order(robot: Robot, model: Any) -> list[int]:
    """Places of our coordinates in the file's."""
    return [int(model.joint(name).qposadr[0]) for name in robot.joints]


def mass(model: Any, data: Any) -> np.ndarray:
    M, column = np.zeros((model.nv, model.nv)), np.zeros(model.nv)
    for i, unit in enumerate(np.eye(model.nv)):
        mujoco.mj_mulM(model, data, column, unit)
        M[:, i] = column
    return M


def relative(ours: Any, theirs: Any) -> float:
    ours, theirs = np.array(ours).ravel(), np.array(theirs).ravel()
    return float(np.abs(ours - theirs).max() / np.abs(theirs).max())


def check_dynamics(robot: Robot, model: Any, count: int = 100) -> None:
    """M, bias, energy, and the forces of springs and dampers."""
    chain, at, signs = robot.machine.chain(), order(robot, model), robot.signs
    q, v = ca.SX.sym("q", chain.nq), ca.SX.sym("v", chain.nq)
    passive = chain.spring(q) + chain.damping(v)
    ours = ca.Function(
        "ours", [q, v], [chain.mass(q), chain.bias(q, v), chain.energy(q, v), passive]
    )
    for data, here, speed in states(robot, model, count):
        M, bias, energy, force = ours(here, speed)
        theirs = mass(model, data)[np.ix_(at, at)] * np.outer(signs, signs)
        assert relative(M, theirs) < NEAR
        assert relative(bias, signs * data.qfrc_bias[at]) < NEAR
        mujoco.mj_energyPos(model, data)
        mujoco.mj_energyVel(model, data)
        scale = abs(data.energy).max()
        assert abs(float(energy) - data.energy.sum()) < NEAR * scale
        expected = signs * (data.qfrc_spring + data.qfrc_damper)[at]
        np.testing.assert_allclose(np.array(force).ravel(), expected, rtol=NEAR, atol=1e-12)


@pytest.mark.parametrize("name", FILES)
def test_masses_forces_and_energies_are_those_of_mujoco(name: str) -> None:
    check_dynamics(loaded(name), mujoco.MjModel.from_xml_path(str(FILES[name])))


@pytest.mark.parametrize("name", ["hopper", "half-cheetah", "walker", "our hopper", "arm"])
def test_distances_are_those_of_mujoco(name: str) -> None:
    """A geom is as far from the floor as the nearer of its corners; of two that overlap MuJoCo
    gives the depth of one of them."""
    robot, model = loaded(name), mujoco.MjModel.from_xml_path(str(FILES[name]))
    pairs: dict[tuple[str, str], list[int]] = {}
    for i, contact in enumerate(robot.friction):
        one, _, other = contact.partition(" on ")
        pairs.setdefault(
            (one.removesuffix(" start").removesuffix(" end"), other or "floor"), []
        ).append(i)
    seen = 0
    for data, q, _ in states(robot, model):
        ours = np.array(robot.distances(q)).ravel()
        for (one, other), own in pairs.items():
            ids = model.geom(other).id, model.geom(one).id
            theirs = mujoco.mj_geomDistance(model, data, *ids, 50.0, None)
            if other == "floor" or theirs > 0:
                assert ours[own].min() == pytest.approx(theirs, rel=NEAR, abs=1e-10), (one, other)
                seen += 1
    assert seen > 80 * len(pairs) and pairs


@pytest.mark.parametrize("name", FILES)
def test_limits_motors_and_home_are_those_of_the_file(name: str) -> None:
    robot, model = loaded(name), mujoco.MjModel.from_xml_path(str(FILES[name]))
    chain, at, signs = robot.machine.chain(), order(robot, model), robot.signs
    limits = {i: (low, high) for i, low, high in chain.limits}
    for i, joint in enumerate(map(model.joint, robot.joints)):
        assert (i in limits) == bool(joint.limited[0])
        if i in limits:
            np.testing.assert_allclose(np.sort(signs[i] * np.array(limits[i])), joint.range)
    reference = model.key_qpos[0] if model.nkey else model.qpos0
    np.testing.assert_allclose(robot.home, signs * reference[at])
    if model.nu:
        data = mujoco.MjData(model)
        u = np.random.default_rng(1).uniform(*model.actuator_ctrlrange.T)
        data.ctrl[:] = u
        mujoco.mj_forward(model, data)
        joints = [model.actuator_trnid[k][0] for k in range(model.nu)]
        ours = [joints.index(model.joint(name).id) for name in moved(robot)]
        force = np.array(ca.DM(ca.evalf(chain.B))) @ u[ours]
        np.testing.assert_allclose(force, signs * data.qfrc_actuator[at])
        np.testing.assert_array_equal(robot.controls, model.actuator_ctrlrange[ours])


def moved(robot: Robot) -> list[str]:
    """Joints of the motors in the order of ours."""
    names = [signal.name for signal in robot.machine.chain().coordinates]
    return [robot.joints[names.index(link)] for link in robot.machine.chain().actuated]


def test_a_step_without_contact_is_mujocos() -> None:
    """Both take velocities first, and dampers at the end of the step."""
    robot, model = loaded("arm"), mujoco.MjModel.from_xml_path(str(FILES["arm"]))
    table = ParameterTable([])
    system = robot.machine.system("arm", table, h=0.01, friction=robot.coefficients)
    step, data = Exact().close(system), mujoco.MjData(model)
    model.opt.timestep = 0.01
    x = np.array([-0.5, 0.4, 1.0, -2.0])
    data.qpos[:], data.qvel[:], data.ctrl[:] = x[:2], x[2:], [0.3, -0.2]
    for _ in range(10):
        mujoco.mj_step(model, data)
        x = np.array(step.solve(x, data.ctrl, [])[0]).ravel()
        np.testing.assert_allclose(x, [*data.qpos, *data.qvel], rtol=1e-7)


def test_what_is_not_used_is_told_by_name(tmp_path: Path) -> None:
    file = tmp_path / "odd.xml"
    file.write_text("""<mujoco>
      <option timestep="0.001" density="1.2"><flag limit="disable"/></option>
      <worldbody>
        <geom name="floor" type="plane" size="0 0 1"/>
        <body name="a" pos="0 0 2" gravcomp="0.5">
          <joint name="j" axis="0 1 0" frictionloss="0.1" stiffness="3" springref="20"/>
          <geom name="ball" size=".1" pos=".1 0 0" solref="0.05 1" condim="6"/>
          <geom name="egg" type="ellipsoid" size=".1 .2 .1"/>
          <site name="s"/><geom name="hub" size=".05"/>
          <body name="b" pos="1 0 0">
            <joint name="k" axis="0 -1 0" ref="30"/>
            <geom name="rod" type="capsule" fromto="0 0 0 .3 .2 0" size=".02"/>
          </body>
          <body name="c" pos="1 0 1">
            <joint name="l" axis="0 1 0"/><geom name="stone" type="box" size=".1 .1 .2"/>
          </body>
        </body>
      </worldbody>
      <tendon><fixed name="rope"><joint joint="j" coef="1"/></fixed></tendon>
      <equality><joint name="tie" joint1="j" joint2="k"/></equality>
      <actuator><motor name="m" joint="j"/><position name="servo" joint="k" kp="2"/></actuator>
      <sensor><jointpos name="angle" joint="j"/></sensor>
    </mujoco>""")
    robot = robots.load(file)
    told = "\n".join(robot.ignored)
    for words in (
        "sensor angle:", "option density: there is no", "options timestep, limit:",
        "solref of geom ball:",
        "frictionloss of joint j:", "gravcomp of body a:", "tendon rope:",
        "equality constraint tie:",
        "actuator servo:", "geom egg: it is an ellipsoid", "geom rod: it leans along y",
        "torsional and rolling", "contact hub: no joint moves it",
    ):  # fmt: skip
        assert words in told, words
    assert robot.motors == ("m",) and np.isinf(robot.controls).all()
    # The spring rests at 20 degrees, where our q is 0; the other joint's reference is 30 degrees.
    np.testing.assert_allclose(robot.rests, [np.radians(20), 0, 0])
    np.testing.assert_allclose(robot.home, [-np.radians(20), -np.radians(30), 0])
    names = list(robot.friction)
    assert {"ball", "rod start", "rod end"} <= set(names)
    assert [n for n in names if n.startswith("stone corner")] == [
        f"stone corner {k} on floor" for k in (1, 2, 3, 4)
    ]
    model = mujoco.MjModel.from_xml_path(str(file))
    model.body_gravcomp[:] = 0
    chain, q = robot.machine.chain(), ca.SX.sym("q", 3)
    spring = ca.Function("spring", [q], [chain.spring(q), chain.mass(q)])
    for data, here, _ in states(robot, model, 10):
        force, M = spring(here)
        expected = robot.signs * data.qfrc_spring
        np.testing.assert_allclose(np.array(force).ravel(), expected, rtol=1e-9, atol=1e-12)
        assert relative(M, mass(model, data) * np.outer(robot.signs, robot.signs)) < NEAR
        gaps = dict(zip(names, np.array(robot.distances(here)).ravel(), strict=True))
        for geom in ("ball", "rod", "stone"):
            floor = {n: gap for n, gap in gaps.items() if n.partition(" on ")[2] in ("", "floor")}
            own = [gap for name, gap in floor.items() if name.startswith(geom)]
            ids = model.geom("floor").id, model.geom(geom).id
            theirs = mujoco.mj_geomDistance(model, data, *ids, 50.0, None)
            assert min(own) == pytest.approx(theirs, rel=NEAR, abs=1e-10)


def test_a_floating_robot_stands_and_a_fixed_one_turns_within_its_limits() -> None:
    hopper, arm = loaded("our hopper"), loaded("arm")
    stood = hopper.standing()
    assert float(np.array(hopper.distances(stood)).min()) == pytest.approx(0, abs=1e-12)
    assert hopper.floats and not arm.floats
    goal = np.array(ca.evalf(hopper.displaced(stood, 0.3))).ravel()
    np.testing.assert_allclose(goal - stood, [0.3, 0, 0, 0, 0, 0])
    np.testing.assert_allclose(np.array(ca.evalf(arm.displaced(arm.home, 3.0))).ravel(), [3, 2.4])


def test_armature_counts_in_mass_and_energy_and_not_on_a_floating_link() -> None:
    from dynamics.systems import Link
    from dynamics.systems.chain import Chain

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
