"""The default contact law is the same in Python, on the command line and in sweeps, and the best by stored data."""

from __future__ import annotations

import inspect
from dataclasses import fields

from docs.generator.measured import read
from ocp.jobs.sweep import sweep
from ocp.solve.solve import solve
from ocp.solve.solve_request import SolveRequest
from ocp.transcription.factories import DEFAULT_LAW
from reports.cli.commands import ContinueOptions, SolveOptions, SweepOptions


def test_python_and_the_command_line_agree() -> None:
    for function in (solve, sweep):
        assert inspect.signature(function).parameters["contact"].default == DEFAULT_LAW
    for options in (SolveOptions, SweepOptions, ContinueOptions, SolveRequest):
        (contact,) = (one for one in fields(options) if one.name == "contact")
        assert contact.default == DEFAULT_LAW


def test_the_default_survives_most_often_and_costs_less_on_most_problems() -> None:
    rows, laws = read("default-law")["rows"], ("exact", "barrier")
    survived = {law: sum(int(row[3]) for row in rows if row[1] == law) for law in laws}
    costs = {law: [float(row[5]) for row in rows if row[1] == law] for law in laws}
    (other,) = set(survived) - {DEFAULT_LAW}
    assert survived[DEFAULT_LAW] > survived[other]
    cheaper = [a < b for a, b in zip(costs[DEFAULT_LAW], costs[other], strict=True)]
    assert sum(cheaper) > len(cheaper) / 2
