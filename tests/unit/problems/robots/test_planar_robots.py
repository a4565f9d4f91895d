"""Robots that move in a plane have each contact once, one tangent, and a root that is free in that plane."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from dynamics.contact import Barrier
from dynamics.systems import ContactSystem, ParameterTable
from dynamics.systems.space import Body, Box, Capsule, Plane, SpatialMachine, SpatialPart
from dynamics.systems.space import machine as space_machine
from ocp.errors import InputError
from problems import robots
from problems.robots.robot import Robot

pytest.importorskip("mujoco")

H = 0.01
SOLID = '<inertia ixx="0.02" iyy="0.03" izz="0.01" ixy="0" ixz="0" iyz="0"/>'


def rig(joints: str, shape: Any, tilt: float = 0.0) -> SpatialMachine:
    """Return a machine of a body above the ground on ``joints``: slides x and z, and t, a hinge about y."""
    bodies, above = list[Body](), None
    for kind in joints:
        axis = {"x": (1.0, 0.0, 0.0), "z": (0.0, 0.0, 1.0), "t": (0.0, 1.0, 0.0)}[kind]
        heavy = kind == joints[-1]
        bodies.append(
            Body(
                kind,
                above,
                1.0 if heavy else 0.0,
                (0.1,) * 3 if heavy else (0.0,) * 3,
                joint="hinge" if kind == "t" else "slide",
                axis=axis,
            )
        )
        above = kind
    parts = (SpatialPart("foot", joints[-1], shape), SpatialPart("floor", "world", Plane()))
    return SpatialMachine(tuple(bodies), parts, (("foot", "floor"),))


TURNED = (np.cos(np.pi / 8), np.sin(np.pi / 8), 0.0, 0.0)
SHAPES = {
    "box": (Box((0.1, 0.2, 0.3)), 4),
    "box turned about x": (Box((0.1, 0.2, 0.3), (0, 0, 0), TURNED), 8),
    "cube turned about x": (Box((0.1, 0.2, 0.2), (0, 0, 0), TURNED), 6),
    "capsule along y": (Capsule((0.1, -1.0, 0), (0.1, 1.0, 0), 0.1), 1),
    "capsule along x": (Capsule((-1.0, 0.1, 0), (1.0, 0.1, 0), 0.1), 2),
}


@pytest.mark.one_case_in(3)
@pytest.mark.parametrize(("shape", "count"), SHAPES.values(), ids=SHAPES)
def test_points_beside_each_other_are_one_contact(shape: Any, count: int) -> None:
    machine = rig("xzt", shape)
    system = machine.system("s", ParameterTable(), h=H, friction=0.5)
    assert len(machine.contacts(ca.SX.sym("q", 3))) == count
    assert system.nlam == 4 * count  # normal, two ways to slide, what is left of the cone


def test_a_box_that_only_slides_has_its_lower_and_its_upper_face() -> None:
    machine = rig("xz", Box((0.1, 0.2, 0.3)))
    assert len(machine.contacts(ca.SX.sym("q", 2))) == 2


def test_a_box_that_is_free_has_all_of_its_corners() -> None:
    parts = (SpatialPart("foot", "b", Box((0.1, 0.2, 0.3))), SpatialPart("floor", "world", Plane()))
    machine = SpatialMachine((Body("b", None, 1.0, (0.1,) * 3, joint="free"),), parts, (("foot", "floor"),))
    assert len(machine.contacts(ca.SX.sym("q", 7))) == 8


def step_of(machine: SpatialMachine) -> tuple[ContactSystem, Any]:
    system = machine.system("s", ParameterTable(), h=H, friction=0.5)
    return system, Barrier(mu=1e-10).close(system)


@pytest.mark.costly
def test_a_box_falls_and_slides_as_with_each_contact_twice(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    shape = Box((0.1, 0.2, 0.1))
    (_, once), x = step_of(rig("xzt", shape)), np.array([0, 0.15, 0.3, 1.0, 0, 2.0])
    monkeypatch.setattr(space_machine, "distinct_points", lambda *_: list(range(8)))
    system, twice = step_of(rig("xzt", shape))
    assert system.nlam == 8 * 4
    y = x
    for _ in range(15):
        x, y = (np.array(step.solve(at, [], [])[0]).ravel() for step, at in ((once, x), (twice, y)))
        np.testing.assert_allclose(x, y, atol=1e-6)
    assert twice.solve(y, [], [])[1].full().max() > 0.01
    assert 0.1 - 1e-6 < x[1] < 0.1 * 2**0.5 + 1e-6  # on a face, or about a corner


def biped(folder: Path, axis: str, aside: str = "0 0.1 0", hip: str = "") -> Path:
    """Write a URDF of a torso with two legs, offset by ``aside`` [m], that turn about ``axis``; return its path."""

    def link(name: str, shape: str) -> str:
        inertial = f'<inertial><origin xyz="0.01 0 -0.1"/><mass value="2"/>{SOLID}</inertial>'
        return f'<link name="{name}">{inertial}{shape}</link>'

    def joint(parent: str, child: str, at: str, about: str) -> str:
        return (
            f'<joint name="to {child}" type="revolute"><parent link="{parent}"/>'
            f'<child link="{child}"/><origin xyz="{at}"/><axis xyz="{about}"/>'
            '<limit lower="-2" upper="2" effort="20"/></joint>'
        )

    foot = '<collision><origin xyz="0 0 -0.4"/><geometry><sphere radius="0.04"/></geometry></collision>'
    text = link("torso", '<collision><geometry><box size="0.2 0.2 0.3"/></geometry></collision>')
    other = " ".join(str(-float(number)) for number in aside.split())
    text += link("left", foot) + joint("torso", "left", aside, hip or axis)
    text += link("right", foot) + joint("torso", "right", other, axis)
    file = folder / "biped.urdf"
    file.write_text(f'<robot name="biped">{text}</robot>')
    return file


@pytest.mark.costly_cases("-1 0 0-0.1 0 0-forward1")
@pytest.mark.parametrize(
    ("axis", "aside", "forward"),
    [
        ("0 1 0", "0 0.1 0", (1, 0, 0)),
        ("-1 0 0", "0.1 0 0", (0, 1, 0)),
    ],
)
def test_a_urdf_stays_in_the_plane_of_its_joints(
    tmp_path: Path, axis: str, aside: str, forward: tuple[int, ...]
) -> None:
    """Contacts have one tangent, and the mass matrix is that of the floating robot in the plane."""
    file = biped(tmp_path, axis, aside)
    flat, free = robots.load(file, planar=True), robots.load(file, floating=True)
    way = "xyz"[int(np.abs(forward).argmax())]
    assert [body.name for body in flat.machine.bodies] == [
        f"torso {way}",
        "torso z",
        "torso",
        "left",
        "right",
    ]
    assert flat.floats and not flat.notes
    system = flat.machine.system("s", ParameterTable(), h=H, friction=flat.coefficients)
    assert len(flat.friction) == 6 and system.nlam == 4 + 6 * 4
    trees = [robot.machine.tree() for robot in (flat, free)]
    symbols = [ca.SX.sym("q", tree.nq) for tree in trees]
    masses = [ca.Function("M", [q], [tree.mass(q)]) for tree, q in zip(trees, symbols, strict=True)]
    rng = np.random.default_rng(0)
    along, down = np.abs(np.array(forward, dtype=float)), np.array([0.0, 0, 1])
    turn = np.abs(np.array([float(word) for word in axis.split()]))
    for _ in range(5):
        a, z, angle, left, right = rng.normal(size=5)
        quaternion = [np.cos(angle / 2), *(np.sin(angle / 2) * turn)]
        held = np.zeros((8, 5))
        held[:3, 0], held[:3, 1], held[3:6, 2] = along, down, turn
        held[6, 3] = held[7, 4] = 1.0
        wide = masses[1]([*(a * along + z * down), *quaternion, left, right]).full()
        narrow = masses[0]([a, z, angle, left, right]).full()
        np.testing.assert_allclose(narrow, held.T @ wide @ held, atol=1e-12)
    goal = np.array(ca.evalf(flat.displaced(flat.standing(), 0.3))).ravel()
    np.testing.assert_allclose(goal - flat.standing(), [0.3, 0, 0, 0, 0], atol=1e-12)


@pytest.mark.parametrize(
    ("axis", "hip", "aside"),
    [("0 0 1", "", "0 0.1 0"), ("0 1 0", "1 0 0", "0 0.1 0"), ("0 0.8 0.6", "", "0 0.1 0")],
)
def test_a_robot_that_leaves_the_plane_is_refused(tmp_path: Path, axis: str, hip: str, aside: str) -> None:
    file = biped(tmp_path, axis, aside, hip)
    with pytest.raises(InputError, match=r"joint 'to left' leaves the plane|'to right' leaves"):
        robots.load(file, planar=True)
    with pytest.raises(InputError, match="exclude each other; give one of them"):
        robots.load(file, planar=True, floating=True)


def test_a_robot_with_its_box_has_each_contact_once(tmp_path: Path) -> None:
    """An arm's tip touches the ground and a box that moves in the arm's plane, each with one tangent."""
    file = tmp_path / "arm.xml"
    kinds = (("x", "slide", "1 0 0"), ("z", "slide", "0 0 1"), ("t", "hinge", "0 1 0"))
    slides = "".join(f'<joint name="{n}" type="{kind}" axis="{axis}"/>' for n, kind, axis in kinds)
    file.write_text(
        f"""<mujoco><worldbody><geom name="floor" type="plane" size="0 0 1"/>
        <body name="arm" pos="0 0 0.3"><joint name="j" axis="0 1 0"/>
          <geom name="tip" pos="0.4 0 0" size="0.05"/></body>
        <body name="box" pos="0.6 0 0.06">{slides}
          <geom name="box" type="box" size="0.06 0.06 0.06"/></body>
        </worldbody></mujoco>"""
    )
    robot: Robot = robots.load(file)
    assert list(robot.friction) == [
        "tip on floor",
        *(f"box on floor {k}" for k in range(1, 5)),
        "tip on box",
    ]
    system = robot.machine.system("s", ParameterTable(), h=H, friction=robot.coefficients)
    assert system.nlam == 6 * 4
