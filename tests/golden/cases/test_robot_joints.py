"""Joints, loops, actuators and sizes in robot files: what is read, reported, and rejected."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from dynamics.contact import Exact
from dynamics.systems.parameters import ParameterTable
from dynamics.systems.space import Tree
from ocp.errors import InputError
from ocp.simulators.mjcf import write_mjcf as mjcf_of
from problems.robots import Robot, geoms
from tests.golden.cases.robot_texts import SPHERE, joint, link, mjcf, read, told, urdf

# Joints that move together


GRIPPER = urdf(
    link("palm", ""),
    link("left", "", 0.3),
    link("right", "", 0.2),
    joint("l", "palm", "left", axis="0 1 0"),
    joint("r", "palm", "right", axis="0 -1 0", inside='<mimic joint="l" multiplier="2" offset="0.1"/>'),
)
COUPLED = """<mujoco><option gravity="0 0 0"/>
  <default><geom size=".1" contype="0" conaffinity="0"/></default><worldbody>
  <body name="left"><joint name="l" type="slide" axis="0 1 0" range="-9 9"/>
    <geom mass="0.3"/></body>
  <body name="right"><joint name="r" type="slide" axis="0 -1 0"/><geom mass="0.2"/></body>
  </worldbody>{}<actuator><motor joint="l" gear="10"/></actuator></mujoco>"""


def tied(equality: str) -> str:
    return f"<equality>{equality}</equality>"


def step_once(robot: Robot, u: float, h: float = 0.01) -> np.ndarray:
    """Return the state after one step of the exact law, from rest in the home pose."""

    system = robot.machine.system("r", ParameterTable(()), h=h, friction=None)
    x = np.concatenate([robot.home, np.zeros(system.nx - len(robot.home))])
    x_next, _, _, error = Exact().close(system).solve(x, [u], [])
    assert float(np.array(error).max()) < 1e-9
    return np.array(x_next).ravel()


@pytest.mark.parametrize(
    "text",
    [
        GRIPPER,
        COUPLED.format(tied("<joint joint1='r' joint2='l' polycoef='0.1 2 0 0 0'/>")),
        COUPLED.format(
            "<tendon><fixed name='f'><joint joint='r' coef='1'/></fixed><fixed name='g'>"
            "<joint joint='l' coef='-1'/></fixed></tendon>"
            + tied("<tendon tendon1='f' tendon2='g' polycoef='0.1 -2 0 0 0'/>")
        ),
    ],
)
def test_a_joint_that_follows_moves_its_mass_by_its_ratio(tmp_path: Path, text: str) -> None:
    """``(m1 + 2² m2) dv = h F`` in closed form, and r = 2 l + 0.1 after every step."""
    robot = read(tmp_path, text)
    assert "Joint right follows: right = 2 left + 0.1." in robot.notes
    assert len(robot.actuators) == 1, "what follows has no motor of its own"
    np.testing.assert_allclose(robot.home, [0, 0.1])
    left, right, v_left, v_right = step_once(robot, 1.0)
    assert v_left == pytest.approx(0.01 * 10 / (0.3 + 4 * 0.2), rel=1e-9)
    assert v_right == pytest.approx(2 * v_left) and right == pytest.approx(2 * left + 0.1)
    goal = np.array(ca.evalf(robot.displaced(robot.home, 0.2))).ravel()
    assert goal[1] == pytest.approx(2 * goal[0] + 0.1)


def test_mujoco_is_not_asked_about_joints_that_follow(tmp_path: Path) -> None:
    robot = read(tmp_path, GRIPPER)
    system = robot.machine.system("r", ParameterTable(()), h=0.01, friction=None)
    assert system.machine is not None
    with pytest.raises(InputError, match="joints that follow others"):
        mjcf_of(system.machine, float, {}, servo_time=0.01)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (GRIPPER.replace('joint="l" mul', 'joint="x" mul'), "which is no other joint; delete its"),
        (GRIPPER.replace('multiplier="2"', 'multiplier="two"'), "expected numbers"),
        (
            COUPLED.format(tied("<connect body1='left' body2='right' anchor='0 0 0'/>")),
            r"<connect> .* closes a loop",
        ),
        (COUPLED.format(tied("<weld body1='left' body2='right'/>")), "<weld> .* closes a loop"),
        (
            COUPLED.format(tied("<joint joint1='r' joint2='l' polycoef='0 1 3 0 0'/>")),
            "is not linear",
        ),
        (
            COUPLED.format("<equality><joint joint1='r' joint2='l'/><joint joint1='l' joint2='r'/></equality>"),
            "contradict or repeat each other",
        ),
        (
            urdf(link("a"), link("b"), joint("j", "a", "b"), "<loop_joint name='k'/>"),
            "<loop_joint> is not read, as it closes a loop",
        ),
    ],
)
def test_loops_are_refused_in_a_sentence(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        read(tmp_path, text)


def test_an_inactive_loop_is_named(tmp_path: Path) -> None:
    weld = tied("<weld name='w' active='false' body1='left' body2='right'/>")
    robot = read(tmp_path, COUPLED.format(weld))
    assert "equality constraint w: it is inactive" in told(robot)


# Actuators


FLYER = """<mujoco><worldbody><body name="b" pos="0 0 1"><freejoint/><geom size=".1" mass="1"/>
  <site name="s"/><site name="t" pos=".1 0 0"/></body>
  <body name="c" pos="2 0 1"><joint name="j" axis="0 1 0"/><geom size=".1" pos=".2 0 0"/></body>
  </worldbody><tendon><fixed name="f"><joint joint="j" coef="1"/></fixed></tendon>
  <actuator>{}</actuator></mujoco>"""


@pytest.mark.parametrize(
    "actuators",
    [
        '<motor name="x" site="s" gear="0 0 1 0 0 .1"/><motor name="y" site="t" gear="0 0 1"/>',
        '<adhesion name="x" body="c" ctrlrange="0 1" gain="2"/><motor name="y" tendon="f"/>',
        '<general name="x" site="s" refsite="t" gear="1 0 0 0 0 0"/><motor name="y" site="t"/>',
    ],
)
def test_actuators_of_sites_bodies_and_tendons_are_named(tmp_path: Path, actuators: str) -> None:
    robot = read(tmp_path, FLYER.format('<motor name="m" joint="j"/>' + actuators))
    assert "actuators x, y: only motors and position servos of hinges and slides" in told(robot)
    assert [actuator.name for actuator in robot.actuators] == ["m"]
    alone = read(tmp_path, FLYER.format(actuators))
    assert alone.controls.shape == (0, 2)


@pytest.mark.parametrize("swapped", [False, True])
def test_a_velocity_servo_beside_a_position_servo_damps(tmp_path: Path, swapped: bool) -> None:
    pair = ['<position name="p" joint="j" kp="40"/>', '<velocity name="d" joint="j" kv="3"/>']
    robot = read(tmp_path, mjcf(SPHERE, f"<actuator>{''.join(pair[:: -1 if swapped else 1])}</actuator>"))
    (body,) = robot.machine.bodies
    assert (body.servo, body.damping, body.gear) == (40, 3, None)
    assert "The input of actuator d is 0: its kv is part of the damping." in robot.notes
    with pytest.raises(InputError, match="'j' has two motors, m and n; give it one"):
        read(
            tmp_path,
            mjcf(
                SPHERE,
                '<actuator><motor name="m" joint="j"/><motor name="n" joint="j"/></actuator>',
            ),
        )


@pytest.mark.parametrize(
    "text",
    [
        mjcf(SPHERE, "<actuator><motor joint='j' gear='1e308'/></actuator>"),
        mjcf(SPHERE, "<actuator><position joint='j' kp='-1e300'/></actuator>"),
        mjcf(SPHERE.replace("0.1", "1e155")),
        urdf(link("a"), link("b", mass=1e200), joint("j", "a", "b")),
    ],
)
def test_numbers_that_overflow_are_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(InputError, match="too large to compute with; give numbers below"):
        read(tmp_path, text)


# Limits before work


def chain(count: int) -> str:
    body = "<body pos='0 0 1'><joint axis='0 1 0'/><geom size='.1'/>"
    return f"<mujoco><worldbody>{body * count}{'</body>' * count}</worldbody></mujoco>"


LARGE = {
    "joints": (
        "<mujoco><worldbody>" + "<body><joint/></body>" * 60_000 + "</worldbody></mujoco>",
        "60000 joints; at most 100",
    ),
    "joints of URDF": (
        urdf(*["<joint name='j' type='continuous'/>"] * 40_000),
        "40000 joints; at most 100",
    ),
    "geoms": (mjcf("<geom size='.1'/>" * 10_000), "10001 geoms; at most"),
    "attributes": (
        mjcf("<geom " + " ".join(f"a{k}='1'" for k in range(400_000)) + "/>"),
        "larger than 2 MB",
    ),
    "fewer attributes": (
        mjcf("<geom " + " ".join(f"a{k}='1'" for k in range(50_000)) + "/>"),
        "<geom> has 50000 attributes",
    ),
    "pairs": (
        mjcf("<geom size='.1'/>" * 101).replace(
            "</worldbody>", "<body><freejoint/>" + "<geom size='.1'/>" * 101 + "</body></worldbody>"
        ),
        "pairs of geoms may touch",
    ),
    "levels": (chain(99), "nested deeper than 100"),
}


@pytest.mark.one_case_in(3)
@pytest.mark.parametrize("case", LARGE)
def test_files_that_are_too_large_are_refused_before_any_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, case: str
) -> None:
    text, words = LARGE[case]
    if case != "pairs":
        monkeypatch.setattr(import_module("mujoco").MjSpec, "from_string", None)
    monkeypatch.setattr(geoms, "contacts_between", None)
    with pytest.raises(InputError, match=words):
        read(tmp_path, text)


@pytest.mark.costly
def test_a_long_chain_builds_each_contact_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """4005 pairs took 50 s when each of them computed the poses of all bodies."""
    counts = {"between": 0, "pose": 0}
    between, pose = geoms.contacts_between, Tree.pose

    def counted_between(*arguments: Any) -> Any:
        counts["between"] += 1
        return between(*arguments)

    def counted_pose(*arguments: Any) -> Any:
        counts["pose"] += 1
        return pose(*arguments)

    monkeypatch.setattr(geoms, "contacts_between", counted_between)
    monkeypatch.setattr(Tree, "pose", counted_pose)
    robot = read(tmp_path, chain(60))
    assert counts == {"between": len(robot.friction), "pose": 60}
    assert len(robot.friction) == 60 * 59 // 2 - 59
