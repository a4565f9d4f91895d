"""No decision of a solve depends on a clock: a busy computer gives the same solution later."""

from __future__ import annotations

import ast
import itertools
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import ocp
from dynamics.contact import Exact
from ocp.solve.solve import solve
from problems import get

CLOCKS = {"perf_counter", "thread_time", "process_time", "monotonic", "time_ns", "clock_gettime"}
LIMITS = {"time_limit", "max_wall_time", "max_cpu_time"}
"""Names of solver options that would make a clock decide."""
HOUSE = Path(ocp.__file__).parent
AROUND = {
    "store/checkpoint.py": "how often the work is saved",
    "jobs/processes.py": "how long a worker that was told to end is waited for",
    "mpc/controller.py": "a user's deadline of a sample",
    "programs/options.py": "a user's own limits, checked",
}
"""Mapping from file to what a clock decides in it, outside of the solution."""
FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)


def called(node: ast.AST) -> str:
    """Return the name of a variable, or the last name of an attribute; "" for other nodes."""
    if isinstance(node, ast.Name):
        return node.id
    return node.attr if isinstance(node, ast.Attribute) else ""


def tells(node: ast.AST | None, timed: set[str]) -> bool:
    """Return whether a node contains a clock, or a name in ``timed``."""
    return node is not None and any(called(one) in timed for one in ast.walk(node))


def assigned(node: ast.AST) -> list[tuple[ast.AST, ast.AST]]:
    """Return the pairs of target and value of an assignment, with tuples split."""
    if isinstance(node, ast.AugAssign):
        return [(node.target, node.value)]
    if not isinstance(node, ast.Assign):
        return []
    pairs = []
    for target in node.targets:
        apart = isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple)
        pairs += zip(target.elts, node.value.elts, strict=True) if apart else [(target, node.value)]
    return pairs


def decisions(code: str) -> list[str]:
    """Return the comparisons, conditions and limits in ``code`` that depend on a clock."""
    tree, timed, before = ast.parse(code), set(CLOCKS), 0
    while len(timed) > before:
        before = len(timed)
        for node in ast.walk(tree):
            for target, value in assigned(node):
                number = isinstance(value, ast.BinOp | ast.Name | ast.Attribute)
                clock = isinstance(value, ast.Call) and called(value.func) in timed | {"min", "max"}
                if called(target) and (number or clock) and tells(value, timed):
                    timed.add(called(target))
            if isinstance(node, FUNCTIONS):
                given = [one.value for one in ast.walk(node) if isinstance(one, ast.Return)]
                if any(isinstance(v, ast.BinOp) and tells(v, timed) for v in given):
                    timed.add(node.name)
    found = []
    for node in ast.walk(tree):
        parts: list[ast.AST] = [node] if isinstance(node, ast.Compare) else []
        if isinstance(node, ast.If | ast.While | ast.IfExp):
            parts.append(node.test)
        if isinstance(node, ast.Call) and called(node.func) in {"min", "max", "range", "ceil"}:
            parts.append(node)
        found += [ast.unparse(part) for part in parts if tells(part, timed)]
        if isinstance(node, ast.Constant) and node.value in LIMITS:
            found.append(repr(node.value))
    return found


@pytest.mark.costly
def test_clocks_only_feed_what_is_recorded() -> None:
    files = [file for file in HOUSE.rglob("*.py") if file.relative_to(HOUSE).as_posix() not in AROUND]
    assert len(files) > 100
    found = {file.name: said for file in files if (said := decisions(file.read_text()))}
    assert found == {}


@pytest.mark.parametrize(
    "code",
    [
        "until = time.monotonic() + 5\nwhile time.monotonic() < until: pass",
        "def left(self):\n    return self.end - time.thread_time()\nif left() <= 0: stop()",
        "self.began = perf_counter()\nbudget = min(3.0, 0.3 * self.began)",
        "milp(c, options={'time_limit': 5.0})",
        "a, b = perf_counter(), 1\nx = 1 if a > 2 else 0",
    ],
)
def test_the_rule_sees_a_clock_that_decides(code: str) -> None:
    assert decisions(code)


def test_the_rule_lets_a_clock_be_recorded() -> None:
    code = "began = perf_counter()\nwork()\nsave(seconds=perf_counter() - began, x=1 if a > 2 else 0)"
    assert decisions(code) == []


def answer(name: str, **params: float) -> tuple[bytes, ...]:
    """Return the bytes of a solve: states, inputs, cost and number of iterations."""
    found = solve(get(name, **params), Exact())
    return (
        *(found.data[key].values.tobytes() for key in ("x", "u")),
        np.float64(found.cost).tobytes(),
        np.int64(found.iterations).tobytes(),
    )


@pytest.mark.costly
def test_a_clock_that_jumps_by_hours_changes_no_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    calm = answer("planar-push", friction=0.25)
    ticks = itertools.count(step=36_000)
    for name in ("perf_counter", "thread_time", "process_time", "monotonic"):
        monkeypatch.setattr(time, name, lambda: float(next(ticks)))
    assert answer("planar-push", friction=0.25) == calm


@pytest.mark.slow
def test_a_loaded_computer_gives_half_cheetah_the_same_bits() -> None:
    """The solve is repeated while busy processes run on all cores, two more than there are cores."""
    alone = answer("half-cheetah")
    command = [sys.executable, "-c", "while True: pass"]
    load = [subprocess.Popen(command) for _ in range((os.cpu_count() or 1) + 2)]
    try:
        assert answer("half-cheetah") == alone
    finally:
        for one in load:
            one.kill()
            one.wait()
