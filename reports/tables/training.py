"""Tables, sentences and JSON on stored training runs and on episodes of a policy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from rich.table import Table

from ocp.learning.training import PolicyEvaluation
from ocp.problem.task import Task
from ocp.store.stored_run import StoredRun
from reports.tables.console import number, percent, table_of, value_text

_EVALUATION_PREFIX = "evaluation_"
"""Prefix of the arrays of a training run that are from evaluations of its policy."""


def training_meta(data: xr.Dataset) -> dict[str, Any]:
    """Return the outcome of a training run as fields of its metadata."""
    best, evaluations = int(data["best_iteration"]), evaluation_rows(data)
    first, last = evaluations[0], evaluations[-1]
    best_row = next(row for row in evaluations if row["iteration"] == best)
    text = (
        f"Return under the exact law {number(best_row['return'], 4)} after iteration {best} of"
        f" {last['iteration']}; {number(first['return'], 4)} untrained"
    )
    text += "".join(f", {name} {number(best_row[name], 3)}" for name in measure_names(best_row))
    return {
        "kind": "train",
        "status": "done",
        "verdict": f"{text}.",
        "return": best_row["return"],
        "evaluation": best_row,
        "untrained": first,
        "last": last,
        "best_iteration": best,
        "env_steps": float(data["env_steps"][-1]),
        "wall_s": float(data["wall_s"][-1]),
    }


def evaluation_rows(data: xr.Dataset) -> list[dict[str, Any]]:
    """Return a row per evaluated iteration: return, length and measures of the policy."""
    names = [str(name) for name in data.data_vars if str(name).startswith(_EVALUATION_PREFIX)]
    evaluated = np.flatnonzero(np.isfinite(data[f"{_EVALUATION_PREFIX}return"].values))
    return [
        {
            "iteration": int(data["iteration"][i]),
            **{name.removeprefix(_EVALUATION_PREFIX): float(data[name][i]) for name in names},
        }
        for i in evaluated
    ]


def measure_names(row: Mapping[str, Any]) -> list[str]:
    """Return the keys of an evaluation's row that are measures of the task, such as a speed."""
    common = ("iteration", "return", "return_deviation", "length", "unsolved")
    return [name for name in row if name not in common]


@dataclass(frozen=True)
class SeedGroup:
    """Runs that differ only in their seeds, with a label that distinguishes them from other groups."""

    label: str
    runs: list[StoredRun]

    @property
    def returns(self) -> np.ndarray:
        """Returns (n_runs,) of the runs' policies under the exact law."""
        return np.array([run.meta["return"] for run in self.runs], dtype=float)

    @property
    def best(self) -> StoredRun:
        """The run with the largest return."""
        return self.runs[int(np.argmax(self.returns))]


def group_seeds(runs: Sequence[StoredRun]) -> list[SeedGroup]:
    """Return groups of runs with equal requests, in the order of the first run of each."""
    requests = [_flat(run) for run in runs]
    order: dict[str, list[int]] = {}
    for index, request in enumerate(requests):
        order.setdefault(repr(sorted(request.items())), []).append(index)
    firsts = [requests[indices[0]] for indices in order.values()]
    return [
        SeedGroup(_label(requests[indices[0]], firsts), [runs[index] for index in indices])
        for indices in order.values()
    ]


def _flat(run: StoredRun) -> dict[str, Any]:
    request = dict(run.record)
    algorithm_settings = run.record["algorithm_settings"]
    # Clipped gradients bias the estimate.
    clipped = algorithm_settings.get("clip", algorithm_settings.get("of.clip")) is not None
    request["algorithm"] = f"{algorithm_of(run)}{', gradients clipped' if clipped else ''}"
    for kind in ("params", "algorithm_settings", "contact_settings"):
        request |= {f"{kind}.{name}": value for name, value in request.pop(kind, {}).items()}
    return request


