"""The text of a robot's file, checked and complete, so that compiling it opens no file."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

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
_FOLDERS = ("assetdir", "meshdir", "texturedir")


@dataclass(frozen=True)
class Source:
    """A robot's file as one text, with the files that it names, and what was left out of it."""

    text: str
    urdf: bool
    assets: dict[str, bytes] = field(default_factory=dict)
    ignored: tuple[str, ...] = ()


def read_source(file: Path) -> Source:
    """Read a URDF or MJCF file with all that it includes from its own folder.

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
    if kind == "mujoco":
        _include(root, file)
    _check_elements(root, file)
    if kind == "robot":
        _strip_urdf(root, file, ignored)
        assets: dict[str, bytes] = {}
    else:
        _strip_mjcf(root, ignored)
        assets = _take_meshes(root, file)
    text = ElementTree.tostring(root, encoding="unicode")
    return Source(text, kind == "robot", assets, tuple(ignored))


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


def _strip_urdf(root: ElementTree.Element, file: Path, ignored: list[str]) -> None:
    for joint in root.findall("joint"):
        mimic = joint.find("mimic")
        if mimic is not None:
            raise InputError(
                f"{file}: joint {joint.get('name')!r} mimics {mimic.get('joint')!r}, and coupled"
                " joints are not read; leave <mimic> out"
            )
    list(_removed(root, {"material", "visual"}))
    tags = ("transmission", "gazebo", "sensor")
    counts = {tag: len(list(_removed(root, {tag}))) for tag in tags}
    ignored += [f"<{tag}>, {n} of them: no part of the motion" for tag, n in counts.items() if n]
    for link in root.findall("link"):
        for collision in link.findall("collision"):
            if collision.find("geometry/mesh") is not None:
                link.remove(collision)
                ignored.append(
                    f"mesh of link {link.get('name')}: meshes do not touch anything here"
                )
    fast = [joint.get("name", "") for joint in root.findall("joint") if _limit(joint, "velocity")]
    if fast:
        ignored.append(f"velocity limit of {listed('joint', fast)}: speeds are not bounded")


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
    simulator = [name for one in told for name in one.attrib if name not in _TAKEN]
    if simulator:
        ignored.append(f"{listed('option', simulator)}: settings of a simulator")


def _take_meshes(root: ElementTree.Element, file: Path) -> dict[str, bytes]:
    """Contents of all meshes, which may give bodies their inertia, under names without a folder."""
    folder, bare = "", False
    for compiler in root.iter("compiler"):
        bare = compiler.attrib.pop("strippath", "false") == "true" or bare
        places = {name: compiler.attrib.pop(name) for name in _FOLDERS if name in compiler.attrib}
        folder = places.get("meshdir", places.get("assetdir", folder))
    assets: dict[str, bytes] = {}
    for number, mesh in enumerate(root.iter("mesh")):
        if name := mesh.get("file"):
            place = Path(name).name if bare else name
            content = _inside(file, str(Path(folder, place)), "mesh")
            mesh.set("name", mesh.get("name", Path(name).stem))
            mesh.set("file", f"mesh{number}{content.suffix}")
            assets[mesh.attrib["file"]] = content.read_bytes()
    return assets
