"""The text of a robot's file, checked and complete, so that compiling it opens no file."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from ocp.errors import InputError, abbreviated

_LARGEST = 5_000_000
_DEEPEST = 100
_REFUSED = {
    "attach", "composite", "deformable", "extension", "flex", "flexcomp", "include", "mimic",
    "model", "plugin", "replicate", "skin",
}  # fmt: skip
_SEEN_ONLY = {"camera", "custom", "light", "material", "size", "statistic", "texture", "visual"}
"""What changes a picture, or memory, alone."""
_ASIDE = {"sensor": "nothing is measured here", "transmission": "each joint has its own motor",
          "gazebo": "no part of the motion"}  # fmt: skip
_NAMES = {"name", "class", "childclass"}
_TAKEN = {"gravity", "contact", "filterparent"}
_FOLDERS = ("texturedir", "assetdir", "meshdir")
_MOMENTS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
_DUMMY, _SINGULAR = 1e-3, 1e-9
"""Mass of links that only have one because a program wants it [kg]; a share of an inertia."""
_MESHES = {".stl", ".obj", ".msh"}
"""Endings of the meshes that MuJoCo reads."""


@dataclass(frozen=True)
class Source:
    """A robot's file as one text, with the files that it names, and what was left out of it."""

    text: str
    urdf: bool
    assets: dict[str, bytes]
    ignored: list[str]


def read_source(file: Path) -> Source:
    """Read a URDF or MJCF file with all that it includes from its own folder.

    Raises :class:`~ocp.errors.InputError` for what is no such file, for a name of a file outside
    the folder, and for elements that are not read.
    """
    root = _parsed(file, file)
    if any("xacro" in element.tag for element in root.iter()):
        raise InputError(
            f"{file}: xacro is not read; write the URDF that it stands for, and read that"
        )
    if root.tag not in ("mujoco", "robot"):
        kind = root.tag.rpartition("}")[2]
        raise InputError(
            f"{file}: <{kind}> is neither a URDF (<robot>) nor an MJCF (<mujoco>) file"
        )
    urdf, ignored, seen = root.tag == "robot", list[str](), {file.resolve()}
    # Step by step, as what is included may include more.
    while not urdf and (found := next(_children(root, {"include"}), None)):
        parent, child = found
        name = child.get("file", "")
        part = _inside(file, name, "include", there=True)
        if part in seen:
            raise InputError(f"{file}: {name} is included twice; include it once")
        seen.add(part)
        place = list(parent).index(child)
        parent[place : place + 1] = list(_parsed(part, file))
    for tag, why in _ASIDE.items():
        gone = _without(root, {tag})
        own = gone if urdf else [one for group in gone for one in group]
        if own:
            ignored.append(f"{listed(tag, [one.get('name', one.tag) for one in own])}: {why}")
    _check(root, file)
    _without(root, _SEEN_ONLY)
    (_strip_urdf if urdf else _strip_mjcf)(root, ignored)
    assets = _take_meshes(root, file, ignored)
    return Source(ElementTree.tostring(root, encoding="unicode"), urdf, assets, ignored)


def listed(what: str, names: list[str]) -> str:
    """``what`` in the plural where there are several, and the names: ``"sensors a, b"``."""
    many = "" if len(names) == 1 else "s"
    return f"{what.replace('body', 'bodie') if many else what}{many} {', '.join(names)}"


