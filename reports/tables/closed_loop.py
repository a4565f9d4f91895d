"""Arrays and numbers of a closed loop, as stored in a run and printed in reports."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
import xarray as xr
from rich.table import Table

from dynamics.batch import StepFunction
from ocp.judge.contact_report import least_slip
from ocp.judge.step_size import step_size_kind
from ocp.mpc.simulate import ClosedLoop
from ocp.problem.evaluation import Evaluation, at_steps
from ocp.problem.problem import Problem
from ocp.solution import units_of
from reports.tables.console import number, percent, table_of

_WARM = 10
"""Number of samples at the start of each seed that timings exclude, since the first plans start cold."""
_BINS = 12
"""Number of bins of a histogram, at most one more."""
_BAR = 24
"""Length of a histogram's longest bar, in characters."""


def labelled_arrays(loop: ClosedLoop, mismatch: Mapping[str, float]) -> xr.Dataset:
    """Return the arrays of a closed loop, with ``time``, ``lam``, ``gap`` and units added.

    ``time`` (node) is in [s]; ``lam`` and ``gap`` (seed, sample, contact) are multipliers and gaps of the
    exact law at the recorded states and inputs, for the plant's parameters ``mismatch``. ``K`` (gain, input, state)
    and ``k`` (gain, input) are the controller's gains ``u = K x + k`` after the last sample, one row per sample, if
    it has gains.
    """
    problem, system = loop.problem, loop.problem.system
    values = dict(zip(problem.parameters.names, problem.parameters.values, strict=True))
    data = loop.data
    entries, attributes = units_of({"state": system.states, "input": system.inputs, "contact": system.contacts})
    times = Evaluation(problem, values).node_times()
    step = float(times[1] - times[0]) / loop.samples_per_step
    plant_values = {**values, **mismatch}
    if loop.samples_per_step > 1:
        plant_values[step_size_kind(system).parameter] /= loop.samples_per_step
    lam, gap = _contacts(problem, data, plant_values)
    dimensions = ("seed", "sample", "contact")
    data = data.assign(
        {
            "lam": (dimensions, lam, attributes["contact"]),
            "gap": (dimensions, gap, {"units": system.gap_unit}),
            **{f"{name}_unit": (name, units) for name, units in entries.items()},
        }
    ).assign_coords(
        time=("node", step * np.arange(data.sizes["node"]), {"units": "s"}),
        contact=[signal.name for signal in system.contacts],
    )
    kind_of_array = {"x": "state", "measured": "state", "plan": "state", "u": "input"}
    if loop.gains is not None:
        data = data.assign(K=(("gain", "input", "state"), loop.gains.K), k=(("gain", "input"), loop.gains.k))
    units = {**{name: attributes[kind]["units"] for name, kind in kind_of_array.items()}, "seconds": "s"}
    for name, variable in data.data_vars.items():
        variable.attrs.setdefault("units", units.get(str(name), "1"))
    return data


