"""Tables of the elements and attributes that are read from robot files, and reasons for ignoring others."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from xml.etree.ElementTree import Element


def _table(text: str) -> dict[str, list[str]]:
    """Parse ``key: words; key: words`` to a mapping from key to words."""
    entries = (entry.partition(":") for entry in " ".join(text.split()).split(";"))
    return {key.strip(): words.split() for key, _, words in entries}


def _by_name(text: str) -> dict[str, str]:
    """Parse ``reason: names; reason: names`` to a mapping from name to reason."""
    return {name: reason for reason, names in _table(text).items() for name in names}


ALL = "*"
"""Word that stands for all attributes of an element in a table."""
_POSE = "pos quat axisangle xyaxes zaxis euler"
"""Attributes of MJCF for the pose of an element."""
_ACTUATOR = """name class joint jointinparent tendon site body refsite cranksite slidersite gear
    ctrllimited ctrlrange forcelimited forcerange gainprm biasprm gaintype biastype
    dyntype dynprm inheritrange"""
"""Attributes of MJCF that every actuator has."""
URDF = _table("""
robot: name; link: name; inertial:; origin: xyz rpy; mass: value; inertia: ixx ixy ixz iyy iyz
izz; collision: name; geometry:; box: size; sphere: radius; cylinder: radius length; capsule:
radius length; mesh: filename scale; joint: name type; parent: link; child: link; axis: xyz;
limit: lower upper effort; dynamics: damping; mimic: joint multiplier offset; mujoco:; compiler:
*; lateral_friction: value; mu: value; mu1: value; mu2: value
""")
"""Mapping from a URDF element to the attributes that are read; for mu, mu1 and mu2 the text is also read."""
MJCF = _table(
    """
mujoco: model; mujocoinclude: *; include: file; compiler: *; option: gravity; flag: gravity
contact filterparent equality; default: class; worldbody:; body: name childclass mocap POSE;
frame: name childclass POSE; inertial: mass diaginertia fullinertia POSE; freejoint: name align;
joint: name class type pos axis ref springref springdamper stiffness damping armature range
limited actuatorfrcrange actuatorfrclimited joint coef joint1 joint2 polycoef active; geom: name
class type size fromto mesh fitscale hfield mass density shellinertia contype conaffinity condim
friction priority POSE; asset:; mesh: name class file vertex face scale refpos refquat inertia
content_type builtin params maxhullvert; contact:; pair: name class geom1 geom2 condim friction;
exclude: name body1 body2; equality:; connect: *; weld: *; tendon: name class active tendon1
tendon2 polycoef; fixed: name class; spatial: *; actuator:; general: ACTUATOR; motor: ACTUATOR;
position: ACTUATOR kp kv dampratio timeconst; velocity: ACTUATOR kv; keyframe:; key: name qpos;
intvelocity: *; damper: *; cylinder: *; muscle: *; adhesion: *; dcmotor: *
""".replace("POSE", _POSE).replace("ACTUATOR", _ACTUATOR)
)
"""Mapping from an MJCF element to the attributes that are read; some have no effect, see ``unsupported``."""
_BULKY = {"camera", "custom", "light", "material", "skin", "statistic", "texture", "visual"}
"""Elements of MJCF that are removed before compilation, since some of them refer to files."""
_PICTURES = _BULKY | {"color", "group", "numeric", "rgba", "size", "texcoord", "text", "tuple", "user"}
"""Elements and attributes that affect only pictures."""
_REASONS = _by_name("""
sensors are not simulated: sensor calibration; each joint has its own motor: transmission; settings
of another program: gazebo; its soft limits and gains act in another program: safety_controller;
speeds are not bounded: velocity; joints have no dry friction: friction frictionloss; gravity acts
on every body: gravcomp; contacts only slide: rolling_friction spinning_friction; contact is
rigid: solref solimp solmix margin gap contact contact_cfm contact_erp restitution; limits are
rigid: solreflimit solimplimit; there is no such friction: solreffriction solimpfriction; there is
no fluid: fluidshape fluidcoef; height fields have no contacts: hfield; no force acts at sites:
site; surfaces do not move: surfacevel; motors have no delay: delay; give it to the joint: armature
""")
"""Mapping from an element or attribute that is not read to the reason, for use in notes."""
REFUSED = _by_name("""
it copies another file: attach; bodies are rigid: composite flex flexcomp; it loads compiled code:
extension plugin; a URDF cannot include files here: include; it closes a loop, and joints form trees
here: loop_joint; it reads another file: model; it makes copies: replicate
""")
"""Mapping from an element that causes an error, since it can neither be read nor ignored, to the reason."""
REFUSED_OF_URDF = {"include", "loop_joint"}
"""Elements of :data:`REFUSED` that cause an error in a URDF; others have no effect there."""


def listed(kind: str, names: Iterable[str]) -> str:
    """Return ``kind`` (in the plural for several names) followed by the names: ``"sensors a, b"``."""
    names = list(dict.fromkeys(names))
    plural = "" if len(names) == 1 else "s"
    return f"{kind.replace('body', 'bodie') if plural else kind}{plural} {', '.join(names)}"


def unread(root: Element, *, urdf: bool) -> list[str]:
    """Return sentences on all parts of a file that are not read, one for each reason.

    From a URDF all unread elements are removed, from an MJCF file only the elements in ``_BULKY``.
    Raises ``ValueError`` for an element in :data:`REFUSED`.
    """
    table, pictures = URDF if urdf else MJCF, set[str]()
    names_by_reason: dict[tuple[str, str, str], list[str]] = {}
    for element, owners in _walk(root, table, remove=None if urdf else _BULKY):
        tag, (kind, name) = element.tag, _nearest_named(element, owners)
        if tag in REFUSED and (not urdf or tag in REFUSED_OF_URDF):
            raise ValueError(f"<{tag}> is not read, as {REFUSED[tag]}; write the robot without it")
        if tag in _PICTURES:
            pictures.add(tag)
        elif tag in table:
            attributes = _unread_attributes(element, table[tag], urdf=urdf)
            pictures |= _PICTURES & attributes.keys()
            for attribute in (name for name in attributes if name not in _PICTURES):
                key, named = _sentence(attribute, tag, kind, name)
                names_by_reason.setdefault(key, []).append(named)
        elif tag == "sensor" and not urdf:
            names = [sensor.get("name", sensor.tag) for sensor in element]
            names_by_reason.setdefault(("", tag, _reason_for(tag)), []).extend(names)
        else:
            inside = dict.fromkeys(child.tag for child in element.iter() if child is not element)
            name += f" ({', '.join(inside)})" if inside else ""
            names_by_reason.setdefault(("" if kind == tag else f"{tag} of ", kind, _reason_for(tag)), []).append(name)
    lines = [f"{prefix}{listed(kind, names)}: {reason}" for (prefix, kind, reason), names in names_by_reason.items()]
    return lines + ([f"{', '.join(sorted(pictures))}: change only pictures"] if pictures else [])


def _unread_attributes(element: Element, read: list[str], *, urdf: bool) -> dict[str, str]:
    """Return an element's attributes that are not read; remove them in a URDF, or if they have a namespace."""
    unread = {k: v for k, v in element.attrib.items() if k not in read and read != [ALL]}
    for name in unread:
        if urdf or ":" in name:
            del element.attrib[name]
    return {k: v for k, v in unread.items() if not k.startswith("xmlns")}


