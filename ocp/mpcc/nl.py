"""Problems of .nl files, with complementarity, and their solutions as .sol files."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np

from ocp.errors import InputError
from ocp.mpcc.forms import StandardForm
from ocp.mpcc.nl_file import NLFile, parse_nl
from ocp.mpcc.programs import MPCC
from ocp.mpcc.solving import MPCCSolution
from ocp.programs.solver import Status

_RESULTS = {
    Status.SOLVED: 0,
    Status.NOT_OPTIMAL: 100,
    Status.UNDECIDED: 100,
    Status.INFEASIBLE: 200,
    Status.UNBOUNDED: 300,
    Status.ITERATION_LIMIT: 400,
    Status.TIME_LIMIT: 400,
}
"""Mapping from statuses to AMPL's ``solve_result_num``; 500, a failure, for all others."""
_LOWER = 1
"""Bit of the kind k in an r-line ``5 k j``: the variable's lower bound is finite."""
_UPPER = 2
"""Bit of the kind k in an r-line ``5 k j``: the variable's upper bound is finite."""


@dataclass(frozen=True)
class NLProblem:
    """Problem of an .nl file: an MPCC to be minimised, its start, whether the file maximises, and the file's contents.

    ``multiplier_of`` (m) gives the source of the multiplier of each row of the file: ("g", i) for row i
    of the MPCC, ("G", i) for the first side of pair i; the third entry is its sign.
    """

    mpcc: MPCC
    start: np.ndarray
    maximise: bool
    contents: NLFile
    multiplier_of: list[tuple[str, int, float]]

    def cost(self, solution: MPCCSolution) -> float:
        """Return the value of the file's objective, without the sign change of a maximisation."""
        return -solution.f if self.maximise else solution.f


def read_nl(path: Path) -> NLProblem:
    """Read the problem of a file; variables without a start in the file start at zero.

    Names of rows and variables are read from the .row and .col files beside it, if there are any.

    Raises :class:`~ocp.errors.InputError` for a file that cannot be read, and as
    :func:`~ocp.mpcc.nl_file.parse_nl` does.
    """
    try:
        text = path.read_text(errors="replace")
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from error
    contents = parse_nl(text, path.stem, _names(path.with_suffix(".col")))
    return problem_of(contents, path.stem, _names(path.with_suffix(".row")))


def _names(path: Path) -> list[str]:
    """Return the lines of a file of names; empty if it does not exist."""
    return path.read_text(errors="replace").split("\n")[:-1] if path.is_file() else []


def problem_of(contents: NLFile, name: str, names: list[str]) -> NLProblem:
    """Return a file's rows and complementarities as a problem; ``names`` are those of the rows, if known.

    With the body c of a row and the bounds l, u of its variable x_j, ``5 k j`` means mixed
    complementarity of c and x_j (:class:`~ocp.mpcc.forms.Relation`): between l and u for k = 3, l and
    infinity for 1, minus infinity and u for 2; for 0 it is ``c = 0``.
    """
    form, rows, ends, titles, multiplier_positions = StandardForm(), [], [], [], []
    for i in range(contents.n_rows):
        body, title = ca.SX(contents.row(i)), names[i] if len(names) > i else f"row {i}"
        kind, j = contents.complements.get(i, (0, -1))
        if j < 0:
            multiplier_positions.append(("g", len(rows), 1.0))
            rows.append(body)
            ends.append(contents.row_ends[i])
            titles.append(title)
            continue
        lower, upper = contents.x_ends[j]
        limits = ca.SX(lower if kind & _LOWER else -math.inf), ca.SX(upper if kind & _UPPER else math.inf)
        n_equations, n_pairs = len(form.rows), len(form.G)
        form.add_mixed(body, contents.x[j], limits, title)
        is_equation = len(form.rows) > n_equations
        # Equations of the form follow all rows of the file, whose number is known at the end.
        sign = -1.0 if kind == _UPPER and not is_equation else 1.0
        multiplier_positions.append(("equation", n_equations, sign) if is_equation else ("G", n_pairs, sign))
    f = ca.SX(contents.sum_terms(contents.objective, contents.gradient))
    x_ends = np.array([*contents.x_ends, *((low, math.inf) for low in form.lower)]).reshape(-1, 2)
    row_ends = np.array([*ends, *[(0.0, 0.0)] * len(form.rows)]).reshape(-1, 2)
    start = np.zeros(contents.x.numel())
    start[list(contents.start)] = list(contents.start.values())
    parts = ca.Function("parts", [contents.x], [ca.vertcat(ca.SX(0, 1), *form.starts)])
    empty = ca.SX(0, 1)
    mpcc = MPCC(
        ca.vertcat(contents.x, *form.variables),
        -f if contents.maximise else f,
        ca.vertcat(empty, *form.G),
        ca.vertcat(empty, *form.H),
        ca.vertcat(empty, *rows, *form.rows),
        lbx=x_ends[:, 0],
        ubx=x_ends[:, 1],
        lbg=row_ends[:, 0],
        ubg=row_ends[:, 1],
        names=form.names,
        name=name,
        row_names=[*titles, *(f"equation {i} of the pairs" for i in range(len(form.rows)))],
    )
    multiplier_of = [
        ("g", len(rows) + i, s) if kind == "equation" else (kind, i, s) for kind, i, s in multiplier_positions
    ]
    start = np.concatenate([start, np.nan_to_num(np.array(parts(start)).ravel())])
    return NLProblem(mpcc, start, contents.maximise, contents, multiplier_of)


def sol_text(problem: NLProblem, solution: MPCCSolution) -> str:
    """Return a solution as the text of a .sol file, which AMPL, Pyomo and JuMP read.

    After the verdict and the options follow m duals, n values of variables and the result code. A dual
    is the derivative of the file's objective by the right-hand side of its row; no duals are written if
    the solution is not feasible.
    """
    contents, duals, multipliers = problem.contents, list[float](), solution.multipliers
    if multipliers is not None:
        values = {"g": multipliers.g, "G": multipliers.G}
        objective_sign = 1.0 if problem.maximise else -1.0
        duals = [objective_sign * sign * float(values[kind][i]) for kind, i, sign in problem.multiplier_of]
    n = contents.x.numel()
    numbers = [contents.n_rows, len(duals), n, n]
    lines = [
        f"centralpath: {solution.verdict}",
        "",
        "Options",
        *(str(number) for number in (len(contents.options), *contents.options, *numbers)),
        *(repr(float(value)) for value in (*duals, *solution.x[:n])),
        f"objno 0 {_RESULTS.get(solution.status, 500)}",
    ]
    return "\n".join(lines) + "\n"
