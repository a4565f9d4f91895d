"""Tables that compare smoothed laws in plans (study N3) and in closed loops (study C1)."""

from __future__ import annotations

import xarray as xr

from problems.studies.laws_in_the_loop.data import FEEDBACK, LAWS, relative_cost, survival
from problems.studies.smoothings_compared.data import WITHIN, excess_cost, law_texts
from reports.tables.law_tables import excess_text, seconds_of


def smoothing_rows(data: xr.Dataset) -> list[list[str]]:
    """Return the column titles and a row per law: excess and survival per problem, then seconds."""
    names = [str(name) for name in data["problem"].values]
    excesses, seconds = excess_cost(data).median("seed"), seconds_of(data)
    survives, n_seeds = data["survives"].sum("seed"), data.sizes["seed"]
    table = [["law", *names, "seconds"]]
    for law, text in law_texts(data.attrs).items():
        cells = [
            _cell(float(excesses.sel(law=law, problem=p)), int(survives.sel(law=law, problem=p)), n_seeds)
            for p in names
        ]
        law_seconds = seconds.sel(law=law)
        table.append([text, *cells, f"{float(law_seconds.min()):.2g} to {float(law_seconds.max()):.2g}"])
    return table


def _cell(share: float, n_alive: int, n_runs: int) -> str:
    """Return an excess cost as text, bold if it is within the margin, with a check mark if plans survive."""
    text = f"**{excess_text(share)}**" if share <= WITHIN else excess_text(share)
    if n_alive == 0:
        return text
    return f"{text} ✓" if n_alive == n_runs else f"{text} ✓ {n_alive}/{n_runs}"


def loop_rows(data: xr.Dataset) -> list[list[str]]:
    """Return the column titles and a row per controller: excess and survival per task, then times.

    An excess is the median over plants and seeds; those of feedback gains, and their survival, are
    over the first horizon.
    """
    tasks = [str(name) for name in data["task"].values]
    excesses, alive = relative_cost(data).median(["plant", "seed"]) - 1, survival(data)
    n_alive, n_runs = alive.sum(["plant", "seed"]), alive.count(["plant", "seed"])
    table = [["planning again", *tasks, "p99 [ms]"]]
    for name in (*LAWS, *FEEDBACK):
        sample_ms, span = data["ms"].sel(controller=name), "first horizon" if name in FEEDBACK else "run"
        selections = [{"controller": name, "task": task, "span": span} for task in tasks]
        cells = [_cell(float(excesses.sel(a)), int(n_alive.sel(a)), int(n_runs.sel(a))) for a in selections]
        table.append([name, *cells, f"{float(sample_ms.min()):.2g} to {float(sample_ms.max()):.2g}"])
    return table
