"""Masses, forces and frames of random trees in MJCF agree with MuJoCo's."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from problems import robots
from tests.examples import settings
from tests.unit.problems.robots.test_robots import check_dynamics

mujoco: Any = import_module("mujoco")
near = st.floats(-1, 1).map(lambda value: round(value, 6))
size = st.floats(0.05, 2).map(lambda value: round(value, 6))


@st.composite
def body(draw: Any, index: int, root: bool) -> str:
    """Draw a body's elements: up to three joints, a mass away from them, and a body fixed to it."""

    def vector(kind: Any = near) -> str:
        return f"{draw(kind)} {draw(kind)} {draw(kind)}"

    a, b, c = draw(size), draw(size), draw(size)
    single = f'ref="{draw(near)}" stiffness="{draw(size)}" springref="{draw(near)}"'
    kinds = ["hinge", "slide", "hinge slide", "slide hinge hinge", "ball", "slide ball"]
    joints = []
    for k, kind in enumerate(draw(st.sampled_from(["free", *kinds] if root else kinds)).split()):
        own = f'axis="{vector(size)}" armature="{draw(size)}" {single}'
        own = own if kind in ("hinge", "slide") else ""
        place = "" if kind == "free" else f'pos="{vector()}"'
        name = f'name="j{index}{k}" type="{kind}"'
        joints.append(f'<joint {name} {place} damping="{draw(size)}" {own}/>')
    return (
        f'{"".join(joints)}<inertial pos="{vector()}" mass="{draw(size)}" euler="{vector()}"'
        f' diaginertia="{b + c} {a + c} {a + b}"/>'
        f'<body pos="{vector()}" euler="{vector()}"><geom type="box" mass="{draw(size)}"'
        f' size="{a} {b} {c}" contype="0" conaffinity="0" euler="{vector()}"/></body>'
    )


@st.composite
def trees(draw: Any) -> str:
    """Draw a tree of 2 to 4 bodies in MJCF, each rotated in its parent."""
    count = draw(st.integers(2, 4))
    above = [draw(st.integers(-1, i - 1)) for i in range(count)]
    own = [draw(body(i, above[i] == -1)) for i in range(count)]
    turns = [f'pos="{draw(near)} {draw(near)} {draw(near)}" euler="{draw(near)} {draw(near)} 0.3"' for _ in own]

    def written(i: int) -> str:
        below = "".join(written(k) for k in range(count) if above[k] == i)
        return f'<body name="b{i}" {turns[i]}>{own[i]}{below}</body>'

    roots = "".join(written(k) for k in range(count) if above[k] == -1)
    return (
        f'<mujoco><compiler angle="radian"/><option gravity="{draw(near)} {draw(near)} -9.81"/>'
        f"<worldbody>{roots}</worldbody></mujoco>"
    )


@settings(100, deadline=None)
@given(trees())
def test_masses_forces_and_frames_are_mujocos(text: str) -> None:
    with TemporaryDirectory() as folder:
        file = Path(folder) / "tree.xml"
        file.write_text(text)
        robot = robots.load(file)
    check_dynamics(robot, mujoco.MjModel.from_xml_string(text), 3)
