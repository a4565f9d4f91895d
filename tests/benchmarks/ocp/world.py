"""Planar manipulation without guesses: ``python -m tests.benchmarks.ocp.world [WORD ...]``.

Ten scenes and ``push-t`` from its own start and 20 random ones by the default command, and
``push-box`` to 18 headings from an all-zero guess by the strategy scholtes-quick. Prints cost, cost
of standing still, seconds, certificate and the referee's word of each task whose name has one of
the words. A task is stopped after :data:`LIMIT` seconds.
"""

from __future__ import annotations

import math
import multiprocessing as mp
import sys
import time
import warnings
from typing import Any

import numpy as np

import problems
from ocp import solve
from ocp.problem.problem import Problem
from tests.benchmarks.ocp.world_scenes import SCENES

LIMIT = 180
HEAD = f"{'task':<22}{'cost':>9}{'idle':>9}{'s':>7}  {'certificate':<12}referee"
STARTS = 20
"""Number of random starts of the T."""


def tasks() -> dict[str, tuple[str, dict[str, float]]]:
    """Return problem and parameters of every pushing task, by name."""
    found: dict[str, tuple[str, dict[str, float]]] = {
        f"push-box {20 * k} degrees": ("push-box", {"heading": k * math.pi / 9}) for k in range(18)
    }
    rng = np.random.default_rng(0)
    found["push-t"] = ("push-t", {})
    for k in range(STARTS):
        (x, y), angle = rng.uniform(-0.25, 0.25, 2), rng.uniform(-math.pi, math.pi)
        found[f"push-t start {k}"] = ("push-t", {"x0": x, "y0": y, "angle0": angle})
    return found


def made(name: str) -> tuple[Problem, dict[str, str]]:
    """Return the problem of a scene or task, and the settings of its command."""
    if name in SCENES:
        return SCENES[name](), {}
    problem, values = tasks()[name]
    settings = {"strategy": "scholtes-quick"} if problem == "push-box" else {}
    return problems.get(problem, **values), settings


def measured(name: str) -> tuple[Any, ...]:
    """Solve one task; return its cost, idle cost, seconds, certificate and the referee's word."""
    warnings.simplefilter("ignore")
    problem, settings = made(name)
    began = time.perf_counter()
    found = solve(problem, contact="exact", settings=settings)
    seconds = time.perf_counter() - began
    kind = found.certificate.stationarity if found.certificate.certified else "none"
    return found.cost, found.idle_cost, seconds, kind, found.referee.word


def main(words: list[str]) -> None:
    """Print the table of the chosen tasks."""
    print(HEAD)
    known = [*SCENES, *tasks()]
    good, chosen = 0, [n for n in known if not words or any(word in n for word in words)]
    for name in chosen:
        with mp.get_context("spawn").Pool(1) as pool:
            try:
                cost, idle, seconds, kind, word = pool.apply_async(measured, (name,)).get(LIMIT)
            except mp.TimeoutError:
                print(f"{name:<22}{'':>9}{'':>9}{'>' + str(LIMIT):>7}", flush=True)
                continue
        good += kind != "none" and word == "survives" and seconds <= 60
        print(f"{name:<22}{cost:>9.4f}{idle:>9.5g}{seconds:>7.1f}  {kind:<12}{word}", flush=True)
    print(f"{good} of {len(chosen)} certified and surviving within 60 s")


if __name__ == "__main__":
    main(sys.argv[1:])
