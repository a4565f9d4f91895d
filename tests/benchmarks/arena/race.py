"""Answers of one task by one way of solving, each in a process of its own within a limit of processor time."""

from __future__ import annotations

import resource
import time
import warnings
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass
from functools import partial
from multiprocessing import get_context
from typing import Any

from ocp import solve
from ocp.problem.problem import Problem
from problems import get
from tests.benchmarks.arena.judge import judged
from tests.benchmarks.arena.peers import Answer
from tests.benchmarks.arena.published import solve_published


@dataclass(frozen=True)
class Row:
    """One answer: task, instance (0 where a task has none), way, verdict and effort."""

    task: str
    instance: int
    way: str
    solved: bool
    feasible: bool
    converged: bool
    cost: float | None
    residual: float | None
    product: float | None
    stationarity: str
    iterations: int
    seconds: float


def solve_default(problem: Problem) -> Answer:
    """Return the answer of the default command, with its processor time."""
    began = time.process_time()
    solution = solve(problem, contact="exact")
    seconds = time.process_time() - began
    x, u, lam = (solution.data[name].values[0] for name in ("x", "u", "lam"))
    return Answer(x, u, lam, solution.cost, solution.success, solution.iterations, seconds)


def measured(task: str, instance: int, way: str) -> dict[str, Any]:
    """Return the row of one answer, as a dict."""
    warnings.simplefilter("ignore")
    problem = get(task, **({"instance": instance} if instance else {}))
    answer = solve_default(problem) if way == "default" else solve_published(task, problem)
    verdict = judged(problem, answer)
    row = Row(
        task,
        instance,
        way,
        verdict.solved,
        verdict.feasible,
        answer.converged,
        verdict.cost,
        verdict.residual,
        verdict.product,
        verdict.stationarity,
        answer.iterations,
        round(answer.seconds, 2),
    )
    return asdict(row)


def limited(task: str, instance: int, way: str, seconds: int) -> dict[str, Any]:
    """Return the row of an answer from a process of its own, or a row without answer after so many CPU seconds."""
    limit = partial(resource.setrlimit, resource.RLIMIT_CPU, (seconds, seconds))
    with ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=limit) as pool:
        try:
            return pool.submit(measured, task, instance, way).result()
        except BrokenProcessPool:
            return asdict(Row(task, instance, way, False, False, False, None, None, None, "no answer", 0, seconds))
