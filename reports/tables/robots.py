"""Tables of a robot's file: links, motors, contacts, and unsupported features."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from rich.table import Table

from reports.tables.console import number, table_of

MOST_ROWS = 300
"""Maximum number of contacts that are printed."""
_JOINT_UNITS = {"slide": "m", "hinge": "rad"}
"""Mapping from the kind of a joint to the unit of its position."""


def robot_tables(content: Mapping[str, Any]) -> Iterator[tuple[str, Table]]:
    """Yield title and table of the links as a tree, of the motors and of the contacts, if there are any.

    ``content`` is the result of :meth:`problems.robots.Robot.document`.
    """
    depths: dict[str | None, int] = {None: -1}
    rows = []
    for link in content["links"]:
        depth = depths[link["name"]] = depths[link["parent"]] + 1
        limits, unit = link["limits"], _JOINT_UNITS.get(link["joint"], "")
        rows.append(
            (
                f"{'  ' * depth}{link['name']}",
                link["joint"],
                number(link["mass"]),
                "" if limits is None else f"{number(limits[0])} to {number(limits[1])} {unit}",
            )
        )
    yield "Links", table_of("link", "joint", ">kg", "limits", rows=rows)
    if content["motors"]:
        yield (
            "Motors",
            table_of("motor", "link", "kind", ">[N m, N]", "input", rows=list(map(_motor, content["motors"]))),
        )
    if contacts := content["contacts"]:
        yield (
            "Contacts",
            table_of(
                "contact",
                ">friction",
                ">distance at home [m]",
                rows=[
                    (contact["name"], number(contact["friction"]), number(contact["distance"]))
                    for contact in contacts[:MOST_ROWS]
                ],
            ),
        )


def _motor(motor: Mapping[str, Any]) -> tuple[str, ...]:
    low, high = motor["range"]
    ends = " to ".join("no limit" if end is None else number(end) for end in (low, high))
    kind = "gear" if motor["servo"] is None else "servo"
    bounds = "no limit" if low is high is None else ends
    return motor["name"], motor["link"], kind, number(motor[kind]), bounds


def robot_notes(content: Mapping[str, Any]) -> Iterator[str]:
    """Yield sentences on the home pose, and on features of the file that are not used."""
    if n_more := len(content["contacts"][MOST_ROWS:]):
        yield f"{n_more} more contacts: --json lists all."
    home = ", ".join(f"{coordinate['name']} {number(coordinate['home'])}" for coordinate in content["coordinates"])
    yield f"Home: {home}."
    yield from content["notes"]
    if content["ignored"]:
        yield "Not used:"
    for feature in content["ignored"]:
        yield f"- {feature}"
