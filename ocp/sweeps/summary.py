"""What a sweep comes to: counts, the best point, the failed ones by name, and a run's description.

Also what ``ocp sweep --json`` prints of each point.
"""

from __future__ import annotations

import itertools
import shlex
from typing import TYPE_CHECKING, Any

import numpy as np

from ocp.judgement import record
from ocp.session import Session
from ocp.sweeps.grid import Grid, dimension
from ocp.sweeps.job import COUNTS, NUMBERS, WORDS

if TYPE_CHECKING:
    import xarray as xr

KIND = "sweep"
"""Kind of a stored run."""


def run_meta(study: Grid, session: Session, data: xr.Dataset) -> dict[str, Any]:
    """What a run's description has of a study, but for ``argv`` and where the problem is from."""
    found, dims = rows(data), [dimension(axis.name) for axis in study.axes]
    solved = sum(row["success"] for row in found)
    failures = [
        {
            "at": {dim: row[dim] for dim in dims},
            "status": row["status"],
            "verdict": row["verdict"],
            "command": shlex.join(
                study.job(place).case.command(study.seed, study.starts, study.rank)
            ),
        }
        for place, row in zip(study.places, found, strict=True) if not row["success"]
    ]  # fmt: skip
    axes = [
        {"name": dim, "full_name": axis.name, "values": list(axis.values), "log": axis.log,
         "units": data[dim].attrs["units"]}
        for dim, axis in zip(dims, study.axes, strict=True)
    ]  # fmt: skip
    whole = solved == len(found)
    return {
        "kind": KIND,
        "seed": study.seed,
        "record": _shared_record(study, session),
        "source_digest": session.problem.source_digest,
        "over": ", ".join(dims),
        "study": {"axes": axes, "shape": list(study.shape), "failed": failures},
        "solved": solved,
        "points": len(found),
        "survives": sum(row["survives"] == 1 for row in found),
        "status": "solved" if whole else f"{solved} of {len(found)} solved",
        "success": whole,
        "verdict": verdict(found, dims),
    }


def _shared_record(study: Grid, session: Session) -> dict[str, Any]:
    """What was asked and is the same at all points."""
    told = record(session, study.seed)
    swept = {axis.name for axis in study.axes}
    groups = {"params": "problem.", "contact_settings": "contact.", "law_parameters": "",
              "solver_options": "setting.", "policy_settings": "policy."}  # fmt: skip
    for group, head in groups.items():
        told[group] = {k: v for k, v in told[group].items() if f"{head}{k}" not in swept}
    if "problem.N" in swept:
        del told["N"]
    ranked = {"rank": study.rank} if study.starts > 1 else {}
    return {**told, "starts": study.starts, **ranked}


def rows(data: xr.Dataset) -> list[dict[str, Any]]:
    """Every point: its coordinates and what it came to, the last axis fastest."""
    dims = [str(dim) for dim in data["cost"].dims]
    names = (*NUMBERS, "seconds", *COUNTS, *WORDS)
    columns = {name: np.asarray(data[name].values).ravel().tolist() for name in names}
    places = itertools.product(*(data[dim].values.tolist() for dim in dims))
    return [
        {**dict(zip(dims, place, strict=True)), **{name: columns[name][i] for name in names}}
        for i, place in enumerate(places)
    ]


def verdict(found: list[dict[str, Any]], dims: list[str]) -> str:
    """Counts, and the cheapest and the dearest of the solved points; then what failed, a line each.

    Of the failed points a few are told.
    """
    solved = [row for row in found if row["success"]]
    judged = [row for row in solved if row["survives"] >= 0]
    count = "All" if len(solved) == len(found) else f"{len(solved)} of"
    told = f"{count} {len(found)} points are solved"
    if judged:
        survive = sum(row["survives"] for row in judged)
        words = {0: "none survives", 1: "one survives", len(solved): "all survive"}
        told += f", {words.get(survive, f'{survive} survive')} the referee"
    if solved:
        low, high = (pick(solved, key=lambda row: row["cost"]) for pick in (min, max))
        ends = [f"{row['cost']:.6g}" for row in (low, high)]
        told += (
            f"; cost {ends[0]}"
            if ends[0] == ends[1]
            else (
                f"; cost from {ends[0]} at {where(low, dims)} to {ends[1]} at {where(high, dims)}"
            )
        )
    failures = [row for row in found if not row["success"]]
    lines = [f"{where(row, dims)}: {_first(row['verdict'])}" for row in failures[:_TOLD]]
    if len(failures) > _TOLD:
        lines.append(f"and {len(failures) - _TOLD} more that failed")
    return "\n".join([f"{told}.", *lines])


_TOLD = 5


def where(row: dict[str, Any], dims: list[str]) -> str:
    """Coordinates of a point in words: ``M = 0.5, contact.mu = 0.001``."""
    return ", ".join(f"{dim} = {row[dim]:g}" for dim in dims)


def _first(text: str) -> str:
    return text.partition("\n")[0]
