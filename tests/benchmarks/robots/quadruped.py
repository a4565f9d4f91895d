"""Times of the quadruped's stage in compiled C, and of an iteration on its relaxed program."""

from __future__ import annotations

import ctypes
import os
import re
import resource
import tempfile
import time
from pathlib import Path

import casadi as ca
import numpy as np

from dynamics.batch.engines import compiler
from dynamics.batch.engines.c_external import external_source
from dynamics.contact import Barrier, ContactLaw, Exact
from dynamics.systems import ParameterTable
from ocp.problem.policy import OpenLoop
from ocp.problem.problem import Problem, Scaling
from ocp.programs.layout import Layout
from ocp.programs.solver import Solver
from ocp.routes.session import Session
from ocp.transcription import Direct
from ocp.transcription.common import Graph
from ocp.transcription.direct import trajectory_variables
from ocp.transcription.nlp import StageCompiler
from ocp.transcription.stage import Stage
from problems.bodies.quadruped import height, pose, quadruped

N, H, MU, ROUNDS = 20, 0.02, 1e-2, 5
THIGH, SHIN = 0.7, -1.4
LOOP = """\
#define _GNU_SOURCE
#include <time.h>
typedef int (*function)(const double **, double **, long long *, double *, int);
double least(function f, const double **arg, double **res, int calls, int rounds);
double least(function f, const double **arg, double **res, int calls, int rounds) {
  double best = 1e9;
  for (int r = 0; r < rounds; r++) {
    struct timespec a, b;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &a);
    for (int k = 0; k < calls; k++) f(arg, res, 0, 0, 0);
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &b);
    double s = ((b.tv_sec - a.tv_sec) + 1e-9 * (b.tv_nsec - a.tv_nsec)) / calls;
    if (s < best) best = s;
  }
  return best;
}
"""


def problem() -> Problem:
    """Return the problem of shifting the standing trunk by 10 cm with four feet on the ground."""
    table = ParameterTable()
    system = quadruped().system("quadruped", table, h=H, friction=0.8)
    start = np.r_[pose(0.0, height(THIGH, SHIN), THIGH, SHIN), np.zeros(18)]
    off = system.x - ca.DM(start)
    off[0] -= 0.1
    far = ca.dot(off**2, ca.DM(np.r_[np.ones(19), np.full(18, 1e-2)]))
    return Problem(
        name="quadruped",
        system=system,
        N=N,
        stage_cost=(far + 1e-2 * ca.sumsqr(system.u)) / N,
        terminal_cost=10 * far,
        x0=ca.DM(start),
        parameters=table,
        u_lower=-1.0,
        u_upper=1.0,
        guess=lambda *_: (np.tile(start, (N + 1, 1)), np.zeros((N, 12))),
        scaling=Scaling(impulse=1.0, gap=0.1, x=0.1, u=0.1),
    )


def session(made: Problem, law: ContactLaw, jit: bool) -> Session:
    """Return a session for one solve without a homotopy."""
    compiled = StageCompiler() if jit else None
    return Session(made, law, Direct(), OpenLoop(), homotopy=False, compiled=compiled)


def stage_us(made: Problem) -> list[float]:
    """Return microseconds of residual, Jacobian and Hessian of the dynamics of one stage."""
    graph, system = Graph(made, Exact().close(made.system), OpenLoop()), made.system
    layout = trajectory_variables(graph, pairs=True)
    w = ca.vertcat(system.x, system.u, system.x_next, graph.step.lam)
    index = np.zeros((1, w.numel()), dtype=int)
    rows = np.zeros((1, system.nx), dtype=int)
    assert isinstance(layout, Layout)
    stage = Stage("dynamics", w, graph.p, ca.SX(0), graph.step.residual, index, rows)
    rng = np.random.default_rng(0)
    least = compiler.load_library(LOOP, ["least"]).least
    least.restype = ctypes.c_double
    found = []
    for function in (stage.constraint_values(), stage.constraint_slopes()[0], stage.second()[0]):
        given = [0.2 * rng.standard_normal(max(1, function.nnz_in(k))) for k in range(function.n_in())]
        taken = [np.zeros(max(1, function.nnz_out(k))) for k in range(function.n_out())]
        made_c = getattr(compiler.load_library(external_source(function)), function.name())
        arrays = [(ctypes.c_void_p * len(a))(*(v.ctypes.data for v in a)) for a in (given, taken)]
        found.append(1e6 * least(ctypes.cast(made_c, ctypes.c_void_p), *arrays, 100, 50))
        exact = function.call([ca.DM(g[: function.nnz_in(k)]) for k, g in enumerate(given)])
        for value, own in zip(exact, taken, strict=True):
            np.testing.assert_allclose(own[: value.nnz()], np.array(value.nz[:]).ravel(), atol=1e-12)
    return found


def _cpu_s() -> float:
    kinds = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    return sum(resource.getrusage(kind).ru_utime for kind in kinds)


def build_s(made: Problem) -> list[tuple[float, float]]:
    """Return processor and wall seconds to build the exact law's program, by compiling and from the cache."""
    found, old = [], os.environ.get("XDG_CACHE_HOME")
    with tempfile.TemporaryDirectory() as folder:
        os.environ["XDG_CACHE_HOME"] = folder
        compiler._loaded.clear()
        for _ in range(2):
            fresh = session(made, Exact(), jit=True)
            cpu, wall = _cpu_s(), time.perf_counter()
            fresh.nlp_of("none")
            found.append((_cpu_s() - cpu, time.perf_counter() - wall))
    os.environ.pop("XDG_CACHE_HOME")
    if old is not None:
        os.environ["XDG_CACHE_HOME"] = old
    return found


def iteration_ms(made: Problem, jit: bool, **options: object) -> tuple[float, float, float, int]:
    """Return processor milliseconds of an IPOPT iteration, its functions and linear solver, and the number.

    They are the least of several solves of the relaxed program ``lam gap = MU`` from the same guess.
    """
    fresh, best = session(made, Barrier(mu=MU), jit), (np.inf, 0.0, 0.0, 0)
    with tempfile.TemporaryDirectory() as folder:
        for k in range(ROUNDS):
            file = Path(folder, f"{k}.txt")
            fresh.nlp_of("product").solvers.clear()
            fresh.solver = Solver(
                "ipopt",
                {
                    "print_timing_statistics": "yes",
                    "output_file": str(file),
                    "file_print_level": 3,
                    "max_iter": 60,
                    **options,
                },
            )
            fresh.solve()
            report = file.read_text()
            count = int(_number(report, "Number of Iterations"))
            words = "OverallAlgorithm", "Function Evaluations", "StdAugSystemSolverMultiSolve"
            total, functions, linear = (1e3 * _number(report, word) / count for word in words)
            best = min(best, (total, functions, linear, count))
    return best


def _number(report: str, what: str) -> float:
    found = re.search(rf"^ *{re.escape(what)}\.*: *([\d.]+)", report, re.MULTILINE)
    assert found, what
    return float(found[1])
