"""Record of a sweep: the description of its run, a row for each point, and a verdict on all points."""

from __future__ import annotations

import itertools
import shlex
from typing import TYPE_CHECKING, Any

import numpy as np

from ocp.jobs.grid import Grid, dimension_name
from ocp.jobs.sweep_job import ROW_COUNTS, ROW_NUMBERS, ROW_TEXTS
from ocp.routes.session import Session
from ocp.solve.judging import session_record

if TYPE_CHECKING:
    import xarray as xr

SWEEP_KIND = "sweep"
"""Value of ``kind`` in the description of a stored run that is a sweep."""
MAX_LISTED = 5
"""Maximum number of outliers, and of failed points, that a verdict lists."""


def run_meta(study: Grid, session: Session, data: xr.Dataset) -> dict[str, Any]:
    """Return the description (``meta.json``) of a sweep's run, without ``argv`` and the problem's origin."""
    rows, dims = grid_rows(data), [dimension_name(axis.name) for axis in study.axes]
    solved = sum(row["success"] for row in rows)
    failures = [
        {
            "at": {dim: row[dim] for dim in dims},
            "status": row["status"],
            "verdict": row["verdict"],
            "command": shlex.join(study.job(values).request.command(study.seed, study.starts, study.rank)),
        }
        for values, row in zip(study.point_values, rows, strict=True)
        if not row["success"]
    ]
    axes = [
        {
            "name": dim,
            "full_name": axis.name,
            "values": list(axis.values),
            "log": axis.log,
            "units": data[dim].attrs["units"],
        }
        for dim, axis in zip(dims, study.axes, strict=True)
    ]
    all_solved = solved == len(rows)
    return {
        "kind": SWEEP_KIND,
        "seed": study.seed,
        "record": _shared_record(study, session),
        "source_digest": session.problem.origin.source_digest,
        "over": ", ".join(dims),
        "study": {"axes": axes, "shape": list(study.shape), "failed": failures},
        "solved": solved,
        "points": len(rows),
        "survives": sum(row["survives"] == 1 for row in rows),
        "status": "solved" if all_solved else f"{solved} of {len(rows)} solved",
        "success": all_solved,
        "verdict": summarise_points(rows, dims),
    }


def _shared_record(study: Grid, session: Session) -> dict[str, Any]:
    """Return the part of the request that is the same for all points, without the swept values."""
    shared = session_record(session, study.seed)
    swept = {axis.name for axis in study.axes}
    groups = {
        "params": "problem.",
        "contact_settings": "contact.",
        "law_parameters": "",
        "solver_options": "setting.",
        "policy_settings": "policy.",
    }
    for group, prefix in groups.items():
        shared[group] = {k: v for k, v in shared[group].items() if f"{prefix}{k}" not in swept}
    if "problem.N" in swept:
        del shared["N"]
    ranked = {"rank": study.rank} if study.starts > 1 else {}
    return {**shared, "starts": study.starts, **ranked}


def grid_rows(data: xr.Dataset) -> list[dict[str, Any]]:
    """Return a row of coordinates and results for each point of a sweep's dataset; the last axis varies fastest."""
    dims = [str(dim) for dim in data["cost"].dims]
    names = (*ROW_NUMBERS, "seconds", *ROW_COUNTS, *ROW_TEXTS)
    count = data["cost"].size
    columns = {name: np.asarray(data[name].values).ravel().tolist() if name in data else [""] * count for name in names}
    points = itertools.product(*(data[dim].values.tolist() for dim in dims))
    return [
        {**dict(zip(dims, point, strict=True)), **{name: columns[name][i] for name in names}}
        for i, point in enumerate(points)
    ]


def summarise_points(rows: list[dict[str, Any]], dims: list[str]) -> str:
    """Return a sentence with counts and lowest and highest cost, then lines on some outliers and failures."""
    solved = [row for row in rows if row["success"]]
    refereed = [row for row in solved if row["survives"] >= 0]
    count = "All" if len(solved) == len(rows) else f"{len(solved)} of"
    sentence = f"{count} {len(rows)} points are solved"
    if refereed:
        survive = sum(row["survives"] for row in refereed)
        counts = {0: "none survives", 1: "one survives", len(solved): "all survive"}
        sentence += f", {counts.get(survive, f'{survive} survive')} the referee"
    if solved:
        cheapest, dearest = (pick(solved, key=lambda row: row["cost"]) for pick in (min, max))
        costs = [f"{row['cost']:.6g}" for row in (cheapest, dearest)]
        span = f"from {costs[0]} at {describe_point(cheapest, dims)} to {costs[1]} at {describe_point(dearest, dims)}"
        sentence += f"; cost {costs[0] if costs[0] == costs[1] else span}"
    failures, outliers = ([row for row in rows if not row["success"]], [row for row in rows if row.get("start")])
    left_outliers = [row for row in rows if row.get("outlier")]
    lines = [
        f"outlier {describe_point(row, dims)}: {row['own_cost']:.6g} alone,"
        f" {row['cost']:.6g} from the plan at {row['start']}"
        for row in outliers[:MAX_LISTED]
    ]
    lines += [
        f"outlier {describe_point(row, dims)}: {row['cost']:.6g}, although a neighbour's plan costs"
        f" {row['neighbour_cost']:.6g} there"
        for row in left_outliers[:MAX_LISTED]
    ]
    lines += [f"{describe_point(row, dims)}: {row['verdict']}".partition("\n")[0] for row in failures[:MAX_LISTED]]
    if len(failures) > MAX_LISTED:
        lines.append(f"and {len(failures) - MAX_LISTED} more that failed")
    return "\n".join([f"{sentence}.", *lines])


def describe_point(row: dict[str, Any], dims: list[str]) -> str:
    """Return the coordinates of a point as text, such as ``M = 0.5, contact.mu = 0.001``."""
    return ", ".join(f"{dim} = {row[dim]:g}" for dim in dims)
