"""Answers of one task by one way of solving, each in a process of its own within a limit of processor time."""

from __future__ import annotations

import os
import resource
import subprocess
import time
import warnings
from dataclasses import asdict, dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from ocp import solve
from ocp.problem.problem import Problem
from ocp.programs.program import PENALTY
from ocp.routes.session import Effort
from ocp.solve.solve import new_session
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


EFFORTS: dict[str, Effort] = {"default": "normal", "quick": "quick"}
"""Mapping from ways of the workbench to their effort."""
PYMPCC_SCRIPT = str(Path(__file__).with_name("pympcc_peer.py"))
"""Script that solves a stored program by pympcc, in an environment of its own."""
NO_ANSWER = "no answer"
"""Stationarity in the row of a process that reached its limit, or ended in an error."""


def solve_default(problem: Problem, effort: Effort = "normal") -> Answer:
    """Return the answer of the default command, with its processor time."""
    began = time.process_time()
    solution = solve(problem, contact="exact", effort=effort)
    seconds = time.process_time() - began
    x, u, lam = (solution.data[name].values[0] for name in ("x", "u", "lam"))
    return Answer(x, u, lam, solution.cost, solution.success, solution.iterations, seconds)


def solve_pympcc(problem: Problem) -> Answer:
    """Return pympcc's answer to the same program from the same start, by the Python named in ``PYMPCC``."""
    session = new_session(problem, contact="exact")
    nlp, values = session.nlp_of("none"), {**session.values, PENALTY: 0.0}
    arrays: dict[str, Any] = nlp.bounds(values) | {"p": nlp.parameter_vector(values), "pairs": nlp.pairs}
    with TemporaryDirectory() as folder:
        for name in ("f_g", "gradient", "jacobian", "hessian"):
            getattr(nlp, name).save(f"{folder}/{name}.casadi")
        np.savez(f"{folder}/program.npz", x0=session.first_point(nlp).x, **arrays)
        subprocess.run([os.environ["PYMPCC"], PYMPCC_SCRIPT, folder], check=True, stdout=subprocess.DEVNULL)
        answer = dict(np.load(f"{folder}/answer.npz"))
    blocks = nlp.variables.unpack(answer["x"])
    x0 = problem.initial_states(problem.parameters.values)[:1]
    cost = float(nlp.values(answer["x"], arrays["p"])[0])
    effort = bool(answer["converged"]), int(answer["iterations"]), float(answer["seconds"])
    return Answer(np.vstack([x0, blocks["x"][0]]), blocks["u"][0], blocks["lam"][0], cost, *effort)


def answer_of(task: str, problem: Problem, way: str) -> Answer:
    """Return the answer of one way of solving."""
    if way in EFFORTS:
        return solve_default(problem, EFFORTS[way])
    return solve_pympcc(problem) if way == "pympcc" else solve_published(task, problem)


def measured(task: str, instance: int, way: str) -> dict[str, Any]:
    """Return the row of one answer, as a dict."""
    warnings.simplefilter("ignore")
    problem = get(task, **({"instance": instance} if instance else {}))
    answer = answer_of(task, problem, way)
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


def unanswered(task: str, instance: int, way: str, seconds: float) -> dict[str, Any]:
    """Return the row of a process that ended without an answer after so many seconds of processor time."""
    return asdict(Row(task, instance, way, False, False, False, None, None, None, NO_ANSWER, 0, seconds))


def send_row(sender: Connection, task: str, instance: int, way: str, limit: int) -> None:
    """Send the row of one answer, from a process that ends after ``limit`` seconds of processor time."""
    resource.setrlimit(resource.RLIMIT_CPU, (limit, limit))
    sender.send(measured(task, instance, way))
