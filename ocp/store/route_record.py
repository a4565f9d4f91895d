"""Conversion of a route's report to and from entries of a run's record."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, fields
from typing import Any

from ocp.judge.route_report import RouteReport
from ocp.solution import Solution
from ocp.store.json_values import from_json

_STORED_KEYS = {"name": "route", "started_from": "from", "refinement": "refined"}
"""Mapping from fields of a route's report to their keys in a record, for those that differ."""
_RECORDED = {
    field.name: _STORED_KEYS.get(field.name, field.name) for field in fields(RouteReport) if field.name != "attempts"
}
"""Mapping from fields of a route's report to their keys in a record; attempts are stored outside the record."""


ADDED = {"unbounded": "unbounded", "simulator": "world", "sensitivities": "sensitivities"}
"""Mapping from fields of a solution to their keys in a record, for fields that are not part of the request."""


def record_of(solution: Solution) -> dict[str, Any]:
    """Return the record of a solution's run: the request, the route that led to the solution, and further results."""
    added = {key: getattr(solution, name) for name, key in ADDED.items()}
    added = {key: entry for key, entry in added.items() if key == "unbounded" or entry}
    return {**solution.record, **route_to_record(solution.route), **added}


def route_to_record(route: RouteReport) -> dict[str, Any]:
    """Return the record's entries for a route: all values that differ from their defaults.

    If the route started from a stored solution, ``resumed`` and ``swept`` are always included.
    """
    values, defaults = asdict(route), asdict(RouteReport())
    warm = ("resumed", "swept") if route.started_from is not None else ()
    return {key: values[name] for name, key in _RECORDED.items() if name in warm or values[name] != defaults[name]}


def route_from_record(record: Mapping[str, Any], attempts: Any) -> tuple[RouteReport, dict[str, Any]]:
    """Split a run's record into its route's report, with ``attempts`` added, and the remaining entries.

    Raises ``ValueError`` for an entry of the wrong type.
    """
    entries = {name: record[key] for name, key in _RECORDED.items() if key in record}
    other_entries = {key: entry for key, entry in record.items() if key not in _RECORDED.values()}
    return from_json(RouteReport, {**entries, "attempts": attempts}), other_entries
