"""List of the classes and functions for problem files with their signatures, which a tutorial includes."""

from __future__ import annotations

import inspect
from typing import Any

from docs.generator.roles import cleaned
from dynamics import systems
from dynamics.systems.shapes import Contact
from ocp.problem import free_time, problem
from problems import drawing, parameters, scenes

PARTS: dict[str, tuple[Any, ...]] = {
    "Shapes": (scenes.Disc, scenes.Box, scenes.Capsule, scenes.Polygon, scenes.HalfPlane, scenes.Union),
    "Scenes": (
        scenes.Body,
        scenes.Pusher,
        scenes.Obstacle,
        scenes.Goal,
        scenes.Scene,
        scenes.Scene.quasi_dynamic,
        scenes.Scene.time_stepping,
        scenes.drawing_functions,
    ),
    "Machines": (systems.Link, systems.Sphere, systems.Part, systems.Machine, systems.Machine.system),
    "Contacts by hand": (systems.signals, systems.time_stepping, systems.quasi_dynamic, Contact.between),
    "Costs, constraints and start": (
        problem.Problem,
        problem.Constraint,
        problem.FreeStart,
        free_time.free,
        problem.Scaling,
        problem.Scenarios,
    ),
    "Parameters": (parameters.quantity, parameters.structure, parameters.choice, parameters.table),
    "Drawing by hand": (drawing.Mark, drawing.Segment, drawing.Spring, drawing.ContactFrame),
}
"""Mapping from a group's title to the classes and functions that problem files use."""
_INNER = {"self", "origin"}
"""Arguments that users never pass, and that are left out."""


def pages() -> dict[str, str]:
    """Return the page that lists all groups, as a mapping from path to text."""
    groups = (f"### {title}\n\n{''.join(map(_item, members))}" for title, members in PARTS.items())
    return {"signatures/parts.md": "\n".join(groups)}


def _item(member: Any) -> str:
    """Return a list item with names and defaults of arguments, and the docstring's first paragraph."""
    arguments = inspect.signature(member).parameters.values()
    argument_texts = ", ".join(_argument(p) for p in arguments if p.name not in _INNER)
    return f"- `{member.__qualname__}({argument_texts})`: {cleaned(inspect.getdoc(member))}\n"


def _argument(argument: inspect.Parameter) -> str:
    text = str(argument.replace(annotation=argument.empty))
    return text if "<" not in text and len(text) < 40 else f"{argument.name}=..."
