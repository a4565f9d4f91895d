"""Robots from URDF and MJCF files: compiled by MuJoCo, then taken over as links or bodies."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from dynamics.systems import Machine
from ocp.errors import InputError
from ocp.validation import expand_path
from problems.robots.geoms import touching
from problems.robots.leftovers import leftovers
from problems.robots.robot import PlanarRobot, Robot
from problems.robots.source import Source, listed, read_source
from problems.robots.spatial import home_of, spatial_robot
from problems.robots.tree import TILT, joint_name, tree

MOST_JOINTS = 100
_FREE, _BALL, _SLIDE, _HINGE = range(4)


def load(path: str | Path, *, space: bool = False, floating: bool = False) -> Robot:
    """Read a robot from a URDF or MJCF file, all of whose numbers are in SI units.

    Planar are hinges about ±y and slides in the plane of x and z. A root that slides along x and z
    and turns about y becomes one ``free`` joint there. Other robots, and with ``space`` all, are
    read in space, where q is MuJoCo's qpos and v its qvel. Bodies without joints become part of
    their parent. A URDF stands over the ground z = 0, and each of its joints with an ``effort`` has
    a motor whose unit is that; its root is fixed to the world unless it is ``floating``. Nothing
    outside the file's folder is opened.

    Raises :class:`~ocp.errors.InputError` where MuJoCo is not installed, the file is no robot, or
    has what :class:`~dynamics.systems.space.Body` cannot express.
    """
    file = expand_path(path)
    source = read_source(file, floating=floating)
    model = _compiled(source, file)
    data = import_module("mujoco").MjData(model)
    data.qpos[:] = model.qpos0
    import_module("mujoco").mj_kinematics(model, data)
    notes = ["The root is fixed; --floating makes it free."] if source.rooted else []
    try:
        if not space:
            try:
                _check_planar(model, data)
                return replace(_planar(model, data, source, file), notes=tuple(notes))
            except ValueError as error:
                notes.append(f"Read in space: {error}.")
        found = spatial_robot(model, source, file, _gravity(model))
        return replace(found, notes=tuple(notes))
    except ValueError as error:
        raise InputError(f"{file}: {error}") from error


def _compiled(source: Source, file: Path) -> Any:
    try:
        mujoco = import_module("mujoco")
    except ImportError:
        raise InputError(
            "reading robot files needs the package mujoco; install 'centralpath[robots]'"
        ) from None
    warn = mujoco.get_mju_user_warning()
    # Its own handler writes a file into the current folder.
    mujoco.set_mju_user_warning(lambda message: None)
    try:
        model = mujoco.MjModel.from_xml_string(source.text, source.assets)
    except (ValueError, mujoco.FatalError) as error:
        raise InputError(f"{file}: {_reason(str(error))}") from None
    finally:
        mujoco.set_mju_user_warning(warn)
    if model.njnt > MOST_JOINTS:
        raise InputError(
            f"{file}: {model.njnt} joints; at most {MOST_JOINTS} are read, as the equations of"
            " motion of more take minutes to build"
        )
    if model.njnt == 0:
        raise InputError(f"{file}: no joint, so nothing moves; expected a robot")
    for name in (
        "body_mass",
        "body_inertia",
        "body_ipos",
        "geom_size",
        "jnt_range",
        "dof_armature",
    ):
        if not np.isfinite(getattr(model, name)).all():
            raise InputError(f"{file}: {name.partition('_')[2]} overflows; give smaller numbers")
    return model


def _reason(message: str) -> str:
    """The compiler's first line as the rest of a sentence, with the element that it names."""
    lines = [line.strip() for line in message.splitlines() if line.strip()]
    text = lines[0].replace("XML ", "").replace("Error: ", "").replace("engine error: ", "")
    named = [line.split("'")[1] for line in lines if line.startswith("Element name '")]
    where = f" in {named[0]!r}" if named and named[0] else ""
    if text.startswith("mass and inertia of moving bodies"):
        return f"a body moves and has no mass or inertia{where}; give it <inertial>"
    return f"not a robot that compiles: {text}{where}"


def _check_planar(model: Any, data: Any) -> None:
    """Raise ``ValueError`` with the joints that move out of the plane."""
    found = []
    for j in range(model.njnt):
        kind, axis = model.jnt_type[j], data.xaxis[j]
        along = f"({', '.join(f'{value:.3g}' for value in axis + 0.0)})"
        if kind == _FREE:
            found.append((j, "is free in six directions"))
        elif kind == _BALL:
            found.append((j, "is a ball joint"))
        elif kind == _HINGE and np.hypot(axis[0], axis[2]) > TILT:
            found.append((j, f"turns about {along}"))
        elif kind == _SLIDE and abs(axis[1]) > TILT:
            found.append((j, f"slides along {along}"))
    if found:
        j, why = found[0]
        more = f" (and {len(found) - 1} more are not planar)" if len(found) > 1 else ""
        raise ValueError(f"joint {joint_name(model, j)!r} {why}{more}")


def _gravity(model: Any) -> np.ndarray:
    off = model.opt.disableflags & import_module("mujoco").mjtDisableBit.mjDSBL_GRAVITY
    return np.zeros(3) if off else np.array(model.opt.gravity)


def _planar(model: Any, data: Any, source: Source, file: Path) -> PlanarRobot:
    links, frames, coordinates = tree(model, data)
    ground = touching(model, data, frames, urdf=source.urdf)
    gx, across, gz = _gravity(model).tolist()
    machine = Machine(
        tuple(links), ground.spheres, parts=ground.parts, meetings=ground.meetings,
        gravity=(gx, gz) if gx else -gz,
    )  # fmt: skip
    machine, still = _without_still(machine)
    friction = {name: f for name, f in ground.friction.items() if name not in still}
    at = [model.jnt_qposadr[one.joint] for one in coordinates]
    signs, rests = (np.array([getattr(c, key) for c in coordinates]) for key in ("sign", "rest"))
    motors = [one.motor for one in coordinates if one.motor]
    ignored = [*source.ignored, *ground.ignored, *leftovers(model, ground.geoms)]
    if across:
        ignored.append("gravity along y: nothing moves there")
    if still:
        ignored.append(f"{listed('contact', still)}: no joint moves it")
    return PlanarRobot(
        file, machine, tuple(joint_name(model, one.joint) for one in coordinates), signs, rests,
        signs * (home_of(model)[at] - rests) + 0.0, friction, tuple(motor.name for motor in motors),
        np.array([motor.range for motor in motors]).reshape(-1, 2), tuple(ignored),
    )  # fmt: skip


def _without_still(machine: Machine) -> tuple[Machine, list[str]]:
    """The machine without contacts whose distance never changes, and their names."""
    chain = machine.chain()
    q = ca.SX.sym("q", chain.nq)
    contacts = machine.contacts(chain, q)
    still = [name for name, contact in contacts.items() if not ca.depends_on(contact.phi, q)]
    spheres = tuple(sphere for sphere in machine.spheres if sphere.name not in still)
    meetings = tuple(pair for pair in machine.meetings if " on ".join(pair) not in still)
    return replace(machine, spheres=spheres, meetings=meetings), still
