"""Reading of robots from URDF and MJCF files, which MuJoCo compiles, and conversion to bodies in space."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable
from importlib import import_module
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import fromstring

import casadi as ca
import numpy as np

from dynamics.systems.space import Coupling, SpatialMachine
from dynamics.systems.space.body import POSITIONS
from ocp.errors import InputError
from ocp.validation import expand_path
from problems.machines.perspective import PinholeCamera
from problems.robots.bodies import JOINTS, actuators_of, bodies
from problems.robots.couplings import equations
from problems.robots.elements import listed
from problems.robots.geoms import MOST_CORNERS, collision_model
from problems.robots.inertias import check_inertias
from problems.robots.robot import Robot
from problems.robots.source import Source, read_source
from problems.robots.unsupported import unsupported_features

_SLIDE = 2
"""MuJoCo's number for a slide joint; a hinge has the next number."""
FINITE_FIELDS = ("body_mass", "body_inertia", "body_ipos", "geom_size", "dof_armature")
"""Arrays of a compiled model that must be finite."""
_TILT = 1e-5
"""Tolerance on entries of joint axes in the decision whether a robot moves in one plane [1]."""


def load(path: str | Path, *, floating: bool = False, planar: bool = False, folder: str | Path | None = None) -> Robot:
    """Read a robot from a URDF or MJCF file, all of whose numbers are in SI units.

    Bodies without joints become part of their parent. A robot from a URDF gets the ground z = 0, and a
    motor at each joint with an ``effort``, which is the torque or force of one unit of input. Its root
    is fixed to the world, unless the robot is ``floating``, or ``planar``: free in the vertical plane in
    which its joints move. No file outside ``folder``, by default the folder of the file, is opened.

    Raises :class:`~ocp.errors.InputError` if MuJoCo is not installed, or if the file is not a robot or
    has parts that :class:`~dynamics.systems.space.Body` cannot express.
    """
    file = expand_path(path)
    try:
        mujoco = import_module("mujoco")
    except ImportError:
        raise InputError("reading robot files needs the package mujoco; install 'centralpath[robots]'") from None
    source = read_source(file, None if folder is None else expand_path(folder))
    warn = mujoco.get_mju_user_warning()
    # MuJoCo's own handler writes a file to the current folder.
    mujoco.set_mju_user_warning(lambda message: None)
    try:
        with warnings.catch_warnings(action="ignore"):
            spec = mujoco.MjSpec.from_string(source.text, assets=source.assets)
            roots = spec.worldbody.bodies
            rooted = source.urdf and len(roots) == 1 and not roots[0].joints
            if floating and planar:
                raise InputError("floating and planar exclude each other; give one of them")
            if (floating or planar) and not rooted:
                raise InputError(
                    f"{file}: no root to free: in MJCF <freejoint/> makes a body float, and a URDF must have a single"
                    " link that is fixed to the world"
                )
            has_no_joint = rooted and not spec.joints and not (floating or planar)
            if floating or has_no_joint:
                roots[0].add_freejoint(name=f"{roots[0].name} floats")
            estimated = _complete(spec, source)
            model = spec.compile()
            if planar:
                _free_in_plane(roots[0], _plane_axis(model, file))
                model = spec.compile()
    except InputError:
        raise
    except (ValueError, mujoco.FatalError) as error:
        raise InputError(f"{file}: {_reason(str(error))}") from None
    finally:
        mujoco.set_mju_user_warning(warn)
    try:
        _check(model)
        check_inertias(model, spec, fromstring(source.text) if source.urdf else None)
        fixed = "The root is fixed; --floating makes it free."
        notes = ["Without a joint its root is free."] if has_no_joint else [fixed]
        notes = notes if rooted and not (floating or planar) else []
        if estimated:
            moving = listed("link", estimated)
            notes.append(f"{moving} moves without <inertial>: its mass is that of its shapes, at 1000 kg/m³.")
        return _robot(file, model, source, notes)
    except ValueError as error:
        raise InputError(f"{file}: {error}") from error


