"""Summary of a problem in ten lines with units, printed by Python as its ``repr``."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import casadi as ca
import numpy as np

_WIDTH = 96
"""Maximum number of characters of a line."""


def summary(problem: Any) -> str:
    """Return a summary in ten lines of a :class:`~ocp.problem.problem.Problem` at its default parameters."""
    system, p = problem.system, problem.parameters
    x0, _, *bounds = (np.array(value).ravel() for value in problem.limits(p.values))
    h = ca.Function("h", [system.x, p.vector], [ca.SX(system.h)])(x0, p.values)
    terms = [
        "stage",
        *(["increments of u"] if problem.uses_du else []),
        *(["impulses"] if problem.uses_impulses else []),
        "terminal",
    ]
    scenarios = problem.scenarios.n
    lines = {
        "horizon": [f"N = {problem.N} steps of h = {float(h):.4g} s"],
        "states": [f"{s.name} [{s.unit}]" for s in system.states],
        "inputs": [
            f"{s.name} [{s.unit}] in [{low:.4g}, {high:.4g}]"
            for s, low, high in zip(system.inputs, *bounds[:2], strict=True)
        ],
        "contacts": [f"{s.name} [{s.unit}]" for s in system.contacts] or ["none"],
        "parameters": [f"{entry.name} = {entry.value:.4g} {entry.unit}" for entry in p] or ["none"],
        "costs": terms,
        "constraints": [entry.name for entry in (*problem.path, *problem.terminal)] or ["none"],
        "start": ["free"] if problem.start else [f"{value:.4g}" for value in x0],
        "scenarios": [str(scenarios) if scenarios > 1 else "one"],
    }
    rows = (f"  {title + ':':12} {_within(values)}" for title, values in lines.items())
    return "\n".join([f"Problem {problem.name}", *rows])


def _within(values: Iterable[str]) -> str:
    """Return the values on one line; if they do not fit, the first values and the total number."""
    values, shown_values = list(values), list[str]()
    for value in values:
        if len(", ".join([*shown_values, value])) > _WIDTH - 30:
            return f"{', '.join(shown_values)}, ... ({len(values)})"
        shown_values.append(value)
    return ", ".join(shown_values)