def _contacts(problem: Problem, data: xr.Dataset, values: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """Return multipliers and gaps (S, T, nlam) of the exact law; NaN for steps that were not simulated."""
    step, x, u = problem.exact_step, data["x"].values, data["u"].values
    multipliers_and_gaps = np.full((2, *u.shape[:2], problem.system.nlam), np.nan)
    is_simulated = np.isfinite(x[:, :-1]).all(axis=2) & np.isfinite(u).all(axis=2)
    if not problem.system.nlam:
        return multipliers_and_gaps[0], multipliers_and_gaps[1]
    p = step.p.pack({name: values[name] for name in step.p.names if name in values})
    states, inputs = x[:, :-1][is_simulated], u[is_simulated]
    solved = StepFunction(step, threads=1)(states, inputs, p)
    lam = solved.lam[:, : step.n]
    arguments = (states[None], inputs[None], solved.x_next[None], lam[None])
    gap = at_steps(step.relation, *arguments, p=p)[1][0]
    multipliers_and_gaps[0][is_simulated], multipliers_and_gaps[1][is_simulated] = least_slip(step, lam, gap)
    return multipliers_and_gaps[0], multipliers_and_gaps[1]


def loop_summary(loop: ClosedLoop, data: xr.Dataset, notes: Sequence[str]) -> dict[str, Any]:
    """Return the fields of :class:`~ocp.store.meta.ClosedLoopMeta`, such as ``status`` and ``verdict``.

    Times per sample are compared with the period between samples.
    """
    end_samples, costs, verdict = data["ended"].values, loop.costs, loop.verdict
    statuses, is_complete = data["status"].values, np.isfinite(costs)
    cost_parts = {"stage_cost": loop.stage_costs, "terminal_cost": data["end_cost"].values}
    averages = {"cost": costs, **cost_parts}
    return {
        "status": verdict.status,
        "verdict": str(verdict),
        "costs": costs.tolist(),
        **{name: float(v[is_complete].mean()) if is_complete.any() else np.nan for name, v in averages.items()},
        "cost_interval": list(loop.cost_interval),
        "ended": end_samples.tolist(),
        "survived": float(loop.survived.mean()),
        "diverged": verdict.diverged,
        "planned": verdict.planned,
        "violated": [{**asdict(violated.violation), "share": violated.share} for violated in verdict.violated],
        "seconds": _times(data),
        "statuses": dict(Counter(map(str, statuses[statuses != ""]))),
        "misses": loop.misses,
        "counts": {name: _histogram(data[name].values) for name in ("programs", "qp_iterations")},
        "certified": loop.certified,
        "note_counts": dict(loop.notes),
        "notes": list(notes),
    }


def _times(data: xr.Dataset) -> dict[str, float]:
    """Return percentiles [s] of the time per sample, and the number of samples above the period."""
    seconds = counted_times(data["seconds"].values)
    period = float(data["time"].values[1])
    p50, p99, longest = (float(np.percentile(seconds, q)) if seconds.size else np.nan for q in (50, 99, 100))
    return {
        "p50": p50,
        "p99": p99,
        "max": longest,
        "period": period,
        "samples": seconds.size,
        "over": int((seconds > period).sum()),
    }


def _histogram(counts: np.ndarray) -> dict[str, int]:
    """Return a mapping from each count in ``counts`` (S, T), as text, to its number of samples, smallest first."""
    values, samples = np.unique(counts[np.isfinite(counts)], return_counts=True)
    return {f"{value:.0f}": int(number) for value, number in zip(values, samples, strict=True)}


def counted_times(seconds: np.ndarray) -> np.ndarray:
    """Return the finite times [s] in ``seconds`` (S, T), without the first samples of each seed, which start cold."""
    finite_rows = [row[np.isfinite(row)] for row in seconds]
    return np.concatenate([row[_WARM if len(row) > 2 * _WARM else 1 :] for row in finite_rows])


def rate_sentence(meta: Mapping[str, Any]) -> str:
    """Return a sentence on the number of samples that took longer than the period."""
    times = meta["seconds"]
    count_text = f"{times['over']} of {times['samples']} samples took longer than"
    return f"{count_text} the period of {_ms(times['period'])} ms."


def loop_notes(meta: Mapping[str, Any]) -> Iterator[str]:
    """Yield sentences on rate and deadline, and notes of the controller with the number of samples of each."""
    if meta["seconds"]["over"]:
        yield rate_sentence(meta)
    if meta["misses"]:
        late = meta["misses"]
        yield f"{late} of the answers came after the deadline; the input of the previous plan was used."
    for text, count in sorted(meta["note_counts"].items(), key=lambda row: -row[1]):
        yield f"{text} ({count} sample{'' if count == 1 else 's'})"


def loop_rows(meta: Mapping[str, Any]) -> list[list[str]]:
    """Return rows of name and value on a closed loop, as text."""
    times, (low, high) = meta["seconds"], meta["cost_interval"]
    interval = "–" if low is None else f"{number(low, 5)} to {number(high, 5)}"
    return [
        ["cost, mean over seeds", number(meta["cost"], 7)],
        ["95 % interval", interval],
        ["of it stage costs", number(meta.get("stage_cost"), 7)],
        ["of it terminal cost", number(meta.get("terminal_cost"), 7)],
        ["seeds that reached the end", percent(meta["survived"])],
        ["samples with a new plan", percent(meta.get("planned"))],
        ["time of a sample, p50 [ms]", _ms(times["p50"])],
        ["p99 [ms]", _ms(times["p99"])],
        ["largest [ms]", _ms(times["max"])],
        ["period [ms]", _ms(times["period"])],
        ["longer than the period", f"{times['over']} of {times['samples']}"],
        ["missed deadlines", str(meta["misses"])],
        *([name, str(count)] for name, count in meta["statuses"].items()),
        ["plans judged stationary", percent(meta["certified"])],
    ]


def loop_table(meta: Mapping[str, Any]) -> Table:
    """Return the rows of :func:`loop_rows` as a table."""
    return table_of("", ">", rows=loop_rows(meta), header=False)


def count_table(counts: Mapping[str, Mapping[str, int]]) -> Table:
    """Return a histogram of quadratic programs and of their iterations per sample."""
    table = table_of("per sample", ">count", ">samples", "")
    for name, title in (("programs", "quadratic programs"), ("qp_iterations", "their iterations")):
        samples = {int(count): n_samples for count, n_samples in counts[name].items()}
        width = 1 + (max(samples, default=0) - min(samples, default=0)) // _BINS
        bins = Counter[int]()
        for count, n_samples in samples.items():
            bins[(count - min(samples)) // width] += n_samples
        for i, n_samples in sorted(bins.items()):
            first = min(samples) + i * width
            label = f"{first}" if width == 1 else f"{first}–{first + width - 1}"
            bar = "█" * round(_BAR * n_samples / max(bins.values()))
            table.add_row(title, label, str(n_samples), bar)
            title = ""
    return table


def _ms(seconds: float | None) -> str:
    return "–" if seconds is None else number(1e3 * seconds, 3)