def _complete(spec: Any, source: Source) -> list[str]:
    """Add ground and friction to a URDF, and names to all elements; limit the corners of meshes' hulls.

    Return the names of the links of a URDF that have a joint and no <inertial>: their mass is computed
    from their shapes. Links without joint and <inertial> have no mass.
    """
    spec.compiler.fusestatic = False
    estimated = [body for body in spec.bodies[1:] if source.urdf and not body.explicitinertial]
    for body in estimated:
        for geom in body.geoms if not body.joints else ():
            geom.density = 0.0
    if source.urdf:
        plane = import_module("mujoco").mjtGeom.mjGEOM_PLANE
        spec.worldbody.add_geom(name="ground", type=plane, size=[0, 0, 1])
    # MuJoCo uses the friction of the geom of higher priority: a stated coefficient, and the smaller of two.
    ranked = sorted(source.friction.items(), key=lambda item: -item[1])
    for priority, (link, friction) in enumerate(ranked, 1):
        body = spec.body(link)
        for geom in body.geoms if body else ():
            geom.friction[0], geom.priority = friction, priority
    for mesh in spec.meshes:
        # A hull that determines the mass must keep all corners.
        if mesh.inertia != import_module("mujoco").mjtMeshInertia.mjMESH_INERTIA_CONVEX:
            mesh.maxhullvert = MOST_CORNERS
    for kind in ("body", "joint", "actuator", "tendon", "equality", "key", "sensor"):
        elements = getattr(spec, {"body": "bodies", "equality": "equalities"}.get(kind, f"{kind}s"))
        _name((element, f"{kind} {k}") for k, element in enumerate(elements, kind != "body"))
    _name((geom, f"{body.name} geom {k}") for body in spec.bodies for k, geom in enumerate(body.geoms, 1))
    return [body.name for body in estimated if body.joints]


def _plane_axis(model: Any, file: Path) -> np.ndarray:
    """Return the horizontal unit vector (3,) about which all hinges turn; y for a robot without hinges.

    Raises :class:`~ocp.errors.InputError` if a joint moves the robot out of the plane normal to
    this vector.
    """
    mujoco = import_module("mujoco")
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    hinges = np.flatnonzero(model.jnt_type == _SLIDE + 1)
    axis = np.array(data.xaxis[hinges[0]] if len(hinges) else (0.0, 1.0, 0.0))
    axis *= np.sign(axis[np.abs(axis).argmax()])
    for j, kind in enumerate(model.jnt_type):
        hinge, joint_axis = kind > _SLIDE, data.xaxis[j]
        deviation = np.abs(np.cross(joint_axis, axis)).max() if hinge else abs(joint_axis @ axis)
        if kind < _SLIDE or deviation > _TILT or (hinge and abs(joint_axis[2]) > _TILT):
            raise InputError(
                f"{file}: joint {model.joint(j).name!r} leaves the plane; planar robots have"
                " hinges about one horizontal axis and slides across it"
            )
    return axis


def _free_in_plane(root: Any, axis: np.ndarray) -> None:
    """Add two slides and a hinge about a horizontal ``axis`` (3,) to the root of a robot."""
    kinds = import_module("mujoco").mjtJoint
    forward = np.cross(axis, (0.0, 0.0, 1.0))
    forward *= np.sign(forward[np.abs(forward).argmax()])
    for name, direction in (("xyz"[int(np.abs(forward).argmax())], forward), ("z", (0.0, 0.0, 1.0))):
        root.add_joint(name=f"{root.name} {name}", type=kinds.mjJNT_SLIDE, axis=direction)
    root.add_joint(name=f"{root.name} turns", type=kinds.mjJNT_HINGE, axis=axis)


def _name(elements: Iterable[tuple[Any, str]]) -> None:
    """Name each unnamed element with the name paired with it, followed by ``'`` until the name is unique."""
    listed = list(elements)
    names = {element.name for element, _ in listed}
    for element, name in listed:
        if not element.name:
            while name in names:
                name += "'"
            names.add(name)
            element.name = name


def _check(model: Any) -> None:
    """Raise ``ValueError`` for a model without joints, or with numbers that are not finite."""
    if model.njnt == 0:
        raise ValueError("no joint; expected a robot")
    for name in FINITE_FIELDS:
        if not np.isfinite(getattr(model, name)).all():
            raise ValueError(f"{name.partition('_')[2]} overflows; give smaller numbers")


