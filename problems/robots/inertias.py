"""Check of the masses and inertias of a compiled file, body by body, against the numbers in the file."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from math import pi
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
from scipy.spatial.transform import Rotation

INERTIA_TOLERANCE = 1e-6
"""Maximum relative difference [1] of an inertia, to allow for its decomposition by the compiler."""
_ADJUSTMENTS = ("boundmass", "boundinertia", "balanceinertia", "settotalmass")
"""Settings of a file for which MuJoCo changes masses and inertias if they are positive."""

Moments = tuple[float, np.ndarray, np.ndarray]
"""Mass [kg], centre (3,) [m] and inertia about it (3, 3) [kg m²] in the axes of the body."""


def check_inertias(model: Any, spec: Any, urdf: Element | None) -> None:
    """Raise ``ValueError`` if mass, centre or inertia of a body in ``model`` differ from those in the file.

    The expected numbers are those of ``<inertial>``, from the URDF or from ``spec`` before compilation,
    with ``R I R'`` for a frame turned by R. For a body without ``<inertial>`` they are computed from its
    solid geoms in closed form.
    Bodies with meshes or shells and no ``<inertial>``, bodies whose frame MuJoCo aligns, and files
    that let MuJoCo adjust inertias are not checked.
    """
    if any(getattr(spec.compiler, name, 0) > 0 for name in _ADJUSTMENTS):
        return
    links = {} if urdf is None else {link.get("name", ""): link for link in urdf.iter("link")}
    for body in spec.bodies[1:]:
        if any(spec.compiler.alignfree or joint.align == 1 for joint in body.joints):
            continue
        inertial = links[body.name].find("inertial") if body.name in links else None
        if inertial is not None:
            expected = _of_urdf(inertial)
        elif body.explicitinertial:
            expected = _of_mjcf(body, spec)
        else:
            expected = _of_geoms(model, body, spec.compiler.inertiagrouprange)
        b = model.body(body.name).id
        R = Rotation.from_quat(model.body_iquat[b], scalar_first=True).as_matrix()
        compiled = model.body_mass[b], model.body_ipos[b], R @ np.diag(model.body_inertia[b]) @ R.T
        if expected is not None:
            _compare(body.name, expected, compiled)


def _compare(name: str, expected: Moments, compiled: Moments) -> None:
    """Raise ``ValueError`` if mass, centre or inertia of a body differ by more than rounding errors."""
    # The centre of a body without mass is arbitrary.
    length = np.sqrt(np.trace(expected[2]) / expected[0]) if expected[0] else np.inf
    sizes = expected[0], max(length, float(np.abs(expected[1]).max())), np.trace(expected[2])
    for quantity, a, b, size in zip(("mass", "centre", "inertia"), expected, compiled, sizes, strict=True):
        if (difference := np.abs(np.subtract(a, b)).max()) > INERTIA_TOLERANCE * size:
            raise ValueError(
                f"body {name!r}: MuJoCo {import_module('mujoco').__version__} reads another {quantity}"
                f" than the file, by {difference:.3g}; install a version that centralpath[robots]"
                " allows"
            )


def _of_urdf(inertial: Element) -> Moments:
    def numbers(tag: str, names: str, default: str = "0") -> list[float]:
        element = inertial.find(tag)
        attributes = {} if element is None else element.attrib
        return [float(number) for name in names.split() for number in attributes.get(name, default).split()]

    rotation = Rotation.from_euler("xyz", numbers("origin", "rpy", "0 0 0"))
    six = numbers("inertia", "ixx iyy izz ixy ixz iyz")
    (mass,), centre = numbers("mass", "value"), np.array(numbers("origin", "xyz", "0 0 0"))
    return mass, centre, _rotated(rotation, six)


def _of_mjcf(body: Any, spec: Any) -> Moments:
    quaternion, full = body.iquat, np.array(body.fullinertia)
    if not body.ialt.type.name.endswith("QUAT"):
        quaternion = spec.resolve_orientation(
            degree=spec.compiler.degree, sequence=spec.compiler.eulerseq, orientation=body.ialt
        )
    six = [*body.inertia, 0, 0, 0] if np.isnan(full[0]) else full
    inertia = _rotated(Rotation.from_quat(quaternion, scalar_first=True), six)
    return body.mass, np.array(body.ipos), inertia


def _of_geoms(model: Any, body: Any, groups: Any) -> Moments | None:
    """Return mass, centre and inertia of all geoms of a body together; None if one is a mesh or a shell."""
    solids = list[Moments]()
    for geom in body.geoms:
        if not groups[0] <= geom.group <= groups[1] or geom.mass == 0 or geom.density == 0:
            continue
        try:
            compiled = model.geom(geom.name)
        except KeyError:
            return None
        solid = _solid(geom.type.name[7:].lower(), *compiled.size)
        if solid is None or geom.typeinertia.name.endswith("SHELL"):
            return None
        volume, diagonal = solid
        mass = geom.density * volume if np.isnan(geom.mass) else geom.mass
        rotation = Rotation.from_quat(compiled.quat, scalar_first=True)
        solids.append((mass, compiled.pos, mass * _rotated(rotation, [*diagonal, 0, 0, 0])))
    return combined(solids)


def combined(solids: Sequence[Moments]) -> Moments:
    """Return mass, centre and inertia of several solids together; the centre is the origin if the mass is zero."""
    total = sum(mass for mass, *_ in solids)
    centre = sum((mass * position for mass, position, _ in solids), np.zeros(3)) / (total or 1)
    inertia = np.zeros((3, 3))
    for mass, position, own_inertia in solids:
        offset = position - centre
        inertia += own_inertia + mass * (offset @ offset * np.eye(3) - np.outer(offset, offset))
    return total, centre, inertia


def _solid(kind: str, a: float, b: float, c: float) -> tuple[float, list[float]] | None:
    """Return volume [m³] and moments of inertia per mass (3,) [m²] of a solid with MuJoCo's sizes; None if unknown."""
    if kind == "sphere":
        kind, b, c = "ellipsoid", a, a
    if kind in ("ellipsoid", "box"):
        volume, share = (4 / 3 * pi, 1 / 5) if kind == "ellipsoid" else (8, 1 / 3)
        squares = np.square([a, b, c])
        return volume * a * b * c, (share * (squares.sum() - squares)).tolist()
    if kind in ("cylinder", "capsule"):
        rod, ball = 2 * pi * a * a * b, 4 / 3 * pi * a**3 if kind == "capsule" else 0.0
        tube, ends = rod / (rod + ball), ball / (rod + ball)
        transverse = tube * (a * a / 4 + b * b / 3) + ends * (0.4 * a * a + b * b + 0.75 * a * b)
        return rod + ball, [transverse, transverse, tube * a * a / 2 + ends * 0.4 * a * a]
    return None


def _rotated(rotation: Rotation, six: Any) -> np.ndarray:
    """Return ``R I R'`` (3, 3) for the inertia (xx, yy, zz, xy, xz, yz) in a frame that is rotated by R."""
    R, (xx, yy, zz, xy, xz, yz) = rotation.as_matrix(), six
    return R @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ R.T
