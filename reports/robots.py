"""A robot's file as tables: links, motors, contacts, and what is not used."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from rich.table import Table

from reports.console import number, table_of

_UNITS = {"slide": "m", "hinge": "rad"}


def tables(content: Mapping[str, Any]) -> Iterator[tuple[str, Table]]:
    """Title and table of the links as a tree, the motors and the contacts, where there are any.

    ``content`` is what :meth:`problems.robots.Robot.document` gives.
    """
    depths: dict[str, int] = {"world": -1}
    rows, space = [], isinstance(content["links"][0]["inertia"], list)
    for link in content["links"]:
        depth = depths[link["name"]] = depths[link["parent"]] + 1
        limits, unit = link["limits"], _UNITS.get(link["joint"], "")
        keys = () if space else ("inertia", "spring", "damping", "armature")
        rows.append((
            f"{'  ' * depth}{link['name']}", link["joint"], number(link["mass"]),
            *(number(link[key]) for key in keys),
            "" if limits is None else f"{number(limits[0])} to {number(limits[1])} {unit}",
        ))  # fmt: skip
    more = () if space else (">kg m²", ">spring", ">damping", ">armature")
    yield "Links", table_of("link", "joint", ">kg", *more, "limits", rows=rows)
    if content["motors"]:
        yield "Motors", table_of(
            "motor", "link", ">gear [N m, N]", "input",
            rows=[(one["name"], one["link"], number(one["gear"]), _range(one))
                  for one in content["motors"]],
        )  # fmt: skip
    if content["contacts"]:
        yield "Contacts", table_of(
            "contact", ">friction", ">distance at home [m]",
            rows=[(one["name"], number(one["friction"]), number(one["distance"]))
                  for one in content["contacts"]],
        )  # fmt: skip


def _range(motor: Mapping[str, Any]) -> str:
    least, most = motor["least"], motor["most"]
    return "no limit" if least is None else f"{number(least)} to {number(most)}"


def lines(content: Mapping[str, Any]) -> Iterator[str]:
    """Coordinates that count against the file's, home, and what of the file is not used."""
    turned = [one["joint"] for one in content["coordinates"] if one["sign"] < 0]
    if turned:
        yield f"Counted the other way round: {', '.join(turned)}."
    shifted = [f"{one['joint']} from {number(one['rest'])}" for one in content["coordinates"]
               if one["rest"]]  # fmt: skip
    if shifted:
        yield f"Counted from where the spring rests: {', '.join(shifted)}."
    home = ", ".join(f"{one['name']} {number(one['home'])}" for one in content["coordinates"])
    yield f"Home: {home}."
    yield from content["notes"]
    if content["ignored"]:
        yield "Not used:"
    for told in content["ignored"]:
        yield f"- {told}"