def _reason(message: str) -> str:
    """Return the reason in the first line of the compiler's message, with the element in the message."""
    lines = [line.strip() for line in message.splitlines() if line.strip()]
    text = lines[0].replace("XML ", "").replace("Error: ", "").replace("engine error: ", "")
    named = [line.split("'")[1] for line in lines if line.startswith("Element name '")]
    element = f" in {named[0]!r}" if named and named[0] else ""
    return f"not a robot that compiles: {text}{element}"


def _robot(file: Path, model: Any, source: Source, notes: list[str]) -> Robot:
    coupled = equations(model, source.mimics)
    followers = {next(iter(coefficients)) for coefficients, _ in coupled}
    actuators, no_gravity = actuators_of(model, followers), import_module("mujoco").mjtDisableBit.mjDSBL_GRAVITY
    tree, poses = bodies(model, actuators)
    gx, gy, gz = [0.0] * 3 if model.opt.disableflags & no_gravity else model.opt.gravity.tolist()
    couplings = tuple(
        Coupling({tree[j].name: factor for j, factor in coefficients.items()}, value) for coefficients, value in coupled
    )
    machine = SpatialMachine(tree, gravity=(gx, gy, gz), couplings=couplings)
    ties = machine.coupled_joints()
    notes += map(_equation, couplings)
    collisions = collision_model(model, machine, poses)
    damped = [actuator.name for actuator in actuators.values() if actuator.damping]
    if damped:
        notes.append(f"The kv of {listed('actuator', damped)} is part of the damping.")
    notes += [
        f"The input of actuator {actuator.damper} is 0: its kv is part of the damping."
        for actuator in actuators.values()
        if actuator.damper
    ]
    keys = {model.key(k).name: k for k in range(model.nkey)}
    home = np.array(model.key_qpos[keys["home"]] if "home" in keys else model.qpos0)
    past = []
    for j in np.flatnonzero(model.jnt_limited * (model.jnt_type >= _SLIDE)).tolist():
        index, (low, high) = int(model.jnt_qposadr[j]), model.jnt_range[j]
        if not low <= home[index] <= high:
            home[index] = np.clip(home[index], low, high)
            past.append(model.joint(j).name or f"joint {j + 1}")
    if past:
        notes.append(f"The pose home exceeds the limits of {listed('joint', past)} and is clipped to them.")
    if ties:
        home = np.array(ca.evalf(ties.close(machine.tree(), ca.SX(home)))).ravel()
    joints = [model.joint(j).name for j, kind in enumerate(model.jnt_type) for _ in range(POSITIONS[JOINTS[kind]])]
    return Robot(
        file,
        collisions.machine,
        collisions.distances,
        tuple(joints),
        tuple(actuators.values()),
        home,
        collisions.friction,
        tuple(collisions.grounds),
        _camera(model, home),
        (*source.ignored, *collisions.ignored, *unsupported_features(model, collisions.geoms)),
        tuple(notes),
    )


def _equation(coupling: Coupling) -> str:
    """Return a sentence that states the equation of a coupling."""
    (first, unit), *other_terms = coupling.coefficients.items()
    terms = [f"{-factor / unit:g} {name}" for name, factor in other_terms]
    return f"Joint {first} follows: {first} = {' + '.join([*terms, f'{coupling.value / unit:g}'])}."


def _camera(model: Any, home: np.ndarray) -> PinholeCamera:
    """Return a camera that shows all moving geoms at home; it is at the side if they move in the plane of x and z."""
    data = import_module("mujoco").MjData(model)
    data.qpos[:] = home
    import_module("mujoco").mj_kinematics(model, data)
    moves = model.body_weldid[model.geom_bodyid] > 0
    positions, radii = data.geom_xpos[moves], model.geom_rbound[moves, None]
    positions = np.vstack([data.xpos[1:], positions - radii, positions + radii])
    x, y, z = (positions.min(axis=0) + positions.max(axis=0)).tolist()
    size = max(0.1, float(np.ptp(positions, axis=0).max()))
    along_y, kinds = abs(data.xaxis[:, 1]), model.jnt_type
    is_planar = np.where(kinds == 3, 1 - along_y, np.where(kinds == 2, along_y, 1.0)).max() < _TILT
    view = {"azimuth": -math.pi / 2, "elevation": 0.0} if is_planar else {}
    return PinholeCamera.around((x / 2, y / 2, z / 2), size, **view)