def _sentence(attribute: str, tag: str, kind: str, name: str) -> tuple[tuple[str, str, str], str]:
    """Return the key of a sentence about an attribute, and the name to list in the sentence.

    Attributes in the same sentence have the same key (prefix, kind of element, reason).
    """
    if tag in ("option", "flag"):
        return ("", "option", "settings of a simulator, or of a fluid"), attribute
    prefix = f"{attribute} of " if kind == tag else f"{attribute} of {tag} of "
    return (prefix, kind, _reason_for(attribute)), name


def _reason_for(name: str) -> str:
    return _REASONS.get(name, "an extension of another program" if ":" in name else "not read")


def _walk(
    root: Element, table: dict[str, list[str]], remove: set[str] | None
) -> Iterator[tuple[Element, tuple[Element, ...]]]:
    """Yield each element that is read, and each topmost unread element, with its ancestors.

    Unread elements are removed from the tree if ``remove`` is None or contains their tag.
    """
    stack: list[tuple[Element, tuple[Element, ...]]] = [(root, ())]
    while stack:
        element, owners = stack.pop()
        yield element, owners
        if element.tag in table:
            stack += [(child, (*owners, element)) for child in reversed(element)]
        elif owners and (remove is None or element.tag in remove):
            owners[-1].remove(element)


def _nearest_named(element: Element, owners: tuple[Element, ...]) -> tuple[str, str]:
    """Return tag and name of the element or, if it has no name, of its nearest ancestor with a name."""
    for ancestor in (element, *reversed(owners)):
        if ancestor.tag in ("default", "worldbody"):
            return ("body", "world") if ancestor.tag == "worldbody" else (ancestor.tag, ancestor.get("class", "main"))
        if name := ancestor.get("name") or ancestor.get("reference"):
            return ancestor.tag, name
    return owners[0].tag if owners else element.tag, "as a whole"
