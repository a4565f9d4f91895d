"""Shares of the time of a solve with frictional contact: set-up, functions, linear algebra."""

from __future__ import annotations

import re
import time
from pathlib import Path

import pytest

from dynamics.contact import Barrier
from tests.benchmarks.ocp.cases import session
from tests.benchmarks.ocp.race import ms, tell

N, ITERATIONS = 100, 100
BUILD, FUNCTIONS, OVERALL = 5.0, 0.30, 1.5
"""Floors: set-up [s], time of functions over the rest, and total over the linear solver (1.2 + 0.3)."""


def timed(report: str, what: str) -> float:
    """Return the processor seconds in one line of IPOPT's timing statistics."""
    found = re.search(rf"^ *{re.escape(what)}\.*: *([\d.]+)", report, re.MULTILINE)
    assert found, what
    return float(found[1])


@pytest.mark.bench
def test_where_an_iteration_goes(tmp_path: Path) -> None:
    """It solves one relaxed NLP, lam gap = 0.01, with at most 100 iterations from the problem's own guess.

    Times of functions and solver are as every solve reports them; the linear solver's part is
    IPOPT's own measurement. Set-up is processor time and, with jit, includes compiling or reading
    the cache.
    """
    rows, missed = [], []
    for name in ("hopper", "half-cheetah"):
        for jit in ("false", "true"):
            file = tmp_path / f"{name}-{jit}.txt"
            began = time.process_time()
            made = session(
                name,
                Barrier(mu=1e-2),
                N,
                jit=jit,
                homotopy="false",
                max_iter=ITERATIONS,
                print_timing_statistics="yes",
                output_file=str(file),
                file_print_level=3,
            )
            nlp = made.nlp_of("product")
            made.first_point(nlp)
            built = time.process_time() - began
            trace = made.solve().trace
            solver_s = trace.seconds - trace.evaluation_s
            share = trace.evaluation_s / solver_s
            report = file.read_text()
            linear = timed(report, "StdAugSystemSolverMultiSolve")
            ratio = timed(report, "OverallAlgorithm") / linear
            each = (trace.evaluation_s, solver_s)
            rows.append(
                [
                    name,
                    jit,
                    f"{built:.2f}",
                    trace.iterations,
                    *(ms(seconds / trace.iterations) for seconds in each),
                    f"{share:.2f}",
                    f"{ratio:.2f}",
                ]
            )
            missed += [(name, jit, "set-up", built)] if built >= BUILD and jit == "false" else []
            missed += [(name, jit, "functions", share)] if share > FUNCTIONS else []
            missed += [(name, jit, "overall", ratio)] if ratio > OVERALL else []
    columns = [
        "problem",
        "jit",
        "set-up, s",
        "iterations",
        "functions, ms",
        "solver, ms",
        "functions / solver",
        "all / linear",
    ]
    tell(f"Time of an iteration, N = {N}; floors {FUNCTIONS}, {OVERALL}", columns, rows)
    assert not missed