def algorithm_of(run: StoredRun) -> str:
    """Return the algorithm's name, followed by ``with psi`` if physical parameters are learned."""
    inner = run.record["algorithm_settings"].get("of")
    return f"{inner} with psi" if inner else str(run.record["algorithm"])


def _label(request: Mapping[str, Any], firsts: Sequence[Mapping[str, Any]]) -> str:
    """Return a label with the algorithm, and with the law and other settings if they differ between groups."""
    laws = {compared["contact"] for compared in firsts}
    name = f"{request['algorithm']} {request['contact']}" if len(laws) > 1 else request["algorithm"]
    shared_pair = [request["algorithm"], request["contact"]]
    alike = [compared for compared in firsts if [compared["algorithm"], compared["contact"]] == shared_pair]
    differing_keys = [key for key in request if any(compared.get(key) != request[key] for compared in alike)]
    return ", ".join([name, *(f"{key.rpartition('.')[2]} = {value_text(request[key], 3)}" for key in differing_keys)])


def group_verdict(group: SeedGroup) -> str:
    """Return a sentence on a group: mean and range of the return over its seeds, and mean measures."""
    if len(group.runs) == 1:
        text = str(group.runs[0].meta["verdict"])
        return f"{group.label}: {text[:1].lower()}{text[1:]}"
    returns, first = group.returns, group.runs[0].meta["evaluation"]
    text = (
        f"{group.label}: return under the exact law {number(returns.mean(), 4)}, from"
        f" {number(returns.min(), 4)} to {number(returns.max(), 4)} over {len(returns)} seeds"
    )
    for name in measure_names(first):
        values = [run.meta["evaluation"][name] for run in group.runs]
        text += f", {name} {number(float(np.mean(values)), 3)}"
    return f"{text}."


def training_document(seed_groups: Sequence[SeedGroup]) -> dict[str, Any]:
    """Return the JSON of ``ocp train``: ``runs``, and ``groups`` of seeds with their returns."""
    keys = (
        "return",
        "evaluation",
        "untrained",
        "last",
        "best_iteration",
        "env_steps",
        "wall_s",
        "verdict",
        "seed",
        "hash",
    )
    return {
        "groups": [
            {
                "label": group.label,
                "verdict": group_verdict(group),
                "returns": group.returns,
                "return_mean": group.returns.mean(),
            }
            for group in seed_groups
        ],
        "runs": [
            {"run": str(run.path), "algorithm": algorithm_of(run), **{key: run.meta.get(key) for key in keys}}
            for group in seed_groups
            for run in group.runs
        ],
    }


def summary_rows(seed_groups: Sequence[SeedGroup]) -> tuple[list[str], list[list[str]]]:
    """Return column titles, and a row of cells per run."""
    names = measure_names(seed_groups[0].runs[0].meta["evaluation"]) if seed_groups else []
    units = {name: seed_groups[0].runs[0].data[_EVALUATION_PREFIX + name].attrs.get("units", "") for name in names}
    heads = [
        "",
        "seed",
        "untrained",
        "return",
        "best at",
        *(f"{name}, {units[name]}" for name in names),
        "steps",
        "time, s",
    ]
    cells = []
    for group in seed_groups:
        for run in group.runs:
            description = run.meta
            cells.append(
                [
                    group.label,
                    str(description["seed"]),
                    number(description["untrained"]["return"], 4),
                    number(description["return"], 4),
                    str(description["best_iteration"]),
                    *(number(description["evaluation"][name], 3) for name in names),
                    f"{description['env_steps']:.3g}",
                    f"{description['wall_s']:.1f}",
                ]
            )
    return heads, cells


def summary_table(runs: Sequence[StoredRun]) -> Table:
    """Return a table of training runs, one row per run."""
    heads, cells = summary_rows(group_seeds(runs))
    return table_of(heads[0], *(f">{head}" for head in heads[1:]), rows=cells)


