"""Pages of sweeps and of gradient estimates."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from matplotlib.figure import Figure

from ocp.errors import InputError
from ocp.gradients.sweep import SAMPLING_AXES
from ocp.gradients.verdict import TOO_WIDE, short_verdict, weakest_verdict
from ocp.jobs.sweep_record import grid_rows
from ocp.store.stored_run import StoredRun
from problems.plugin import spec_of
from problems.registry import ObjectiveSpec, objective_names, objective_spec
from problems.spec import ProblemSpec
from reports.documents.common import Page, law_summary, law_text, page_header, request_rows, run_summary
from reports.drawing.notation import label, symbol
from reports.drawing.view import RunView
from reports.figures import sweep as drawn
from reports.tables.console import number
from reports.tables.listings import MAX_ROWS, POINT_HEADS, estimate_cells, format_duration, point_rows


def sweep_page(view: RunView) -> Page:
    """Return content and figures of the page on a sweep; tables of parameters and settings omit swept values."""
    swept, common = {axis["name"] for axis in view.run.meta["study"]["axes"]}, page_header(view)
    varied = {name.removeprefix("problem.") for name in swept}
    parameters = {row[0] for row in common["parameters"]}
    common["parameters"] = [row for row in common["parameters"] if row[0] not in varied]
    common["settings"] = [row for row in common["settings"] if row[0] not in swept - parameters]
    common["request"] = request_rows(view.run, swept)
    content, figures = sweep_content(view.run)
    return {**common, "law": law_summary(view), **content}, figures


def sweep_content(run: StoredRun) -> tuple[dict[str, Any], dict[str, Figure]]:
    """Return key numbers, axes, points and failures of a sweep as content of a page, and its figures."""
    meta, axes = run.meta, run.meta["study"]["axes"]
    dims, points = [axis["name"] for axis in axes], grid_rows(run.data)
    figures = drawn.sweep_figures(run.data, axes)
    grade = "survives" if meta["survives"] == meta["points"] else "certified"
    names = [f"map-{k + 1}" for k in range(len(figures))]
    content = {
        "grade": grade if meta["success"] else "failed",
        "key": [
            ["points", " × ".join(map(str, meta["study"]["shape"]))],
            ["solved", str(meta["solved"])],
            ["surviving the referee", str(meta["survives"])],
            ["total iterations", str(sum(row["iterations"] for row in points))],
            ["work", format_duration(sum(row["seconds"] for row in points))],
        ],
        "axes": [
            [
                axis["name"],
                number(axis["values"][0]),
                number(axis["values"][-1]),
                str(len(axis["values"])),
                "equal ratios" if axis["log"] else "equal steps",
            ]
            for axis in axes
        ],
        "maps": names,
        "caption": drawn.sweep_caption(axes),
        "heads": [*dims, *POINT_HEADS],
        "points": point_rows(points, dims),
        "more": max(0, len(points) - MAX_ROWS),
        "failed": [
            [failure["command"], failure["verdict"].partition("\n")[0]]
            for failure in meta["study"]["failed"][:MAX_ROWS]
        ],
    }
    return content, dict(zip(names, figures, strict=True))


_GRADES = {
    "unbiased within the interval": "survives",
    "no reference": "certified",
    TOO_WIDE: "certified",
    "empirically biased at this sample size": "failed",
    "biased": "failed",
}
"""Mapping from the weakest verdict of estimates to the grade that determines the colour of their page."""


def estimate_page(run: StoredRun, file_spec: ProblemSpec | None = None) -> Page:
    """Return content and figure of the page on an estimate; ``file_spec`` is the problem of a user's file."""
    meta, swept = run.meta, run.meta["sweep"]
    spec = _spec(run, file_spec)
    rows = meta["estimates"]
    content = run_summary(run, spec, run.record["params"])
    # For rollouts sigma and samples belong to the noise; the problem may have parameters of the same name.
    noise = swept and swept["name"] in SAMPLING_AXES and run.record.get("contact")
    varied = swept["name"].removeprefix("problem.") if swept and not noise else ""
    parameters = [row for row in content["parameters"] if row[0] != varied]
    content |= {
        "title": f"Gradient of {meta['problem']}",
        "verdict": f"{weakest_sentence(rows)}\n{meta['verdict']}",
        "grade": _GRADES[weakest_verdict(rows)],
        "request": _estimate_request(run),
        "parameters": parameters,
        "settings": [row for row in content["settings"] if row[0] not in _REQUEST_SETTINGS],
        "caption": drawn.estimate_caption(run),
        "swept": label(symbol(swept["name"]), swept["unit"]) if swept else "",
        "rows": [estimate_cells(row, bool(swept)) for row in rows],
        "explanations": [] if swept else [f"{r['estimator']}: {r['explanation']}" for r in rows],
    }
    return content, {"estimate": drawn.estimate_figure(run)}


def _spec(run: StoredRun, file_spec: ProblemSpec | None) -> ObjectiveSpec | ProblemSpec | None:
    name = run.meta["problem"]
    try:
        return objective_spec(name) if name in objective_names() else spec_of(run, file_spec)
    except InputError:
        return None


_REQUEST_SETTINGS = ("estimators", "reference", "reference samples", "samples", "sigma")
"""Settings of an estimate that are in the rows on its request."""


def weakest_sentence(rows: Sequence[dict[str, Any]]) -> str:
    """Return a sentence on the weakest verdict among estimates, and the estimators with this verdict."""
    verdict = weakest_verdict(rows)
    estimators = list(dict.fromkeys(row["estimator"] for row in rows if short_verdict(row) == verdict))
    if all(short_verdict(row) == verdict for row in rows):
        return f"Every estimate: {verdict}."
    count = sum(short_verdict(row) == verdict for row in rows)
    return f"Weakest verdict: {verdict}, {count} of {len(rows)} estimates ({', '.join(estimators)})."


def _estimate_request(run: StoredRun) -> list[list[str]]:
    """Return rows on an estimate's law, policy, reference with its source, noise and samples."""
    record, swept = run.record, run.meta["sweep"]
    sources = dict.fromkeys(row["reference_source"] for row in run.meta["estimates"])
    reference = ", ".join(filter(None, sources)) or "none"
    if "zobg" in reference:
        reference += f" ({number(record['reference_samples'])} samples)"
    request_lines = [["law", law_text(run) if record.get("contact") else "none (static objective)"]]
    if record.get("policy"):
        request_lines.append(["policy", str(record["policy"])])
    request_lines.append(["reference", reference])
    constant = (name for name in ("sigma", "samples") if not swept or swept["name"] != name)
    request_lines += [[symbol(name), number(record[name])] for name in constant]
    if swept:
        ends = (number(swept["values"][index], 4) for index in (0, -1))
        request_lines.append([symbol(swept["name"]), " to ".join(ends)])
    return request_lines
