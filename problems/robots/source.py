"""The text of a robot's file, checked and complete, so that compiling it opens no file."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from ocp.errors import InputError, abbreviated

_LARGEST = 5_000_000
_DEEPEST = 100
_REFUSED = {
    "attach", "composite", "deformable", "extension", "flex", "flexcomp", "model", "plugin",
    "replicate", "skin",
}  # fmt: skip
_SEEN_ONLY = {"camera", "light", "material", "statistic", "texture", "visual"}
"""What changes a picture alone."""
_NAMES = {"name", "class", "childclass"}
_TAKEN = {"gravity", "contact", "filterparent"}
_FLUID = {"density", "viscosity", "wind"}
_FOLDERS = ("assetdir", "meshdir", "texturedir")
_MOMENTS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
_DUMMY, _SINGULAR = 1e-3, 1e-9
"""Mass of links that only have one because a program wants it [kg]; a share of an inertia."""
_MESHES = {".stl", ".obj", ".msh"}
"""Endings of the meshes that MuJoCo reads."""


@dataclass(frozen=True)
class Source:
    """A robot's file as one text, with the files that it names, and what was left out of it.

    ``rooted``: the root of a URDF is fixed to the world, and could float.
    """

    text: str
    urdf: bool
    assets: dict[str, bytes] = field(default_factory=dict)
    ignored: tuple[str, ...] = ()
    rooted: bool = False


def read_source(file: Path, *, floating: bool = False) -> Source:
    """Read a URDF or MJCF file with all that it includes from its own folder.

    The root of a URDF gets a free joint where it is ``floating``.

    Raises :class:`~ocp.errors.InputError` for what is no such file, for a name of a file outside
    the folder, and for elements that are not read.
    """
    root = _parsed(file, file)
    kind = root.tag.rpartition("}")[2]
    if any("xacro" in element.tag for element in root.iter()):
        raise InputError(
            f"{file}: xacro is not read; write the URDF that it stands for, and read that"
        )
    if kind not in ("mujoco", "robot"):
        raise InputError(
            f"{file}: <{kind}> is neither a URDF (<robot>) nor an MJCF (<mujoco>) file"
        )
    ignored: list[str] = []
    rooted = False
    if kind == "mujoco":
        _include(root, file)
    else:
        tags = ("transmission", "gazebo", "sensor")
        counts = {tag: len(list(_removed(root, {tag}))) for tag in tags}
        ignored += [
            f"<{tag}>, {n} of them: no part of the motion" for tag, n in counts.items() if n
        ]
    _check_elements(root, file)
    if kind == "robot":
        assets = _strip_urdf(root, file, ignored)
        rooted = _root(root, file, floating) and not floating
    elif floating:
        raise InputError(f"{file}: an MJCF file says itself what floats; give a body <freejoint/>")
    else:
        _strip_mjcf(root, ignored)
        assets = _take_meshes(root, file)
    text = ElementTree.tostring(root, encoding="unicode")
    return Source(text, kind == "robot", assets, tuple(ignored), rooted)


def listed(what: str, names: list[str]) -> str:
    """``what`` in the plural where there are several, and the names: ``"sensors a, b"``."""
    many = "" if len(names) == 1 else "s"
    return f"{what.replace('body', 'bodie') if many else what}{many} {', '.join(names)}"


def _parsed(file: Path, main: Path) -> ElementTree.Element:
    if not file.is_file():
        kind = "is not a regular file" if file.exists() else "there is no such file"
        raise InputError(f"{file}: {kind}; expected a robot as URDF or MJCF")
    if file.stat().st_size > _LARGEST:
        raise InputError(f"{file}: larger than {_LARGEST // 1_000_000} MB; expected a robot")
    try:
        text = file.read_bytes().decode("utf-8-sig")
        if re.search(r"<!(DOCTYPE|ENTITY)", text, re.IGNORECASE):
            raise InputError(f"{file}: declares a document type, which is not read; leave it out")
        root = ElementTree.fromstring(text)
    except OSError as error:
        raise InputError(f"{file}: cannot be read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise InputError(f"{file}: is not a text in UTF-8; expected URDF or MJCF") from None
    except ElementTree.ParseError as error:
        raise InputError(f"{file}: is no XML: {error}; expected URDF or MJCF") from None
    level, depth = [root], 0
    while level:
        level, depth = [child for element in level for child in element], depth + 1
        if depth > _DEEPEST:
            raise InputError(f"{file}: elements are nested deeper than {_DEEPEST} levels")
    _check_places(root, main)
    return root


def _check_places(root: ElementTree.Element, main: Path) -> None:
    """Refuse every name of a file that is absolute or leads out of the folder of ``main``."""
    for element in root.iter():
        for name, value in element.attrib.items():
            if name.startswith("file") or name in _FOLDERS:
                place = value.removeprefix("package://")
                parts = re.split(r"[/\\]", place)
                outside = parts[0] == "" or ".." in parts or ":" in place or place[:1] == "~"
                if (outside and place) or "\0" in place:
                    raise InputError(
                        f"{main}: {name}={abbreviated(value)} of <{element.tag}> leads out of the"
                        " robot's folder; name files inside of it"
                    )


def _inside(main: Path, name: str, element: str) -> Path:
    """The file ``name`` in the folder of ``main``, which links do not lead out of."""
    folder = main.parent.resolve()
    found = (folder / name).resolve()
    if not found.is_relative_to(folder):
        raise InputError(
            f"{main}: file={abbreviated(name)} of <{element}> leads out of the robot's folder; name"
            " files inside of it"
        )
    if not found.is_file():
        raise InputError(f"{main}: file={abbreviated(name)} of <{element}> is not in its folder")
    return found


def _include(root: ElementTree.Element, main: Path) -> None:
    """Put what is included in its place; a file is included once."""
    seen = {main.resolve()}
    while found := _first_include(root):
        parent, place = found
        name = parent[place].get("file", "")
        file = _inside(main, name, "include")
        if file in seen:
            raise InputError(f"{main}: {name} is included twice; include it once")
        seen.add(file)
        parent[place : place + 1] = list(_parsed(file, main))


def _first_include(root: ElementTree.Element) -> tuple[ElementTree.Element, int] | None:
    for parent in root.iter():
        for place, child in enumerate(parent):
            if child.tag == "include":
                return parent, place
    return None


def _check_elements(root: ElementTree.Element, file: Path) -> None:
    for element in root.iter():
        if element.tag in _REFUSED | {"include"}:
            raise InputError(f"{file}: <{element.tag}> is not read; write the robot without it")
        for name, value in element.attrib.items():
            if name not in _NAMES and any(map(_is_wild, value.split())):
                raise InputError(
                    f"{file}: {name}={abbreviated(value)} of <{element.tag}> is not finite; give"
                    " finite numbers"
                )


def _is_wild(word: str) -> bool:
    try:
        return not math.isfinite(float(word))
    except ValueError:
        return False


def _removed(root: ElementTree.Element, tags: set[str]) -> Iterator[ElementTree.Element]:
    for parent in list(root.iter()):
        for child in list(parent):
            if child.tag in tags:
                parent.remove(child)
                yield child


def _root(root: ElementTree.Element, file: Path, floating: bool) -> bool:
    """Whether the root link stands fixed in the world; let it float where it should."""
    links = [link.get("name", "") for link in root.findall("link")]
    below = {child.get("link") for child in root.iterfind("joint/child")}
    tops = [name for name in links if name not in below]
    fixed = len(tops) == 1 and "world" not in links
    if floating and not fixed:
        raise InputError(f"{file}: the link called world never moves; name the root another way")
    if floating:
        ElementTree.SubElement(root, "link", name="world")
        joint = ElementTree.SubElement(root, "joint", name=f"{tops[0]} floats", type="floating")
        ElementTree.SubElement(joint, "parent", link="world")
        ElementTree.SubElement(joint, "child", link=tops[0])
    return fixed


def _strip_urdf(root: ElementTree.Element, file: Path, ignored: list[str]) -> dict[str, bytes]:
    """Leave out what is no part of the motion; the contents of the meshes that may touch."""
    for joint in root.findall("joint"):
        mimic = joint.find("mimic")
        if mimic is not None:
            raise InputError(
                f"{file}: joint {joint.get('name')!r} mimics {mimic.get('joint')!r}, and coupled"
                " joints are not read; leave <mimic> out"
            )
    list(_removed(root, {"material", "visual"}))
    folder, bare = _mesh_folder(root)
    assets: dict[str, bytes] = {}
    lost: dict[str, None] = {}
    for link in root.findall("link"):
        for collision in link.findall("collision"):
            mesh = collision.find("geometry/mesh")
            if mesh is None:
                continue
            found = _mesh_below(file, folder, mesh.get("filename", ""), bare)
            if found is None:
                link.remove(collision)
                lost[link.get("name", "")] = None
            else:
                name = f"mesh{len(assets)}{found.suffix.lower()}"
                mesh.set("filename", name)
                assets[name] = found.read_bytes()
    odd = [link.get("name", "") for link in root.findall("link") if _mended(link)]
    if odd:
        ignored.append(f"products of inertia of {listed('link', odd)}: no body has them")
    if lost:
        where = "no STL, OBJ or MSH file in the robot's folder, so it touches nothing"
        ignored.append(f"mesh of {listed('link', list(lost))}: {where}")
    fast = [joint.get("name", "") for joint in root.findall("joint") if _limit(joint, "velocity")]
    if fast:
        ignored.append(f"velocity limit of {listed('joint', fast)}: speeds are not bounded")
    return assets


def _mended(link: ElementTree.Element) -> bool:
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
    for key in _MOMENTS[3:]:
        found.set(key, "0")
    return True


def _mesh_below(file: Path, folder: str, name: str, bare: bool) -> Path | None:
    """A mesh of a URDF in the folder of ``file``; a package may be that folder or lie in it."""
    parts = Path(name.removeprefix("package://")).parts
    starts = [len(parts) - 1] if bare else range(len(parts) if "://" in name else 1)
    for start in starts:
        try:
            found = _inside(file, str(Path(folder, *parts[start:])), "mesh")
        except InputError:
            continue
        return found if found.suffix.lower() in _MESHES else None
    return None


def _limit(joint: ElementTree.Element, what: str) -> str | None:
    found = joint.find("limit")
    return None if found is None else found.get(what)


def _strip_mjcf(root: ElementTree.Element, ignored: list[str]) -> None:
    names = [s.get("name", s.tag) for part in _removed(root, {"sensor"}) for s in part]
    if names:
        ignored.append(f"{listed('sensor', names)}: nothing is measured here")
    list(_removed(root, {*_SEEN_ONLY, "custom", "size"}))
    for element in root.iter():
        element.attrib.pop("material", None)
    for parent in root.iter():
        for geom in [one for one in parent if one.get("hfield")]:
            ignored.append(f"height field {geom.get('hfield')}: it touches nothing here")
            parent.remove(geom)
    list(_removed(root, {"hfield"}))
    told = [one for kind in ("option", "flag") for one in root.iter(kind)]
    fluid = [name for one in told for name in one.attrib if name in _FLUID]
    if fluid:
        ignored.append(f"{listed('option', fluid)}: there is no fluid")
    simulator = [k for one in told for k in one.attrib if k not in _TAKEN | _FLUID]
    if simulator:
        ignored.append(f"{listed('option', simulator)}: settings of a simulator")


def _take_meshes(root: ElementTree.Element, file: Path) -> dict[str, bytes]:
    """Contents of all meshes, which may give bodies their inertia, under names without a folder."""
    folder, bare = _mesh_folder(root)
    assets: dict[str, bytes] = {}
    for number, mesh in enumerate(root.iter("mesh")):
        if name := mesh.get("file"):
            place = Path(name).name if bare else name
            content = _inside(file, str(Path(folder, place)), "mesh")
            mesh.set("name", mesh.get("name", Path(name).stem))
            mesh.set("file", f"mesh{number}{content.suffix}")
            assets[mesh.attrib["file"]] = content.read_bytes()
    return assets


def _mesh_folder(root: ElementTree.Element) -> tuple[str, bool]:
    """Where a file says that its meshes lie, and whether their names lose their own folders."""
    folder, bare = "", False
    for compiler in root.iter("compiler"):
        bare = compiler.attrib.pop("strippath", "false") == "true" or bare
        places = {name: compiler.attrib.pop(name) for name in _FOLDERS if name in compiler.attrib}
        folder = places.get("meshdir", places.get("assetdir", folder))
    return folder, bare