_CONFIDENCE = 0.95
"""Confidence level of the intervals of means."""
_SHARE_TITLES = {"fallen": "episodes ended", "lost": "episodes lost", "unsolved": "steps unsolved"}
"""Mapping from fractions of episodes or steps to their titles in tables."""


def evaluation_summary(task: Task, evaluation: PolicyEvaluation) -> dict[str, Any]:
    """Return mean, 95 % confidence interval, minimum and maximum of return, length and measures.

    ``fallen`` is the fraction of episodes that the task ended before its horizon, ``lost`` the fraction that ended
    because the contact law had no solution, and ``unsolved`` the fraction of steps without a solution.
    """
    lost = {int(sample) for sample in np.asarray(evaluation.unsolved).reshape(-1, 2)[:, 0]}
    ended_early = [n for n, length in enumerate(evaluation.lengths) if length < task.horizon and n not in lost]
    steps = max(float(np.sum(evaluation.lengths)), 1.0)
    units = {measure.signal.name: measure.signal.unit for measure in task.measures}
    return {
        "episodes": len(evaluation.returns),
        "horizon": task.horizon,
        "return": _spread(evaluation.returns, "1"),
        "length": _spread(evaluation.lengths, "1"),
        "measures": {name: _spread(values, units.get(name, "1")) for name, values in evaluation.measures.items()},
        "fallen": len(ended_early) / len(evaluation.returns),
        "lost": len(lost) / len(evaluation.returns),
        "unsolved": len(evaluation.unsolved) / steps,
    }


def _spread(values: np.ndarray, unit: str) -> dict[str, Any]:
    """Return mean, its Student's t interval (None for a single episode), minimum, maximum and unit."""
    from scipy.special import stdtrit

    values = np.asarray(values, dtype=float)
    n, mean = len(values), float(np.mean(values))
    interval = None
    if n > 1:
        half_width = stdtrit(n - 1, (1 + _CONFIDENCE) / 2) * values.std(ddof=1) / np.sqrt(n)
        interval = [mean - float(half_width), mean + float(half_width)]
    return {"mean": mean, "interval": interval, "least": float(values.min()), "most": float(values.max()), "unit": unit}


def evaluation_sentence(judged: Mapping[str, Any]) -> str:
    """Return a sentence with the return of the evaluated policy, its return in training, and the failures."""
    returns, training_row = judged["return"], judged["own"]
    count_text = "1 episode" if judged["episodes"] == 1 else f"{judged['episodes']} episodes"
    head = f"Return {number(returns['mean'], 4)}{_interval(returns)} under the {judged['contact']} law"
    clauses = [f"{head} over {count_text}; in training it was {number(training_row['return'], 4)}"]
    if judged["fallen"]:
        clauses.append(f"{percent(judged['fallen'])} of episodes end early")
    if judged["unsolved"]:
        clauses.append(
            f"contacts were not solved at {percent(judged['unsolved'])} of steps, where"
            f" {percent(judged['lost'])} of episodes end"
        )
    return f"{'; '.join(clauses)}."


def _interval(spread: Mapping[str, Any]) -> str:
    if spread["interval"] is None:
        return ""
    low, high = (number(end, 4) for end in spread["interval"])
    return f" [{low}, {high}]"


def evaluation_table(judged: Mapping[str, Any]) -> Table:
    """Return a table of return, length, measures and fractions, next to their values in training."""
    training_row = judged["own"]
    table = table_of("", ">mean", ">95 % interval", ">least", ">most", ">in training")
    rows = {"return": judged["return"], "length": judged["length"], **judged["measures"]}
    for name, spread in rows.items():
        title = name if spread["unit"] == "1" else f"{name}, {spread['unit']}"
        ends = (number(spread[key], 4) for key in ("least", "most"))
        table.add_row(
            title, number(spread["mean"], 4), _interval(spread).strip(), *ends, number(training_row.get(name), 4)
        )
    for name, title in _SHARE_TITLES.items():
        table.add_row(title, percent(judged[name]), "", "", "", percent(training_row.get(name)))
    return table
