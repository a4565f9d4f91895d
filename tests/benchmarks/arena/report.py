"""Table and performance profile of the arena's stored answers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from docs.generator.measured import save_picture, write_data
from ocp.store.atomic import write_file
from problems.arena.published import DATA as PUBLISHED
from problems.arena.published import published_results
from problems.registry import arena_names

COLUMNS = (
    "task",
    "way",
    "answers",
    "feasible",
    "certified",
    "median cost",
    "quartiles of the cost",
    "median s",
    "quartiles of s",
    "iterations",
)
WORDS = {"default": "ocp solve", "quick": "ocp solve --effort quick", "published": "published formulation"}
"""Mapping from a way of solving to its words."""
PEERS = {"pympcc": "pympcc 1.0.0"}
"""Mapping from peers that solve a stored program to their words; they need an environment of their own."""
NOTE = (
    "Feasible: residuals and products of pairs of at most 1e-6. Certified: feasible, and B-stationary by our"
    " certificate, the same judge for all rows but those of sources, whose points are not published. Costs are the"
    " task's own, without penalties; those of sources include their penalty. Seconds of processor time, building"
    " included; those of sources are wall-clock seconds on their computer."
)
Entry = Mapping[str, Any]
PROFILE_END = 10.0
"""Largest ratio of processor times that the profile shows."""


def summary(values: Sequence[float], digits: int = 4) -> tuple[str, str]:
    """Return the median, and the first and third quartile, as text."""
    if not values:
        return "–", "–"
    low, middle, high = np.percentile(values, [25, 50, 75])
    return f"{middle:.{digits}g}", "" if len(values) == 1 else f"{low:.{digits}g} to {high:.{digits}g}"


def task_rows(task: str, answers: Sequence[Entry]) -> list[list[str]]:
    """Return the table's rows of a task: one for each way, and one for each source's solver on the same instances."""
    rows = []
    for way, words in {**WORDS, **PEERS}.items():
        entries = [entry for entry in answers if entry["task"] == task and entry["way"] == way]
        if entries:
            costs = [entry["cost"] for entry in entries if entry["feasible"]]
            seconds, iterations = ([entry[name] for entry in entries] for name in ("seconds", "iterations"))
            certified = sum(entry["solved"] for entry in entries)
            counts = [str(len(entries)), str(sum(entry["feasible"] for entry in entries)), str(certified)]
            rows.append([task, words, *counts, *summary(costs), *summary(seconds, 2), summary(iterations)[0]])
    instances = {entry["instance"] for entry in answers if entry["task"] == task}
    results = [result for result in published_results(task) if result.instance in instances]
    for solver in dict.fromkeys(result.solver for result in results):
        chosen = [result for result in results if result.solver == solver]
        costs = [result.cost for result in chosen if result.solved]
        seconds = [result.wall_ms / 1e3 for result in chosen if result.wall_ms is not None]
        iterations = summary([result.iterations for result in chosen])[0]
        counts = [str(len(chosen)), f"{len(costs)} say so", "–"]
        rows.append([task, f"source: {solver}", *counts, *summary(costs), *summary(seconds, 2), iterations])
    return rows


def profile(answers: Sequence[Entry]) -> dict[str, np.ndarray]:
    """Return, for each way, the sorted ratios of its times to the least time of a certified answer per instance.

    Answers without a certificate have infinite ratios (Dolan and More, 2002).
    """
    keys = sorted({(entry["task"], entry["instance"]) for entry in answers})
    times = {
        (entry["task"], entry["instance"], entry["way"]): entry["seconds"] if entry["solved"] else np.inf
        for entry in answers
    }
    ways = [way for way in WORDS if any(entry["way"] == way for entry in answers)]
    table = np.array([[times.get((*key, way), np.inf) for way in ways] for key in keys])
    least = table.min(axis=1, keepdims=True)
    with np.errstate(invalid="ignore"):
        ratios = np.where(np.isfinite(table), table / least, np.inf)
    return {way: np.sort(ratios[:, column]) for column, way in enumerate(ways)}


def draw_profile(answers: Sequence[Entry]) -> None:
    """Write the figure of the performance profile."""
    figure = Figure(figsize=(6, 3.2))
    axes = figure.add_subplot()
    for way, ratios in profile(answers).items():
        finite = ratios[np.isfinite(ratios)]
        shares = np.arange(1, finite.size + 1) / ratios.size
        x = np.concatenate([[1.0], finite, [PROFILE_END]])
        y = np.concatenate([[0.0], shares, [shares[-1] if shares.size else 0.0]])
        axes.step(x, y, where="post", label=WORDS[way])
    axes.set(xscale="log", xlim=(1, PROFILE_END), ylim=(0, 1.02), xlabel="processor time over the least of all")
    axes.set_ylabel("share of instances certified")
    axes.legend(loc="lower right")
    axes.grid(alpha=0.3)
    save_picture(figure, "arena-profile")


def write_workbench(answers: Sequence[Entry]) -> None:
    """Write the results of the default command for ``ocp arena compare``."""
    lines = ["task,instance,ocp.solved,ocp.iterations,ocp.cost,ocp.violation"]
    for entry in answers:
        if entry["way"] == "default" and entry["cost"] is not None:
            violation = max(entry["residual"], entry["product"])
            numbers = int(entry["solved"]), entry["iterations"], f"{entry['cost']:.9g}", f"{violation:.1e}"
            lines.append(",".join(map(str, (entry["task"], entry["instance"], *numbers))))
    write_file(PUBLISHED / "workbench.csv", "".join(f"{line}\n" for line in lines).encode())


def short_rows(answers: Sequence[Entry]) -> list[str]:
    """Return the rows of the README: certified answers, median cost and median seconds of each family of instances."""
    rows = []
    for task in (task for task in arena_names() if published_results(task)):
        cells = []
        for way in WORDS:
            entries = [entry for entry in answers if entry["task"] == task and entry["way"] == way]
            cost = summary([entry["cost"] for entry in entries if entry["feasible"]], 3)[0]
            seconds = summary([entry["seconds"] for entry in entries], 2)[0]
            cells.append(f"{sum(entry['solved'] for entry in entries)} · {cost} · {seconds} s")
        rows.append(f"| {task} | {' | '.join(cells)} |")
    return rows


def write_answers(name: str, content: Mapping[str, Any]) -> None:
    """Write the table ``name`` of a file of answers, whose commit, date and computer it names."""
    rows = [row for task in arena_names() for row in task_rows(task, content["answers"])]
    measured = {key: text for key, text in content.items() if key != "answers"}
    write_data(name, {"title": f"The {name}", **measured, "columns": COLUMNS, "rows": rows, "note": NOTE})


def write_report(content: Mapping[str, Any]) -> None:
    """Write the table and the figure of the site, and the results that ``ocp arena compare`` reads."""
    write_workbench(content["answers"])
    write_answers("arena", content)
    draw_profile(content["answers"])
