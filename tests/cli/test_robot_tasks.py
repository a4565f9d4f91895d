"""``ocp new --robot --task``: files of robots whose plans stand up, reach, walk, jump and push."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

pytest.importorskip("mujoco")

from ocp import Solution, solve
from problems import load
from problems.drawing import ContactFrame, Shape
from problems.loading import import_file
from reports.cli.new_command import TASKS

ROOT = Path(__file__).parents[2]
DATA = ROOT / "tests/data"
LEGS = {"hopper": ROOT / "examples/hopper.xml", "biped": DATA / "biped.xml", "dog": DATA / "dog.xml"}
ARMS = {"arm": DATA / "arm.xml", "finger": DATA / "finger.urdf", "pusher": ROOT / "examples/arm.xml"}
PUSHERS = {"arm": ROOT / "examples/arm.xml", "gantry": DATA / "gantry.xml", "fingertip": DATA / "fingertip.xml"}
ROBOTS = {"stand": LEGS, "walk": LEGS, "jump": LEGS, "reach": ARMS, "push": PUSHERS}
CASES = [(task, robot) for task, files in ROBOTS.items() for robot in files]


def written(ocp: Any, task: str, robot: str) -> Path:
    done = ocp("new", "go", "--robot", str(ROBOTS[task][robot]), "--task", task, "--json")
    assert done.code == 0, done.err
    assert done.json["template"] == "robot" and done.json["task"] == task
    return Path("go.py")


@pytest.mark.cheap_cases("reach")
@pytest.mark.parametrize("task", TASKS)
def test_a_written_file_loads_under_its_name_and_is_drawn(ocp, task: str) -> None:
    robot = next(iter(ROBOTS[task]))
    spec = load(written(ocp, task, robot))
    problem = spec.problem({"N": 3})
    assert problem.name == spec.name == "go" and spec.title
    x0 = problem.initial_states(problem.parameters.values)[0]
    assert spec.draw is not None and spec.frames is not None
    shapes, frames = spec.draw(spec.params({}), x0), spec.frames(spec.params({}), x0)
    assert shapes and all(isinstance(shape, Shape) for shape in shapes)
    assert frames and all(isinstance(frame, ContactFrame) for frame in frames)
    assert ROBOTS[task][robot].name in Path("go.py").read_text()


@pytest.mark.costly
def test_the_friction_pyramid_has_as_many_edges_as_asked_for(ocp) -> None:
    assert ocp("new", "go", "--robot", str(DATA / "crane.xml"), "--task", "reach").code == 0
    spec = load("go.py")
    systems = [spec.problem({"N": 2, "edges": edges}).system for edges in ("4", "8")]
    counts = [sum(pair.kind == "friction" for pair in system.pairs) for system in systems]
    assert counts[1] == 2 * counts[0] > 0
    assert [system.forces and system.forces.edges for system in systems] == [4, 8]


@pytest.mark.costly
@pytest.mark.parametrize(("task", "robot"), CASES)
def test_the_plan_of_a_written_file_does_its_task(ocp, task: str, robot: str) -> None:
    file = written(ocp, task, robot)
    solution = solve(load(file).problem(), contact="exact", effort="quick")
    assert solution.success and solution.certificate.stationarity == "B"
    CHECKS[task](import_file(file.resolve()), solution, solution.data["x"].values[0])


def gaps(module: Any, q: np.ndarray) -> np.ndarray:
    """Return the distances of the robot's own contacts with the ground."""
    return np.array(module.robot.distances(q)).ravel()[list(module.robot.footholds)]


def stands_up(module: Any, solution: Solution, x: np.ndarray) -> None:
    nq = len(module.stands)
    np.testing.assert_allclose(x[0, :nq], module.start, atol=1e-9)
    np.testing.assert_allclose(x[-1, :nq], module.stands, atol=0.02)
    assert np.abs(module.start - module.stands).max() > 0.05
    assert np.abs(x[-1, nq:]).max() < 0.1
    assert gaps(module, x[-1, :nq]).max() < 0.01


def walks(module: Any, solution: Solution, x: np.ndarray) -> None:
    """A stride that repeats goes on for ever: the states at its ends differ by the way alone."""
    index, sign = module.robot.forward
    change = x[-1] - x[0]
    assert sign * change[index] == pytest.approx(0.3 * 0.025 * 24, abs=1e-6)
    np.testing.assert_allclose(np.delete(change, index), 0, atol=1e-6)
    contacts = [contact for contact in solution.audit.contacts if contact.steps]
    assert contacts and sum(contact.slid for contact in contacts) < 0.05
    feet = np.array([gaps(module, row[: len(module.stands)]) for row in x])
    assert feet.max() > 0.005, "feet are lifted"


def jumps(module: Any, solution: Solution, x: np.ndarray) -> None:
    nq = len(module.stands)
    np.testing.assert_allclose(x[0, :nq], module.stands, atol=1e-9)
    assert gaps(module, x[-1, :nq]).min() > 0.9 * 0.05
    assert np.abs(gaps(module, x[0, :nq])).min() < 1e-9
    np.testing.assert_allclose(x[-1, 2:nq], module.stands[2:], atol=0.2)


def reaches(module: Any, solution: Solution, x: np.ndarray) -> None:
    robot, goal = module.robot, [module.x, module.y, module.z]
    ends = [module.tip.at(robot.machine, row[: len(robot.home)]) for row in (x[0], x[-1])]
    assert np.linalg.norm(ends[0] - goal) > 0.05
    np.testing.assert_allclose(ends[1], goal, atol=0.01)
    assert np.abs(x[-1, len(robot.home) :]).max() < 0.1


def pushes(module: Any, solution: Solution, x: np.ndarray) -> None:
    """The object has no motor, so that what moves it is contact with the robot."""
    robot = module.robot
    first, last = (module.box.at(robot.machine, row[: len(robot.home)]) for row in (x[0], x[-1]))
    np.testing.assert_allclose((last - first) @ module.direction, 0.1, atol=0.01)
    bodies = [owners for _, *owners in robot.machine.contacts_with_bodies(ca.SX(robot.home)).values()]
    hands = [i for i, owners in enumerate(bodies) if "world" not in owners]
    assert max(solution.audit.contacts[i].peak_force for i in hands) > 0.01


CHECKS = {"stand": stands_up, "walk": walks, "jump": jumps, "reach": reaches, "push": pushes}


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--robot", "arm.xml", "--task", "walk"], "arm.xml: walk is for a robot whose root moves freely"),
        (["--robot", "arm.xml", "--task", "push"], "arm.xml: push needs an object"),
        (["--robot", "arm.xml", "--task", "wlak"], "unknown task 'wlak' (did you mean 'walk'?); expected stand, reach"),
        (["--task", "walk"], "--task is for a robot; give its file with --robot"),
    ],
)
def test_a_task_that_makes_no_sense_is_refused(ocp, words: list[str], sentence: str) -> None:
    Path("arm.xml").write_text((DATA / "arm.xml").read_text())
    done = ocp("new", "go", *words)
    assert done.code == 2 and sentence in done.err and done.err.count("\n") == 1
    assert not Path("go.py").exists()
