"""Reading of a robot's file to a checked text with its meshes, so that its compilation opens no other file."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element
from xml.parsers import expat

from ocp.errors import InputError, abbreviated
from problems.robots.elements import listed, unread
from problems.robots.urdf import Mimic, children, clean, declare_world, take_friction, take_mimics

MOST_BYTES = 2_000_000
"""Maximum size of a file, including all included files [bytes]."""
MOST_LEVELS = 100
"""Maximum depth of nested elements."""
MOST_ATTRIBUTES = 200
"""Maximum number of attributes of one element."""
MOST_JOINTS = 100
"""Maximum number of joints of a robot."""
MOST_GEOMS = 1000
"""Maximum number of geoms of a robot."""
LARGEST_NUMBER = 1e50
"""Maximum absolute value of a number in a file; products of several such numbers stay finite."""
TEXT_ATTRIBUTES = {"name", "class", "childclass", "model", "text", "data"}
"""Attributes whose numbers are not checked: names and texts."""
INFINITE_ATTRIBUTES = {"lower", "upper", "effort", "velocity", "range", "ctrlrange", "forcerange", "actuatorfrcrange"}
"""Attributes that may be infinite."""
OWNING_ELEMENTS = {"body", "worldbody", "frame"}
"""Elements of MJCF whose child elements ``joint`` and ``geom`` are part of the robot."""
FOLDER_ATTRIBUTES = ("assetdir", "meshdir", "texturedir")
"""Attributes of ``<compiler>`` with the folders of all files, of meshes, and of textures."""
MESH_SUFFIXES = {".stl", ".obj", ".msh"}
"""File extensions of the meshes that MuJoCo reads."""


@dataclass(frozen=True)
class Source:
    """A robot's file as one text, with the contents of its meshes, and the data that were removed from the text."""

    text: str
    urdf: bool
    assets: dict[str, bytes]
    ignored: list[str]
    friction: dict[str, float]
    mimics: list[Mimic]


def read_source(file: Path, folder: Path | None = None) -> Source:
    """Read a URDF or MJCF file with all that it includes from ``folder``, by default that of the file.

    The result's ``friction`` maps each link of a URDF that states Coulomb's coefficient to its value.

    Raises :class:`~ocp.errors.InputError` for other files, for the name of a file outside the
    folder, for more than 100 joints or 1000 geoms, and for elements in
    :data:`~problems.robots.elements.REFUSED`.
    """
    root, size = _parsed(file, 0)
    kind = root.tag.rpartition(":")[2]
    if any("xacro" in element.tag for element in root.iter()):
        raise InputError(f"{file}: xacro files are not read; convert this one to URDF with xacro, and read that")
    if kind == "sdf":
        raise InputError(
            f"{file}: SDF, the language of Gazebo, is not read; convert it to URDF, for instance"
            " with UrdfExporter of the Python package rod, and read that"
        )
    if kind not in ("mujoco", "robot"):
        hint = "; give the file that includes it" if kind == "mujocoinclude" else ""
        raise InputError(f"{file}: <{kind}> is neither a URDF (<robot>) nor an MJCF (<mujoco>) file{hint}")
    robot_folder = RobotFolder(file, (folder or file.parent).resolve())
    urdf, read_files = root.tag == "robot", {file.resolve()}
    # Includes are replaced one at a time, since an included file may include others.
    while not urdf and (pair := next(children(root, {"include"}), None)):
        parent, child = pair
        name = child.get("file", "")
        included = robot_folder.find(name, "include")
        if included in read_files:
            raise InputError(f"{file}: {name} is included twice; include it once")
        read_files.add(included)
        index = list(parent).index(child)
        inner, size = _parsed(included, size)
        parent[index : index + 1] = list(inner)
    _check_size(root, file)
    if urdf:
        declare_world(root)
    ignored = list[str]()
    friction = take_friction(root, file, ignored) if urdf else {}
    try:
        ignored += unread(root, urdf=urdf)
    except ValueError as error:
        raise InputError(f"{file}: {error}") from None
    _check(root, robot_folder)
    mimics = [] if not urdf else take_mimics(root, file)
    if urdf:
        ignored += clean(root)
    else:
        _strip_mjcf(root)
    assets = _take_meshes(root, robot_folder, ignored)
    text = ElementTree.tostring(root, encoding="unicode")
    return Source(text, urdf, assets, ignored, friction, mimics)


