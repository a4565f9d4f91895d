"""Trees drawn at random, written as MJCF: masses and forces are MuJoCo's, in space frames too."""

from __future__ import annotations

import math
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import casadi as ca
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from problems import robots
from tests.examples import settings
from tests.unit.problems.test_spatial_robots import check_dynamics

mujoco: Any = import_module("mujoco")
near = st.floats(-1, 1).map(lambda value: round(value, 6))
size = st.floats(0.05, 2).map(lambda value: round(value, 6))


@st.composite
def body(draw: Any, index: int) -> str:
    """A body's own elements: a joint, a mass away from it, and one fixed to it."""

    def vector(kind: Any = near) -> str:
        return f"{draw(kind)} {draw(near)} {draw(kind)}"

    a, b, c = draw(size), draw(size), draw(size)
    x, y = f'axis="0 {draw(st.sampled_from([1, -1]))} 0"', draw(near)
    slide = f'type="slide" axis="{math.cos(y)} 0 {math.sin(y)}"'
    kind = draw(st.sampled_from([x, x, slide]))
    moments = f"{b + c} {a + c} {a + b}"
    return (
        f'<joint name="j{index}" {kind} pos="{vector()}" ref="{draw(near)}" damping="{draw(size)}"'
        f' stiffness="{draw(size)}" springref="{draw(near)}" armature="{draw(size)}"/>'
        f'<inertial pos="{vector()}" mass="{draw(size)}" diaginertia="{moments}"'
        f' euler="{vector()}"/>'
        f'<body pos="{vector()}" euler="0 {draw(near)} 0"><geom type="box" mass="{draw(size)}"'
        f' size="{a} {b} {c}" contype="0" conaffinity="0" euler="{vector()}"/></body>'
    )


@st.composite
def trees(draw: Any) -> str:
    """A tree of 3 to 6 bodies in the file's form."""
    count = draw(st.integers(3, 6))
    above = [draw(st.integers(-1, i - 1)) for i in range(count)]
    own = [draw(body(i)) for i in range(count)]
    turns = [f'pos="{draw(near)} {draw(near)} {draw(near)}" euler="0 {draw(near)} 0"' for _ in own]

    def written(i: int) -> str:
        below = "".join(written(k) for k in range(count) if above[k] == i)
        return f'<body name="b{i}" {turns[i]}>{own[i]}{below}</body>'

    roots = "".join(written(k) for k in range(count) if above[k] == -1)
    return (
        f'<mujoco><compiler angle="radian"/><option gravity="{draw(near)} 0 -9.81"/>'
        f"<worldbody>{roots}</worldbody></mujoco>"
    )


@settings(100, deadline=None)
@given(trees(), st.integers(0, 2**32 - 1))
def test_masses_and_forces_are_mujocos(text: str, seed: int) -> None:
    with TemporaryDirectory() as folder:
        file = Path(folder) / "tree.xml"
        file.write_text(text)
        robot = robots.load(file)
    model = mujoco.MjModel.from_xml_string(text)
    data, rng, chain = mujoco.MjData(model), np.random.default_rng(seed), robot.machine.chain()
    data.qpos[:], data.qvel[:] = rng.uniform(-2, 2, (2, model.nq))
    mujoco.mj_forward(model, data)
    at = [int(model.joint(name).qposadr[0]) for name in robot.joints]
    q, v = robot.signs * (data.qpos[at] - robot.rests), robot.signs * data.qvel[at]
    M, column = np.zeros((model.nv, model.nv)), np.zeros(model.nv)
    for i, unit in enumerate(np.eye(model.nv)):
        mujoco.mj_mulM(model, data, column, unit)
        M[:, i] = column
    M = M[np.ix_(at, at)] * np.outer(robot.signs, robot.signs)
    here, speed = ca.SX(q), ca.SX(v)
    passive = chain.spring(here) + chain.damping(speed)
    pairs = (
        (chain.mass(here), M),
        (chain.bias(here, speed), robot.signs * data.qfrc_bias[at]),
        (passive, robot.signs * (data.qfrc_spring + data.qfrc_damper)[at]),
    )
    for ours, theirs in pairs:
        found = np.array(ca.evalf(ours)).reshape(theirs.shape)
        assert np.abs(found - theirs).max() <= 1e-9 * max(1.0, np.abs(theirs).max())


@st.composite
def spatial_body(draw: Any, index: int, root: bool) -> str:
    """A body's own elements: up to three joints, a mass away from them, and one fixed to it."""

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
def spatial_trees(draw: Any) -> str:
    """A tree of 2 to 4 bodies in the file's form, each turned in its parent."""
    count = draw(st.integers(2, 4))
    above = [draw(st.integers(-1, i - 1)) for i in range(count)]
    own = [draw(spatial_body(i, above[i] == -1)) for i in range(count)]
    turns = [
        f'pos="{draw(near)} {draw(near)} {draw(near)}" euler="{draw(near)} {draw(near)} 0.3"'
        for _ in own
    ]

    def written(i: int) -> str:
        below = "".join(written(k) for k in range(count) if above[k] == i)
        return f'<body name="b{i}" {turns[i]}>{own[i]}{below}</body>'

    roots = "".join(written(k) for k in range(count) if above[k] == -1)
    return (
        f'<mujoco><compiler angle="radian"/><option gravity="{draw(near)} {draw(near)} -9.81"/>'
        f"<worldbody>{roots}</worldbody></mujoco>"
    )


@settings(100, deadline=None)
@given(spatial_trees())
def test_masses_forces_and_frames_in_space_are_mujocos(text: str) -> None:
    with TemporaryDirectory() as folder:
        file = Path(folder) / "tree.xml"
        file.write_text(text)
        robot = robots.load(file, space=True)
    check_dynamics(robot, mujoco.MjModel.from_xml_string(text), 3)
