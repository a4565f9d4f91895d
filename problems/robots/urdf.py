"""Conversion of parts of URDF files that MuJoCo does not read: the world, friction, mimic joints, dummy links."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from ocp.errors import InputError
from problems.robots.elements import listed

FRICTION_TAGS = {"lateral_friction", "mu", "mu1", "mu2"}
"""Elements of a URDF that state a coefficient of friction."""
FRICTION_HOLDERS = {"contact", "gazebo", "surface", "friction", "ode"}
"""Elements of a URDF that may contain elements in :data:`FRICTION_TAGS`."""
MOMENTS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
"""Attributes of a link's inertia: moments, then products."""
DUMMY_MASS_KG = 1e-3
"""Mass [kg] below which a link counts as a dummy without physical meaning."""
SINGULAR_INERTIA = 1e-9
"""Minimum principal moment of a valid inertia, relative to the largest."""


@dataclass(frozen=True)
class Mimic:
    """A joint of a URDF that follows another joint: ``q = multiplier * q[leader] + offset``.

    If ``leader`` is "", the joint stays at its offset.
    """

    joint: str
    leader: str
    multiplier: float
    offset: float


def children(root: Element, tags: set[str]) -> Iterator[tuple[Element, Element]]:
    """Yield pairs of a parent and an element whose tag is in ``tags``."""
    return ((parent, child) for parent in root.iter() for child in parent if child.tag in tags)


def declare_world(root: Element) -> None:
    """Add the link ``world`` to a URDF if it is the parent of a joint and not declared."""
    links = {link.get("name") for link in root.iterfind("link")}
    parents = {parent.get("link") for parent in root.iterfind("joint/parent")}
    if "world" in parents - links:
        root.insert(0, Element("link", name="world"))


def take_friction(root: Element, file: Path, notes: list[str]) -> dict[str, float]:
    """Remove friction from the links of a URDF; return a mapping from each link to its smallest coefficient.

    Raises :class:`~ocp.errors.InputError` for a coefficient that depends on the direction, or is negative.
    """
    stated: dict[str, dict[float, None]] = {}
    links = [(link, link.get("name", "")) for link in root.iterfind("link")]
    for element, name in links + [(g, g.get("reference", "")) for g in root.iterfind("gazebo")]:
        by_element: dict[Element, float] = {}
        for parent, child in list(children(element, FRICTION_TAGS)):
            try:
                value = float(child.get("value") or child.text or "")
            except ValueError:
                continue
            parent.remove(child)
            if not 0 <= value < np.inf:
                raise InputError(f"{file}: friction {value:g} of link {name!r}; expected 0 or more")
            if by_element.setdefault(parent, value) != value:
                raise InputError(
                    f"{file}: link {name!r} has the friction {by_element[parent]:g} and {value:g};"
                    " friction here is the same in all directions, so give one number"
                )
            stated.setdefault(name, {})[value] = None
    for name, values in stated.items():
        if len(values) > 1:
            notes.append(f"friction {max(values):g} of link {name}: the smaller {min(values):g} is used")
    # Elements that contained nothing but friction are now empty.
    while empty := [pair for pair in children(root, FRICTION_HOLDERS) if _is_empty(pair[1])]:
        for parent, child in empty:
            parent.remove(child)
    return {name: min(values) for name, values in stated.items()}


def _is_empty(element: Element) -> bool:
    return len(element) == 0 and not (element.text or "").strip()


def take_mimics(root: Element, file: Path) -> list[Mimic]:
    """Remove ``<mimic>`` from the joints of a URDF, and return the joints that follow another joint.

    A joint that follows a fixed joint stays at its offset; ``<mimic>`` of a fixed joint has no effect.
    """
    mimics = list[Mimic]()
    kinds = {joint.get("name"): joint.get("type") for joint in root.iterfind("joint")}
    for joint, element in list(children(root, {"mimic"})):
        name, leader = joint.get("name", ""), element.get("joint", "")
        joint.remove(element)
        try:
            numbers = float(element.get("multiplier", 1)), float(element.get("offset", 0))
        except ValueError:
            raise InputError(f"{file}: <mimic> of joint {name!r}: expected numbers") from None
        if leader not in kinds or leader == name:
            raise InputError(
                f"{file}: joint {name!r} mimics {leader!r}, which is no other joint; delete its"
                " <mimic>, or name another joint"
            )
        if kinds[name] != "fixed":
            mimics.append(Mimic(name, "" if kinds[leader] == "fixed" else leader, *numbers))
    return mimics


def clean(root: Element) -> list[str]:
    """Remove impossible products of inertia and infinite limits from a URDF; return sentences about the changes."""
    sentences = []
    incomplete_links = [link.get("name", "") for link in root.iter("link") if _zero_products(link)]
    if incomplete_links:
        sentences.append(f"products of inertia of {listed('link', incomplete_links)}: no body can have them")
    for joint in root.iter("joint"):
        limit = joint.find("limit")
        if limit is None:
            continue
        infinite = {end for end in ("lower", "upper", "effort") if _infinite(limit.get(end))}
        if {"lower", "upper"} <= infinite and joint.get("type") == "revolute":
            joint.set("type", "continuous")
        for end in infinite if {"lower", "upper"} <= infinite else infinite - {"lower", "upper"}:
            del limit.attrib[end]
        if "effort" in infinite:
            sentences.append(f"effort of joint {joint.get('name')}: it is infinite, so the joint has no motor")
    return sentences


def _infinite(value: str | None) -> bool:
    try:
        return math.isinf(float(value or 0))
    except ValueError:
        return False


def _zero_products(link: Element) -> bool:
    """Set products of inertia that no body can have to zero in a dummy link; return whether there were any."""
    mass, inertia = link.find("inertial/mass"), link.find("inertial/inertia")
    if mass is None or inertia is None:
        return False
    try:
        light = float(mass.get("value", "")) < DUMMY_MASS_KG
        xx, yy, zz, xy, xz, yz = (float(inertia.get(key, 0)) for key in MOMENTS)
    except ValueError:
        return False
    least_moment = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])[0]
    if not light or least_moment > SINGULAR_INERTIA * max(xx, yy, zz) or min(xx, yy, zz) <= 0:
        return False
    inertia.attrib |= dict.fromkeys(MOMENTS[3:], "0")
    return True
