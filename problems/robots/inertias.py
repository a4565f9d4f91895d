"""Mass and inertia of a compiled file, checked body by body against the file's own numbers."""

from __future__ import annotations

from importlib import import_module
from math import pi
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
from scipy.spatial.transform import Rotation

_ROUNDING = 1e-6
"""Relative difference [1] that the compiler's decomposition of an inertia may leave."""
_ADJUSTMENTS = ("boundmass", "boundinertia", "balanceinertia", "settotalmass")
"""Settings by which a file tells MuJoCo to change its masses and inertias, where positive."""

_Moments = tuple[float, np.ndarray, np.ndarray]
"""Mass [kg], centre (3,) [m] and inertia about it (3, 3) [kg m²] in the axes of the body."""


def check_inertias(model: Any, spec: Any, urdf: Element | None) -> None:
    """Raise ``ValueError`` where ``model`` has another mass, centre or inertia than the file.

    Expected are the numbers of ``<inertial>``, of the elements of a URDF or of ``spec`` before it
    was compiled, and ``R I R'`` where that frame is turned by R; without one the closed forms of
    solid geoms of their density. Not checked are bodies with meshes or shells in place of
    ``<inertial>``, bodies whose frame MuJoCo aligns, and files that let it adjust inertias.
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
            expected = _of_mjcf(body, spec.compiler)
        else:
            expected = _of_geoms(model, body, spec.compiler.inertiagrouprange)
        b = model.body(body.name).id
        R = Rotation.from_quat(model.body_iquat[b], scalar_first=True).as_matrix()
        compiled = model.body_mass[b], model.body_ipos[b], R @ np.diag(model.body_inertia[b]) @ R.T
        if expected is not None:
            _compare(body.name, expected, compiled)


def _compare(name: str, expected: _Moments, compiled: _Moments) -> None:
    """Raise ``ValueError`` where two bodies differ by more than rounding."""
    # What has no mass has its centre anywhere.
    length = np.sqrt(np.trace(expected[2]) / expected[0]) if expected[0] else np.inf
    sizes = expected[0], max(length, float(np.abs(expected[1]).max())), np.trace(expected[2])
    for what, a, b, size in zip(("mass", "centre", "inertia"), expected, compiled, sizes,
                                strict=True):  # fmt: skip
        if np.abs(np.subtract(a, b)).max() > _ROUNDING * size:
            said, read = (" ".join(f"{number:.6g}" for number in _six(value)) for value in (a, b))
            raise ValueError(
                f"body {name!r}: the file says {what} {said}, and MuJoCo"
                f" {import_module('mujoco').__version__} reads {read}; install a version that"
                " centralpath[robots] allows"
            )


def _six(value: Any) -> np.ndarray:
    """The numbers of a mass, a centre, or an inertia (xx, yy, zz, xy, xz, yz), without rounding."""
    value = np.asarray(value, dtype=float)
    numbers = value[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]] if value.ndim == 2 else value.ravel()
    return np.where(np.abs(numbers) > _ROUNDING * np.abs(numbers).max(), numbers, 0.0)


def _of_urdf(inertial: Element) -> _Moments:
    def numbers(tag: str, names: str, default: str = "0") -> list[float]:
        element = inertial.find(tag)
        attributes = {} if element is None else element.attrib
        return [float(word) for name in names.split()
                for word in attributes.get(name, default).split()]  # fmt: skip

    turn = Rotation.from_euler("xyz", numbers("origin", "rpy", "0 0 0"))
    six = numbers("inertia", "ixx iyy izz ixy ixz iyz")
    (mass,), centre = numbers("mass", "value"), np.array(numbers("origin", "xyz", "0 0 0"))
    return mass, centre, _turned(turn, six)


def _of_mjcf(body: Any, compiler: Any) -> _Moments:
    full = np.array(body.fullinertia)
    six = [*body.inertia, 0, 0, 0] if np.isnan(full[0]) else full
    return body.mass, np.array(body.ipos), _turned(_orientation(body, compiler), six)


def _orientation(body: Any, compiler: Any) -> Rotation:
    """How the frame of an ``<inertial>`` is turned, in whichever way the file says so."""
    other, unit = body.ialt, np.pi / 180 if compiler.degree else 1.0
    match other.type.name.removeprefix("mjORIENTATION_").lower():
        case "axisangle":
            axis = np.array(other.axisangle[:3])
            return Rotation.from_rotvec(axis / np.linalg.norm(axis) * other.axisangle[3] * unit)
        case "xyaxes":
            x, y = np.array(other.xyaxes[:3]), np.array(other.xyaxes[3:])
            return Rotation.align_vectors([x, y], np.eye(3)[:2], weights=[np.inf, 1])[0]
        case "zaxis":
            z = np.array(other.zaxis) / np.linalg.norm(other.zaxis)
            axis = np.cross([0, 0, 1], z)
            sine = np.linalg.norm(axis)
            axis = axis / sine if sine > 0 else np.array([1.0, 0, 0])
            return Rotation.from_rotvec(np.arctan2(sine, z[2]) * axis)
        case "euler":
            # Small letters turn with the axes for MuJoCo, capitals for SciPy.
            order = "".join(compiler.eulerseq).swapcase()
            return Rotation.from_euler(order, np.array(other.euler) * unit)
    return Rotation.from_quat(body.iquat, scalar_first=True)


def _of_geoms(model: Any, body: Any, groups: Any) -> _Moments | None:
    """Sum over the geoms of a body; None where a mesh or a shell is among them."""
    parts = list[_Moments]()
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
        turn = Rotation.from_quat(compiled.quat, scalar_first=True)
        parts.append((mass, compiled.pos, mass * _turned(turn, [*diagonal, 0, 0, 0])))
    total = sum(part[0] for part in parts)
    if not total:
        return 0.0, np.zeros(3), np.zeros((3, 3))
    centre = sum((mass * at for mass, at, _ in parts), np.zeros(3)) / total
    inertia = np.zeros((3, 3))
    for mass, at, own in parts:
        off = at - centre
        inertia += own + mass * (off @ off * np.eye(3) - np.outer(off, off))
    return total, centre, inertia


def _solid(kind: str, a: float, b: float, c: float) -> tuple[float, list[float]] | None:
    """Volume [m³] and moments (3,) [m²] of 1 kg of a solid with MuJoCo's sizes; None if unknown."""
    if kind == "sphere":
        kind, b, c = "ellipsoid", a, a
    if kind in ("ellipsoid", "box"):
        volume, share = (4 / 3 * pi, 1 / 5) if kind == "ellipsoid" else (8, 1 / 3)
        return volume * a * b * c, [share * (b * b + c * c), share * (a * a + c * c),
                                    share * (a * a + b * b)]  # fmt: skip
    if kind in ("cylinder", "capsule"):
        rod, ball = 2 * pi * a * a * b, 4 / 3 * pi * a**3 if kind == "capsule" else 0.0
        tube, ends = rod / (rod + ball), ball / (rod + ball)
        across = tube * (a * a / 4 + b * b / 3) + ends * (0.4 * a * a + b * b + 0.75 * a * b)
        return rod + ball, [across, across, tube * a * a / 2 + ends * 0.4 * a * a]
    return None


def _turned(turn: Rotation, six: Any) -> np.ndarray:
    """``R I R'`` of moments (xx, yy, zz, xy, xz, yz) in a frame that is turned by R."""
    R, (xx, yy, zz, xy, xz, yz) = turn.as_matrix(), six
    return R @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ R.T