def _parsed(file: Path, main: Path) -> Element:
    if not file.is_file():
        kind = "is not a regular file" if file.exists() else "there is no such file"
        raise InputError(f"{file}: {kind}; expected a robot as URDF or MJCF")
    if file.stat().st_size > _LARGEST:
        raise InputError(f"{file}: larger than {_LARGEST // 1_000_000} MB; expected a robot")
    try:
        text = file.read_bytes().decode("utf-8-sig")
        if re.search(r"<!(DOCTYPE|ENTITY)", text, re.IGNORECASE):
            raise InputError(f"{file}: declares a document type, which is not read; leave it out")
        return ElementTree.fromstring(text)
    except OSError as error:
        raise InputError(f"{file}: cannot be read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise InputError(f"{file}: is not a text in UTF-8; expected URDF or MJCF") from None
    except ElementTree.ParseError as error:
        raise InputError(f"{file}: is no XML: {error}; expected URDF or MJCF") from None


def _inside(main: Path, name: str, tag: str, *, there: bool = False) -> Path:
    """The file ``name`` in the folder of ``main``, which no links lead out of."""
    folder = main.parent.resolve()
    found = (folder / name).resolve()
    where = f"{main}: file {abbreviated(name)} of <{tag}>"
    if not found.is_relative_to(folder):
        raise InputError(f"{where} leads out of the robot's folder; name files inside of it")
    if there and not _there(found):
        raise InputError(f"{where} is not in its folder")
    return found


def _check(root: Element, main: Path) -> None:
    """Refuse what is not read, files out of the folder, and numbers that are not finite."""
    level, depth = [root], 0
    while level:
        level, depth = [child for element in level for child in element], depth + 1
        if depth > _DEEPEST:
            raise InputError(f"{main}: elements are nested deeper than {_DEEPEST} levels")
    for element in root.iter():
        if element.tag in _REFUSED:
            raise InputError(f"{main}: <{element.tag}> is not read; write the robot without it")
        for name, value in element.attrib.items():
            if name.startswith("file") or name in _FOLDERS:
                _inside(main, value.removeprefix("package://"), element.tag)
            elif name not in _NAMES and any(map(_is_wild, value.split())):
                raise InputError(
                    f"{main}: {name}={abbreviated(value)} of <{element.tag}> is not finite; give"
                    " finite numbers"
                )


def _is_wild(word: str) -> bool:
    try:
        return not math.isfinite(float(word))
    except ValueError:
        return False


def _children(root: Element, tags: set[str]) -> Iterator[tuple[Element, Element]]:
    """Elements of some ``tags``, each behind its parent."""
    return ((parent, child) for parent in root.iter() for child in parent if child.tag in tags)


def _without(root: Element, tags: set[str]) -> list[Element]:
    """Remove all elements of some ``tags``, and return them."""
    found = list(_children(root, tags))
    for parent, child in found:
        parent.remove(child)
    return [child for _, child in found]


def _strip_mjcf(root: Element, ignored: list[str]) -> None:
    """Leave out what names files of pictures and heights, and tell of options."""
    for element in root.iter():
        element.attrib.pop("material", None)
    for field in root.iter("hfield"):
        # It stays flat, and touches nothing.
        field.attrib.pop("file", None)
        field.attrib |= {"nrow": "2", "ncol": "2"}
    names = [name for kind in ("option", "flag") for one in root.iter(kind) for name in one.attrib
             if name not in _TAKEN]  # fmt: skip
    if names:
        ignored.append(f"{listed('option', names)}: settings of a simulator, or of a fluid")


def _strip_urdf(root: Element, ignored: list[str]) -> None:
    """Leave out inertias that no body has, and tell of limits that nothing holds."""
    odd = [link.get("name", "") for link in root.iter("link") if _mended(link)]
    if odd:
        ignored.append(f"products of inertia of {listed('link', odd)}: no body has them")
    fast = [joint.get("name", "") for joint in root.iter("joint")
            if joint.find("limit[@velocity]") is not None]  # fmt: skip
    if fast:
        ignored.append(f"velocity limit of {listed('joint', fast)}: speeds are not bounded")


def _mended(link: Element) -> bool:
    """Whether a link is a dummy whose products of inertia no body has; then leave these out."""
    mass, found = link.find("inertial/mass"), link.find("inertial/inertia")
    if mass is None or found is None:
        return False
    try:
        light = float(mass.get("value", "")) < _DUMMY
        xx, yy, zz, xy, xz, yz = (float(found.get(key, 0)) for key in _MOMENTS)
    except ValueError:
        return False
    least = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])[0]
    if not light or least > _SINGULAR * max(xx, yy, zz) or min(xx, yy, zz) <= 0:
        return False
    found.attrib |= dict.fromkeys(_MOMENTS[3:], "0")
    return True


def _take_meshes(root: Element, file: Path, ignored: list[str]) -> dict[str, bytes]:
    """Contents of all meshes under names without a folder; a URDF does without those not there."""
    urdf, folder = root.tag == "robot", ""
    assets, lost = dict[str, bytes](), dict[str, None]()
    for compiler in root.iter("compiler"):
        named = {name: compiler.attrib.pop(name, "") for name in _FOLDERS}
        folder = named["meshdir"] or named["assetdir"] or folder
    above = {child: parent for parent in root.iter() for child in parent}
    key = "filename" if urdf else "file"
    for mesh in [one for one in root.iter("mesh") if one.get(key)]:
        name = mesh.attrib[key]
        # The first folders may be a package's, or those of another computer.
        parts = Path(name.removeprefix("package://")).parts
        places = [str(Path(folder, *parts[k:])) for k in range(len(parts))]
        found = [one for one in (_inside(file, place, "mesh") for place in places) if _there(one)]
        if urdf and (not found or found[0].suffix.lower() not in _MESHES):
            collision = above[above[mesh]]
            above[collision].remove(collision)
            lost[above[collision].get("name", "")] = None
            continue
        content = found[0] if found else _inside(file, places[0], "mesh", there=True)
        inner = f"mesh{len(assets)}{content.suffix.lower()}"
        assets[inner] = content.read_bytes()
        if not urdf:
            mesh.set("name", mesh.get("name", Path(name).stem))
        mesh.set(key, inner)
    if lost:
        where = "no STL, OBJ or MSH file in the robot's folder, so it touches nothing"
        ignored.append(f"mesh of {listed('link', list(lost))}: {where}")
    return assets


def _there(file: Path) -> bool:
    """Whether a file is there; a name that is too long for one is no error."""
    try:
        return file.is_file()
    except OSError:
        return False
