"""M, bias and a foot's Jacobian of published robots: differences from MuJoCo's, and lengths of graphs."""

from __future__ import annotations

import os
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import casadi as ca
import numpy as np

from problems.robots import load

STATES, WITHIN = 100, 1e-9


@dataclass(frozen=True)
class File:
    """A robot's file in a ``source``, which is a package or a folder below ``EXTRA_ROBOTS``."""

    source: str
    path: str
    floating: bool = False

    def find(self) -> Path | None:
        """Return the file's place on this computer, None if it is missing."""
        spec = find_spec(self.source)
        places = [*(spec.submodule_search_locations or ())] if spec else []
        places += os.environ.get("EXTRA_ROBOTS", "").split(os.pathsep)
        found = (hit for place in places if place for hit in Path(place).rglob(self.path))
        return next(found, None)


FILES = (
    *(File("gymnasium", f"mujoco/assets/{n}.xml") for n in ("ant", "humanoid", "pusher_v5")),
    *(File("dm_control", f"suite/{n}.xml") for n in ("quadruped", "humanoid", "fish")),
    File("example_robot_data", "solo_description/robots/solo12.urdf", True),
    File("example_robot_data", "a1_description/urdf/a1.urdf", True),
    File("example_robot_data", "ur_description/urdf/ur5_robot.urdf"),
)
SOLO = "solo_description/robots/solo12.urdf"


def graphs(tree: Any, body: str) -> tuple[ca.Function, ca.Function, ca.Function]:
    """Return functions for M(q), bias(q, v), and a body origin's Jacobian (6, nv) and position."""
    q, v = ca.SX.sym("q", tree.nq), ca.SX.sym("v", tree.nv)
    place, rows = tree.pose(q, body)[1], ca.SX(6, tree.nv)
    for index, turn, move, pivot in tree.joint_axes(q, body):
        rows[:, index] = ca.vertcat(move + ca.cross(turn, place - pivot), turn)
    made = ([q], [tree.mass(q)]), ([q, v], [tree.bias(q, v)]), ([q], [ca.densify(rows), place])
    mass, bias, foot = (ca.Function("f", *each, {"cse": True}) for each in made)
    return mass, bias, foot


def compiled(file: File, path: Path) -> Any:
    """Return MuJoCo's own model of a file; a URDF is read without shapes, and its root may float."""
    model = import_module("mujoco").MjModel
    if path.suffix == ".xml":
        return model.from_xml_path(str(path))
    root = ElementTree.parse(path).getroot()
    for link in root.findall("link"):
        for shape in (*link.findall("visual"), *link.findall("collision")):
            link.remove(shape)
    if file.floating:
        below = {child.get("link") for child in root.iterfind("joint/child")}
        names = (link.get("name") for link in root.findall("link"))
        top = next(name for name in names if name not in below)
        ElementTree.SubElement(root, "link", name="world")
        joint = ElementTree.SubElement(root, "joint", name="floats", type="floating")
        ElementTree.SubElement(joint, "parent", link="world")
        ElementTree.SubElement(joint, "child", link=str(top))
    return model.from_xml_string(ElementTree.tostring(root, encoding="unicode"))


def measured(file: File, path: Path) -> list[str | float | int]:
    """Return a row: largest differences, relative to the largest entry if above 1, and lengths."""
    mujoco = import_module("mujoco")
    robot = load(path, floating=file.floating)
    tree: Any = robot.machine.tree()
    model = compiled(file, path)
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    # The body is the end of the longest chain: a foot, if there are any.
    end = max(tree.bodies, key=lambda body: len(tree.joint_axes(ca.SX.sym("q", tree.nq), body)))
    number = model.joint(robot.joints[tree.q_of[end].start]).bodyid[0]
    mass, bias, foot = graphs(tree, end)
    worst = np.zeros(3)
    for _ in range(STATES):
        data.qpos[:] = model.qpos0
        mujoco.mj_integratePos(model, data.qpos, rng.standard_normal(model.nv), 1.0)
        data.qvel[:] = rng.standard_normal(model.nv)
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        columns = np.zeros((model.nv, model.nv))
        for k, unit in enumerate(np.eye(model.nv)):
            mujoco.mj_mulM(model, data, columns[k], unit)
        rows, place = (np.array(value) for value in foot(data.qpos))
        theirs = np.zeros((6, model.nv))
        mujoco.mj_jac(model, data, theirs[:3], theirs[3:], place.ravel(), number)
        pairs = (
            (np.array(mass(data.qpos)), columns),
            (rows, theirs),
            (np.array(bias(data.qpos, data.qvel)).ravel(), data.qfrc_bias),
        )
        off = [np.abs(a - b).max() / max(1.0, np.abs(b).max()) for a, b in pairs]
        worst = np.maximum(worst, off)
    shown = [f"{x:.1e}" if x <= WITHIN else f"**{x:.1e} missed**" for x in worst[[0, 2, 1]]]
    q = ca.SX.sym("q", tree.nq)
    alone = ca.Function("rows", [q], [foot(q)[0]], {"cse": True})
    lengths = (each.n_instructions() for each in (mass, bias, alone))
    return [f"{path.stem}, {file.source}", tree.nv, *shown, *lengths]
