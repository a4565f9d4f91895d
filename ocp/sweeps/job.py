"""One point of a sweep as a job that any process can do: numbers and trajectories come back."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ocp.errors import InputError, interruptible
from ocp.solution import Solution
from ocp.solve import Rank, solve_session
from ocp.sweeps.case import Case, FilesChanged
from ocp.sweeps.session_cache import cached_session

TRAJECTORIES = ("x", "u", "lam", "gap", "x_replay", "u_replay", "x_referee", "u_referee", "K", "k")
"""What is kept of a solution's arrays, beside the times of nodes."""
REFUSED, FAULT = "refused", "fault"
"""Status of a point that cannot be asked, and of one whose solve raised or whose worker died."""


@dataclass(frozen=True)
class SolveJob:
    """A case, from how many guesses it is solved, and which of the answers is taken."""

    case: Case
    starts: int = 1
    seed: int = 0
    rank: Rank = "planned"


@dataclass(frozen=True)
class LabelledArray:
    """Values with names of their dimensions, and labels of those whose entries have names."""

    dims: tuple[str, ...]
    values: np.ndarray
    labels: Mapping[str, list[str]]


@dataclass(frozen=True)
class JobResult:
    """What came of a job: numbers and words by name, and arrays by name, none where it failed."""

    row: dict[str, Any]
    arrays: dict[str, LabelledArray]


def solve_job(job: SolveJob, report: Callable[[Any], None]) -> JobResult:
    """Solve a point; a :data:`~ocp.scheduling.Function` that tells each stage's iterations.

    The answer is that of ``ocp solve`` with the same words, whatever the worker did before. What
    cannot be asked, or raises, is a point too, with the sentence as its verdict.

    Raises :class:`~ocp.sweeps.case.FilesChanged` where files have changed since the request.
    """
    began = time.perf_counter()
    try:
        with interruptible():
            session = cached_session(job.case)
            found = solve_session(
                session, job.starts, job.seed, lambda stage: report(stage.iterations), job.rank
            )
    except FilesChanged:
        raise
    except InputError as error:
        return failed_result(REFUSED, str(error))
    except Exception as error:
        return failed_result(FAULT, f"{type(error).__name__}: {error}")
    return JobResult({**_row(found), "seconds": time.perf_counter() - began}, _arrays(found))


def failed_result(status: str, sentence: str) -> JobResult:
    """A point without an answer, and why."""
    nothing: dict[str, Any] = dict.fromkeys(NUMBERS, float("nan"))
    row = {**nothing, "status": status, "stationarity": "", "kind": "", "grade": "failed",
           "verdict": sentence, "success": 0, "survives": -1, "iterations": 0}  # fmt: skip
    return JobResult({**row, "seconds": 0.0}, {})


NUMBERS = ("cost", "exact_cost", "referee_cost", "refined_cost", "idle_cost", "complementarity",
           "kkt_residual", "dynamics_residual", "penetration", "solve_s")  # fmt: skip
"""What is a number in a row."""
WORDS = ("status", "stationarity", "kind", "grade", "verdict")
"""What is a text there."""
COUNTS = ("success", "survives", "iterations")
"""What is whole; success and survives are 1 or 0, and -1 is unknown."""


def _row(found: Solution) -> dict[str, Any]:
    audit, certificate, referee = found.audit, found.certificate, found.referee
    numbers = {
        "cost": found.cost,
        "exact_cost": audit.exact_cost,
        "referee_cost": referee.cost,
        "refined_cost": referee.refined_cost,
        "idle_cost": found.idle_cost,
        "complementarity": audit.complementarity,
        "kkt_residual": certificate.kkt_residual,
        "dynamics_residual": audit.dynamics_residual,
        "penetration": audit.penetration,
        "solve_s": found.solve_s,
    }
    return {
        **{name: float(value) for name, value in numbers.items()},
        "status": found.status.label,
        "stationarity": certificate.stationarity,
        "kind": certificate.kind,
        "grade": found.grade,
        "verdict": found.verdict,
        "success": int(found.success),
        "survives": -1 if referee.survives is None else int(referee.survives),
        "iterations": int(found.iterations),
    }


def _arrays(found: Solution) -> dict[str, LabelledArray]:
    data, kept = found.data, {}
    for name in ("time", *TRAJECTORIES):
        if name in data:
            dims = tuple(map(str, data[name].dims))
            named = [dim for dim in dims if dim in data.coords and data[dim].dtype.kind in "UO"]
            labels = {dim: [str(label) for label in data[dim].values] for dim in named}
            kept[name] = LabelledArray(dims, np.asarray(data[name].values, dtype=float), labels)
    return kept