def _parsed(file: Path, size: int) -> tuple[Element, int]:
    """Return the root element of a file, and the total size [bytes] of this file and files read before (``size``)."""
    if not file.is_file():
        kind = "is not a regular file" if file.exists() else "there is no such file"
        raise InputError(f"{file}: {kind}; expected a robot as URDF or MJCF")
    if (size := size + file.stat().st_size) > MOST_BYTES:
        raise InputError(f"{file}: larger than {MOST_BYTES // 1_000_000} MB; expected a robot")
    try:
        text = file.read_bytes().decode("utf-8-sig")
        if re.search(r"<!(DOCTYPE|ENTITY)", text, re.IGNORECASE):
            raise InputError(f"{file}: declares a document type, which is not read; leave it out")
        return _tree(re.sub(r"<\?xml.*?\?>", "", text, count=1, flags=re.DOTALL)), size
    except OSError as error:
        raise InputError(f"{file}: cannot be read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise InputError(f"{file}: is not a text in UTF-8; expected URDF or MJCF") from None
    except expat.ExpatError as error:
        raise InputError(f"{file}: is no XML: {error}; expected URDF or MJCF") from None


def _tree(text: str) -> Element:
    """Parse XML; namespace prefixes, declared or not, remain part of the names."""
    builder, parser = ElementTree.TreeBuilder(), expat.ParserCreate()
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.data
    parser.Parse(text.encode(), True)
    return builder.close()


@dataclass(frozen=True)
class RobotFolder:
    """A robot's ``file``, and the ``folder`` that contains all files that may be opened."""

    file: Path
    folder: Path

    def resolve(self, name: str, tag: str) -> Path:
        """Return the absolute path, without symbolic links, of a file whose ``name`` is relative to the robot's file.

        Raises :class:`~ocp.errors.InputError` for a path outside the folder.
        """
        path = (self.file.parent.resolve() / name).resolve()
        if not path.is_relative_to(self.folder):
            raise InputError(
                f"{self.file}: file {abbreviated(name)} of <{tag}> is outside the robot's folder;"
                " name a folder that contains both with --folder DIR"
            )
        return path

    def existing(self, name: str) -> Path | None:
        """Return the absolute path of a file, or None if there is no such file in the folder."""
        try:
            path = self.resolve(name, "mesh")
        except InputError:
            return None
        return path if _exists(path) else None

    def find(self, name: str, tag: str) -> Path:
        """Return the absolute path of a file; raise :class:`~ocp.errors.InputError` if it does not exist."""
        path = self.resolve(name, tag)
        if not _exists(path):
            raise InputError(f"{self.file}: file {abbreviated(name)} of <{tag}> is not in its folder")
        return path


def _check_size(root: Element, file: Path) -> None:
    """Raise :class:`~ocp.errors.InputError` for too many joints, geoms, levels or attributes."""
    level, depth = [root], 0
    while level:
        level, depth = [child for element in level for child in element], depth + 1
        if depth > MOST_LEVELS:
            raise InputError(f"{file}: elements are nested deeper than {MOST_LEVELS} levels")
    if root.tag == "robot":
        joints = sum(joint.get("type") != "fixed" for joint in root.iterfind("joint"))
        geoms = sum(1 for _ in root.iter("collision"))
    else:
        owners = [element for element in root.iter() if element.tag in OWNING_ELEMENTS]
        owned = [child.tag for owner in owners for child in owner]
        joints, geoms = owned.count("joint") + owned.count("freejoint"), owned.count("geom")
    if joints > MOST_JOINTS:
        raise InputError(
            f"{file}: {joints} joints; at most {MOST_JOINTS} are read, as the equations of motion"
            " of more take minutes to build"
        )
    if geoms > MOST_GEOMS:
        raise InputError(f"{file}: {geoms} geoms; at most {MOST_GEOMS} are read; merge some")
    longest = max(root.iter(), key=lambda element: len(element.attrib))
    if (count := len(longest.attrib)) > MOST_ATTRIBUTES:
        raise InputError(f"{file}: <{longest.tag}> has {count} attributes; expected a robot")


def _check(root: Element, robot_folder: RobotFolder) -> None:
    """Raise :class:`~ocp.errors.InputError` for files outside the folder, and for numbers out of range."""
    for element in root.iter():
        for name, value in element.attrib.items():
            if name == "file" or name in FOLDER_ATTRIBUTES[:2]:
                robot_folder.resolve(value, element.tag)
            elif name not in TEXT_ATTRIBUTES and (wrong := _out_of_range(name, value)):
                raise InputError(f"{robot_folder.file}: {name}={abbreviated(value)} of <{element.tag}> {wrong}")


def _out_of_range(name: str, value: str) -> str:
    """Return a part of a sentence on why a number in an attribute is rejected; "" if all its numbers are valid."""
    for word in value.split():
        try:
            number = float(word)
        except ValueError:
            continue
        if math.isinf(number) and name in INFINITE_ATTRIBUTES:
            continue
        if not math.isfinite(number):
            return "is not finite; give finite numbers"
        if abs(number) > LARGEST_NUMBER:
            return f"is too large to compute with; give numbers below {LARGEST_NUMBER:g}"
    return ""


def _strip_mjcf(root: Element) -> None:
    """Remove references to materials, and to files of height fields."""
    for element in root.iter():
        element.attrib.pop("material", None)
    for field in root.iter("hfield"):
        # Without its file a height field is flat; it has no contacts.
        field.attrib.pop("file", None)
        field.attrib |= {"nrow": "2", "ncol": "2"}


def _take_meshes(root: Element, robot_folder: RobotFolder, ignored: list[str]) -> dict[str, bytes]:
    """Replace the file names of all meshes in ``root`` by names without a folder; return a mapping to their contents.

    From a URDF, meshes outside the robot's folder or of an unsupported format are removed.
    """
    urdf, folder = root.tag == "robot", ""
    assets, lost = dict[str, bytes](), dict[str, None]()
    for compiler in root.iter("compiler"):
        named = {name: compiler.attrib.pop(name, "") for name in FOLDER_ATTRIBUTES}
        folder = named["meshdir"] or named["assetdir"] or folder
    above = {child: parent for parent in root.iter() for child in parent}
    key = "filename" if urdf else "file"
    bases = [base for base in robot_folder.file.resolve().parents if base.is_relative_to(robot_folder.folder)]
    for mesh in [element for element in root.iter("mesh") if element.get(key)]:
        name = mesh.attrib[key]
        # The name may begin with the folders of a package, or of another computer.
        path_parts = Path(name.rpartition("://")[2].lstrip("/") if urdf else name).parts
        paths = [str(base / Path(folder, *path_parts[k:])) for base in bases for k in range(len(path_parts))]
        content = next(filter(None, map(robot_folder.existing, paths)), None)
        if urdf and (content is None or content.suffix.lower() not in MESH_SUFFIXES):
            collision = above[above[mesh]]
            above[collision].remove(collision)
            lost[above[collision].get("name", "")] = None
            continue
        content = content or robot_folder.find(str(Path(folder, name)), "mesh")
        inner = f"mesh{len(assets)}{content.suffix.lower()}"
        assets[inner] = content.read_bytes()
        if not urdf:
            mesh.set("name", mesh.get("name", Path(name).stem))
        mesh.set(key, inner)
    if lost:
        reason = "no STL, OBJ or MSH file in the robot's folder, so it has no contacts"
        hint = "--folder DIR names a folder around it"
        ignored.append(f"mesh of {listed('link', lost)}: {reason}; {hint}")
    return assets


def _exists(file: Path) -> bool:
    """Return whether a file exists; False also for a name that is too long."""
    try:
        return file.is_file()
    except OSError:
        return False
