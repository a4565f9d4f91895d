"""Page of the report on trained policies of one task."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from matplotlib.figure import Figure

from ocp.errors import InputError
from ocp.store.stored_run import StoredRun
from reports.documents.common import Page, law_summary, law_text, numbered_figures, page_header, setting_rows
from reports.drawing.view import RunView
from reports.figures.training import learning_figure, measure_label, signal_figure, strobe_figures
from reports.tables.console import number
from reports.tables.training import SeedGroup, group_seeds, group_verdict, measure_names, summary_rows


def training_page(views: list[RunView]) -> Page:
    """Return content and figures of the page on trained policies of one task."""
    content, figures, firsts = training_content(views)
    settings_of_groups = [setting_rows(run) for run in firsts]
    shared = [row for row in settings_of_groups[0] if all(row in rows for rows in settings_of_groups)]
    own_settings = [[row for row in rows if row not in shared] for rows in settings_of_groups]
    laws = list(dict.fromkeys(law_text(run) for run in firsts))
    laws_used = [["law", "; ".join(laws)], ["evaluated under", "exact"]]
    return {
        **page_header(views[0]),
        "law": law_summary(views[0]),
        **content,
        "request": laws_used,
        "settings": shared,
        "own_settings": own_settings,
    }, figures


def training_content(views: Sequence[RunView]) -> tuple[dict[str, Any], dict[str, Figure], list[StoredRun]]:
    """Return the page's content (verdicts and a table), its figures, and the first run of each group.

    Raises :class:`~ocp.errors.InputError` for runs on several tasks.
    """
    tasks = dict.fromkeys(str(view.run.meta["problem"]) for view in views)
    if len(tasks) > 1:
        raise InputError(f"these policies are of several tasks, {', '.join(tasks)}; write one report per task")
    seed_groups = group_seeds([view.run for view in views])
    heads, cells = summary_rows(seed_groups)
    content = {
        "verdicts": [group_verdict(group) for group in seed_groups],
        "heads": heads,
        "rows": cells,
        "key": _key_numbers(views[0].run) if len(views) == 1 else [],
        "psi": [row for group in seed_groups for row in _learned(group)],
        "labels": [group.label for group in seed_groups],
        "hashes": [view.run.meta["hash"] for view in views],
        "seeds": max(len(group.runs) for group in seed_groups),
    }
    figures = {"learning": learning_figure(seed_groups)}
    if (gradient_figure := signal_figure(seed_groups)) is not None:
        figures["signals"] = gradient_figure
    figures |= numbered_figures("strobes", strobe_figures(seed_groups))
    return content, figures, [group.runs[0] for group in seed_groups]


def _key_numbers(run: StoredRun) -> list[list[str]]:
    meta, best = run.meta, run.meta["evaluation"]
    return [
        ["return under the exact law", number(meta["return"], 5)],
        ["standard deviation over episodes", number(best["return_deviation"], 3)],
        ["untrained", number(meta["untrained"]["return"], 5)],
        ["after the last iteration", number(meta["last"]["return"], 5)],
        ["steps per episode", number(best["length"], 4)],
        *([measure_label(run, name), number(best[name], 4)] for name in measure_names(best)),
        ["share of unsolved steps", number(best["unsolved"], 2)],
        ["iterations", str(meta["last"]["iteration"])],
        ["steps simulated", number(meta["env_steps"], 4)],
        ["time [s]", number(meta["wall_s"], 3)],
        ["parameters of the policy", str(run.data.sizes["parameter"])],
    ]


def _learned(group: SeedGroup) -> list[list[str]]:
    """Return rows on physical parameters learned with the group's best policy, next to the values of the task."""
    view = RunView.of(group.best)
    if view.problem is None or "psi" not in view.run.data:
        return []
    parameters, psi = view.problem.parameters, view.run.data["psi"]
    learned_values = zip(map(str, psi["physical"].values), psi.values.tolist(), strict=True)
    return [
        [group.label, name, number(value, 6), number(parameters.get(name).value, 6), parameters.get(name).unit]
        for name, value in learned_values
        if value != parameters.get(name).value
    ]
