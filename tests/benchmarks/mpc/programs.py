"""Solve one sample's quadratic program by PIQP and by CasADi's plugins."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median
from typing import Any

import casadi as ca
import numpy as np
import piqp
import scipy.sparse as sp

import problems
from docs.generator.measured import table, write_table
from ocp.mpc.controller import Controller
from ocp.mpc.plants import Plant

CASES = (
    ("soft-walls", 5),
    ("soft-walls", 10),
    ("soft-walls", 20),
    ("soft-walls", 50),
    ("spinner", 5),
    ("spinner", 10),
    ("spinner", 20),
    ("spinner", 40),
    ("spinner", 50),
)
SAMPLE, ROUNDS, SAME, LIMIT = 5, 15, 1e-6, 2.0
"""Sample of the program; solves; largest difference; limit [s] of all solves."""
PLUGINS: dict[str, dict[str, Any]] = {
    "piqp": {},
    "proxqp": {"proxqp": {"eps_abs": 1e-9, "eps_rel": 0.0, "max_iter": 10000}},
    "osqp": {"osqp": {"eps_abs": 1e-8, "eps_rel": 0.0, "max_iter": 20000, "verbose": False, "polish": True}},
    "qpoases": {"printLevel": "none", "sparse": True},
    "daqp": {},
    "highs": {"highs": {"output_flag": False}},
}


@dataclass(frozen=True)
class Program:
    """The program ``min 1/2 x'Px + c'x``, ``A x = b``, ``G x >= low``, ``x_l <= x <= x_u``."""

    P: sp.csc_matrix
    c: np.ndarray
    A: sp.csc_matrix
    b: np.ndarray
    G: sp.csc_matrix
    low: np.ndarray
    x_l: np.ndarray
    x_u: np.ndarray


def captured(name: str, N: int) -> Program:
    """Return the first program of one sample of a closed loop."""
    controller = Controller(problems.get(name, N=N), phase="qp")
    qp, seen = controller._phase.qp, []
    solve = qp._run_piqp

    def keep(accuracy: Any, *program: Any) -> Any:
        seen.append([v.copy() for v in program])
        return solve(accuracy, *program)

    plant, x = Plant(controller.problem, "exact", {}), controller.start
    for k in range(SAMPLE + 1):
        if k == SAMPLE:
            qp._run_piqp = keep
        x = plant.step(x, controller.step(x).u)[0]
    return Program(*seen[0])


Solve = Callable[[], np.ndarray]


def by_piqp(program: Program, kind: Any, tolerance: float = 1e-9, gap: bool = False) -> Solve:
    """Return a solve by PIQP, with its pattern set up once; ``gap`` asks for a small duality gap too."""
    given = (
        program.P,
        program.c,
        program.A,
        program.b,
        program.G,
        program.low,
        np.full(program.low.size, np.inf),
        program.x_l,
        program.x_u,
    )
    solver = piqp.SparseSolver()
    settings = solver.settings
    settings.kkt_solver, settings.check_duality_gap = kind, gap
    settings.eps_abs, settings.eps_rel = tolerance, 0.0
    settings.eps_duality_gap_abs, settings.eps_duality_gap_rel = tolerance, 0.0
    solver.setup(*given)

    def solve() -> np.ndarray:
        solver.update(*given)
        if solver.solve() != piqp.PIQP_SOLVED:
            raise RuntimeError(str(solver.result.info.status))
        return np.array(solver.result.x)

    return solve


def by_casadi(program: Program, plugin: str) -> Solve:
    """Return a solve by a plugin of ``casadi.conic``."""
    options = {**PLUGINS[plugin], "print_time": False, "error_on_fail": True}
    H, A = ca.DM(program.P), ca.DM(sp.vstack([program.A, program.G]).tocsc())
    solver = ca.conic("solver", plugin, {"h": H.sparsity(), "a": A.sparsity()}, options)
    given = {
        "h": H,
        "g": program.c,
        "a": A,
        "lbx": program.x_l,
        "ubx": program.x_u,
        "lba": np.concatenate([program.b, program.low]),
        "uba": np.concatenate([program.b, np.full(program.low.size, np.inf)]),
    }
    return lambda: np.array(solver(**given)["x"]).ravel()


def timed(solve: Solve, best: np.ndarray) -> str:
    """Return the median milliseconds of a solve, with its distance from the ``best`` if large."""
    x, seconds = solve(), []
    for _ in range(ROUNDS):
        began = time.perf_counter()
        x = solve()
        seconds.append(time.perf_counter() - began)
        if sum(seconds) > LIMIT:
            break
    off = float(np.abs(x - best).max() / max(1.0, np.abs(best).max()))
    return f"{1e3 * median(seconds):.3g}" + (f" (off {off:.0e})" if off > SAME else "")


def main() -> None:
    """Measure all, print the table, and store it."""
    stages, ldlt = piqp.KKTSolver.sparse_multistage, piqp.KKTSolver.sparse_ldlt
    ways: dict[str, Callable[[Program], Solve]] = {
        "PIQP stages": lambda p: by_piqp(p, stages),
        "PIQP sparse LDLT": lambda p: by_piqp(p, ldlt),
    }
    for plugin in filter(ca.has_conic, PLUGINS):
        ways[f"CasADi {plugin}"] = lambda p, plugin=plugin: by_casadi(p, plugin)
    given = {f"{name} {N}": captured(name, N) for name, N in CASES}
    best = {case: by_piqp(program, ldlt, 1e-11, True)() for case, program in given.items()}
    rows = []
    for way, make in ways.items():
        cells = []
        for case, program in given.items():
            try:
                cells.append(timed(make(program), best[case]))
            except (RuntimeError, ValueError) as error:
                print(f"{way}, {case}: {' '.join(str(error).split())[-160:]}")
                cells.append("failed")
        rows.append([way, *cells])
        print(way, *cells, flush=True)
    columns = ["solver", *given]
    print(table(columns, rows))
    write_table(
        "mpc-programs",
        title="Quadratic programs of a sample [ms]",
        command="make bench-mpc",
        columns=columns,
        rows=rows,
    )


if __name__ == "__main__":
    main()
