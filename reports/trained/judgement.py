"""Episodes of a policy in words and numbers, with intervals over episodes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from reports.console import number, table_of

if TYPE_CHECKING:
    from rich.table import Table

    from ocp.learning.training import Evaluation
    from ocp.task import Task

_CONFIDENCE = 0.95
_SHARES = {"fallen": "episodes ended", "lost": "episodes lost", "unsolved": "steps unsolved"}


def judgement(task: Task, seen: Evaluation) -> dict[str, Any]:
    """Return, length and measures, each with its mean, 95 % interval, least and most.

    ``fallen`` is the share of episodes that ended before the task's horizon, ``lost`` that of those
    that ended where a contact found no solution, ``unsolved`` the share of such steps.
    """
    lost = {int(sample) for sample in np.asarray(seen.unsolved).reshape(-1, 2)[:, 0]}
    early = [n for n, length in enumerate(seen.lengths) if length < task.horizon and n not in lost]
    steps = max(float(np.sum(seen.lengths)), 1.0)
    units = {measure.signal.name: measure.signal.unit for measure in task.measures}
    return {
        "episodes": len(seen.returns),
        "horizon": task.horizon,
        "return": _spread(seen.returns, "1"),
        "length": _spread(seen.lengths, "1"),
        "measures": {
            name: _spread(values, units.get(name, "1")) for name, values in seen.measures.items()
        },
        "fallen": len(early) / len(seen.returns),
        "lost": len(lost) / len(seen.returns),
        "unsolved": len(seen.unsolved) / steps,
    }


def _spread(values: np.ndarray, unit: str) -> dict[str, Any]:
    """Mean, Student's interval of it (None of a single episode), least, most."""
    from scipy.special import stdtrit

    values = np.asarray(values, dtype=float)
    n, mean = len(values), float(np.mean(values))
    interval = None
    if n > 1:
        half = stdtrit(n - 1, (1 + _CONFIDENCE) / 2) * values.std(ddof=1) / np.sqrt(n)
        interval = [mean - float(half), mean + float(half)]
    return {"mean": mean, "interval": interval, "least": float(values.min()),
            "most": float(values.max()), "unit": unit}  # fmt: skip


def sentence(judged: Mapping[str, Any]) -> str:
    """The verdict: the return, the return found in training, and failures."""
    found, own = judged["return"], judged["own"]
    many = "1 episode" if judged["episodes"] == 1 else f"{judged['episodes']} episodes"
    head = f"Return {number(found['mean'], 4)}{_interval(found)} under the {judged['contact']} law"
    parts = [f"{head} over {many}; in training it was {number(own['return'], 4)}"]
    if judged["fallen"]:
        parts.append(f"{_share(judged['fallen'])} of episodes end early")
    if judged["unsolved"]:
        parts.append(
            f"contacts were not solved at {_share(judged['unsolved'])} of steps, where"
            f" {_share(judged['lost'])} of episodes end"
        )
    return f"{'; '.join(parts)}."


def _interval(found: Mapping[str, Any]) -> str:
    if found["interval"] is None:
        return ""
    low, high = (number(end, 4) for end in found["interval"])
    return f" [{low}, {high}]"


def judgement_table(judged: Mapping[str, Any]) -> Table:
    """A line each for return, length and measures, beside what training found."""
    own = judged["own"]
    table = table_of("", ">mean", ">95 % interval", ">least", ">most", ">in training")
    rows = {"return": judged["return"], "length": judged["length"], **judged["measures"]}
    for name, found in rows.items():
        title = name if found["unit"] == "1" else f"{name}, {found['unit']}"
        ends = (number(found[key], 4) for key in ("least", "most"))
        table.add_row(title, number(found["mean"], 4), _interval(found).strip(), *ends,
                      number(own.get(name), 4))  # fmt: skip
    for name, title in _SHARES.items():
        known = own.get(name)
        table.add_row(title, _share(judged[name]), "", "", "", "–" if known is None else
                      _share(known))  # fmt: skip
    return table


def _share(value: float) -> str:
    return f"{100 * value:.3g} %"
