"""Poses and points of tasks: a crouch, the end effector and where it can be, the object of a push."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

pytest.importorskip("mujoco")

from ocp.errors import InputError
from problems import robots
from problems.robots import Robot
from problems.robots.poses import (
    BodyPlace,
    check_task,
    crouched,
    end_effector,
    push_direction,
    pushed_object,
    reachable,
    trunk_height,
)

ROOT = Path(__file__).parents[4]
DATA = ROOT / "tests/data"


@cache
def loaded(name: str) -> Robot:
    folder = ROOT / "examples" if name in ("hopper.xml", "examples/arm.xml") else DATA
    return robots.load(folder / name.removeprefix("examples/"))


@pytest.mark.parametrize(("name", "share"), [("hopper.xml", 0.2), ("biped.xml", 0.1), ("dog.xml", 0.15)])
def test_a_crouch_lowers_the_trunk_on_feet_that_stay(name: str, share: float) -> None:
    robot = loaded(name)
    stands, low = robot.standing(), crouched(robot, share)
    trunk = BodyPlace(robot.root_bodies[-1])
    before, after = (trunk.at(robot.machine, pose) for pose in (stands, low))
    assert before[2] == pytest.approx(trunk_height(robot))
    np.testing.assert_allclose(after, before * [1, 1, 1 - share], atol=1e-9)
    assert low[list(robot.root_entries)][2] == pytest.approx(stands[list(robot.root_entries)][2]), "upright"
    gaps = np.array(robot.distances(low)).ravel()[list(robot.footholds)]
    np.testing.assert_allclose(gaps, 0, atol=1e-7)
    for _, entry, _, lower, upper in robot.machine.tree().limits:
        assert lower - 1e-9 <= low[entry] <= upper + 1e-9
    feet = [robot.machine.contacts(ca.SX(pose)) for pose in (stands, low)]
    for label in feet[0]:
        moved = np.array(ca.evalf(feet[1][label].point - feet[0][label].point))
        assert np.abs(moved).max() < 0.06


def test_of_two_leg_joints_the_crouch_is_that_of_a_triangle() -> None:
    """Thigh and shank of 0.2 m, trunk over the foot: the knee's angle follows from the law of cosines."""
    robot = loaded("dog.xml")
    low = crouched(robot, 0.15)
    length = 0.85 * trunk_height(robot) - 0.02
    along = 0.2 * np.sin(low[3]) + 0.2 * np.sin(low[3] + low[4])
    assert 0.2 * np.cos(low[3]) + 0.2 * np.cos(low[3] + low[4]) == pytest.approx(length, abs=1e-7)
    knee = np.arccos((length**2 + along**2 - 0.08) / 0.08)
    assert low[4] == pytest.approx(-knee, abs=1e-6)
    np.testing.assert_allclose(low[3:5], low[5:7], atol=1e-4)


def test_the_end_effector_is_the_end_of_the_longest_chain() -> None:
    arm = loaded("arm.xml")
    assert end_effector(arm) == BodyPlace("fore", (0.3, 0.0, 0.0))
    pose = np.array([0.4, -0.9])
    angles = np.cumsum(pose)
    expected = [0.4 * np.cos(angles[0]) + 0.3 * np.cos(angles[1]), 0, 0.5 - 0.4 * np.sin(angles[0])]
    expected[2] -= 0.3 * np.sin(angles[1])
    np.testing.assert_allclose(end_effector(arm).at(arm.machine, pose), expected, atol=1e-12)
    assert end_effector(loaded("examples/arm.xml")).body == "fore", "the box is no end of the arm"


@pytest.mark.parametrize("name", ["arm.xml", "finger.urdf", "examples/arm.xml", "gantry.xml"])
def test_a_reachable_place_is_one_of_a_free_pose_within_the_limits(name: str) -> None:
    """The largest change of every joint moves the end effector by at most the sum of changes times lever arms."""
    robot = loaded(name)
    tip, place = end_effector(robot), reachable(robot)
    distance = np.linalg.norm(place - tip.at(robot.machine, robot.home))
    assert 0.05 < distance < 2.0
    tree, best = robot.machine.tree(), np.inf
    joints = [n for n in tree.bodies if n not in robot.objects]
    for signs in np.ndindex(*(2,) * len(joints)):
        changes = {
            n: (1 - 2 * s) * (0.5 if tree.bodies[n].joint == "hinge" else 0.1)
            for n, s in zip(joints, signs, strict=True)
        }
        pose = np.array(ca.evalf(robot.with_joints_moved(robot.home, changes))).ravel()
        best = min(best, np.linalg.norm(tip.at(robot.machine, pose) - place))
    assert best < 1e-9


def test_an_object_is_pushed_away_from_the_base_and_is_no_joint_of_the_arm() -> None:
    robot = loaded("examples/arm.xml")
    assert robot.objects == {"box x", "box z", "box"} and not robot.floats
    assert pushed_object(robot) == "box"
    np.testing.assert_allclose(push_direction(robot, "box"), [1, 0, 0])
    goal = np.array(ca.evalf(robot.displaced(robot.home, 0.2))).ravel()
    np.testing.assert_allclose(goal - robot.home, [0.2, 0.2, 0, 0, 0], atol=1e-12)
    puck = loaded("fingertip.xml")
    assert pushed_object(puck) == "puck" and not puck.floats
    np.testing.assert_allclose(push_direction(puck, "puck"), [0, 1, 0])


@pytest.mark.parametrize(
    ("name", "task", "words"),
    [
        ("arm.xml", "walk", "walk is for a robot whose root moves freely"),
        ("arm.xml", "stand", "stand is for a robot whose root moves freely"),
        ("arm.xml", "push", "push needs an object"),
        ("hopper.xml", "reach", "reach is for a robot whose root is fixed"),
        ("hopper.xml", "push", "push needs an object"),
    ],
)
def test_a_task_without_sense_is_refused_in_a_sentence(name: str, task: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        check_task(loaded(name), task)


FLAT = """<mujoco><worldbody><geom type='plane' size='0 0 1'/><body name='puck' pos='0 0 .1'>
<joint type='slide' axis='1 0 0'/><joint type='slide' axis='0 0 1'/><geom size='.1'/>{more}</body></worldbody>
{end}</mujoco>"""
MOTOR = "<body><joint name='j' axis='0 1 0'/><geom size='.02' pos='0 0 .3'/></body>"


def test_robots_without_motors_feet_or_joints_to_bend_are_named(tmp_path: Path) -> None:
    file = tmp_path / "puck.xml"
    file.write_text(FLAT.format(more="", end=""))
    with pytest.raises(InputError, match="walk needs a motor"):
        check_task(robots.load(file), "walk")
    file.write_text(FLAT.format(more=MOTOR, end="<actuator><motor joint='j'/></actuator>"))
    with pytest.raises(InputError, match="cannot lower its trunk by 10 %"):
        check_task(robots.load(file), "stand")
    check_task(robots.load(file), "jump")
    text = FLAT.format(more=MOTOR, end="<actuator><motor joint='j'/></actuator>")
    file.write_text(text.replace("<geom type='plane' size='0 0 1'/>", ""))
    with pytest.raises(InputError, match="parts that may touch level ground"):
        check_task(robots.load(file), "jump")
