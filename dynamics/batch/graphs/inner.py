"""Graphs of the iterations that solve for several contacts: Newton's method, then the interior-point path.

Newton's method for the smoothed complementarity

    lam + s - sqrt((lam - s)^2 + 4 mu) = 0,    s = z + F lam,

which is equivalent to lam s = mu with lam, s > 0, needs three to five iterations from the solution
of each contact alone. If it does not converge (a few problems in a hundred, ill-conditioned and
close to complementarity) the interior-point path of `dynamics.contact.interior_point`, which does
not fail on a P-matrix, starts with all unknowns equal to 1. For the exact law the iteration updates the active set:
the equations of {lam > s} are solved until this set no longer changes.

All graphs use the solver's scaling, where F has a unit diagonal. If the contact is not linear
(friction, curved gaps) only the path of :mod:`dynamics.contact.path` is used, which starts from the solution of
the previous step of the rollout. If the path fails, it is followed from the starts of
:mod:`dynamics.contact.starts`; if no start leads to a solution, the sample is reported.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca

from dynamics.contact import interior_point, starts
from dynamics.contact.path import MAX_ERROR, Path
from dynamics.systems.elimination import solve_without_pivoting

# Maximum number of iterations of Newton's method, before the path is used.
NEWTON_ITERATIONS = 12
# Step size relative to lam at which Newton's method ends: the error after a step is of the order of
# its square over sqrt(mu), and mu is at least 1e-14.
_NEWTON_TOLERANCE = 1e-11
# Maximum number of iterations of a path from the solution of the previous step, or with all unknowns equal to 1 at
# first; ten mostly suffice. With sixteen more samples of a quadruped need other starts, which takes a fifth longer.
_PATH_ITERATIONS = 24
# Maximum number of iterations of a path from each of the other starts.
_SEARCH_ITERATIONS = 40


@dataclass(frozen=True)
class InnerLoop:
    """Graphs of the contact solver; each branch is solved separately, with its own `data`.

    `pair` has the `n_pair` unknowns of the path; the last of these is the phase of the path, see
    :class:`~dynamics.contact.path.Path`.

    - `opening: (x, theta, w, p) -> (lam, data)`, first guess and data of all branches in order
    - `path: (pair, data) -> pair`, one iteration along the path, which starts with `pair` equal to 1
    - `path_solution: (pair, data) -> lam` [N s], the unscaled multipliers at the end of the path, infinite if the end
    is not a solution, so that the sample is reported as not finite
    - `closing: (x, theta, w, p, lam) -> (x_next, lam, cost)`

    Either Newton's method comes before a path of at most `max_iterations` iterations,

    - `newton: (lam, data) -> (lam, open)`, one iteration, with open 1 until it has converged
    - `newton_solution: (lam, data) -> lam` [N s], the unscaled multipliers at the end of Newton's method

    or the path is tried from several starts: at most `max_iterations` iterations from `warm`, or from `pair` equal to
    1 at first; if these do not converge, at most `max_other_iterations` from each of `starts` other starts, until a
    solution is found.

    - `warm: (lam_before, data) -> pair`, the start at the multipliers [N s] of the previous step
    - `other_start: (k, data) -> pair`, the other start number k
    """

    with_p: ClassVar[tuple[str, ...]] = ("opening", "closing")

    opening: ca.Function
    path: ca.Function
    path_solution: ca.Function
    closing: ca.Function
    n: int
    n_pair: int
    n_data: int
    branches: int
    newton: ca.Function | None = None
    newton_solution: ca.Function | None = None
    warm: ca.Function | None = None
    other_start: ca.Function | None = None
    newton_iterations: int = 0
    max_iterations: int = interior_point.ITERATIONS
    max_other_iterations: int = 0
    starts: int = 0

    def graphs(self) -> dict[str, ca.Function]:
        """Return a dict from name to graph, without the graphs that are None."""
        names = ("opening", "newton", "newton_solution", "warm", "other_start", "path", "path_solution", "closing")
        by_name = {name: getattr(self, name) for name in names}
        return {name: graph for name, graph in by_name.items() if graph is not None}


def newton_guess(path: Path, data: ca.SX) -> ca.SX:
    """Return the start of Newton's method (n, 1), the solution of each contact alone with F_ii = 1."""
    if not path.unique:
        return ca.SX.zeros(path.n)
    z, mu = path.split_data(data)["z"], path.split_data(data)["mu"]
    if path.exact:
        return ca.fmax(0, -z)
    larger_root = ca.fabs(z) + ca.sqrt(z**2 + 4 * mu)
    return ca.if_else(z > 0, 2 * mu / larger_root, larger_root / 2)


def solver_fields(path: Path) -> dict[str, Any]:
    """Return a dict of the fields of an `InnerLoop` that the path determines."""
    pair = ca.SX.sym("pair", path.size)
    path_end = path.ending_function()(pair, path.data)
    sizes = {"n": path.n, "n_pair": path.size, "n_data": path.data.numel()}
    # Infinite if the path was not followed to its end, so that the sample is reported as not finite.
    checked_end = path_end[0] / (ca.mmax(path_end[2]) <= MAX_ERROR)
    path_solution = dense_function("path_solution", [pair, path.data], [checked_end])
    return {
        **sizes,
        "path": path.iteration_function(),
        "path_solution": path_solution,
        **(_by_newton(path) if path.unique else _from_starts(path)),
    }


def _from_starts(path: Path) -> dict[str, Any]:
    """Return the fields of an `InnerLoop` without Newton's method, since multipliers may not be unique."""
    iteration_limits = {"max_iterations": _PATH_ITERATIONS, "max_other_iterations": _SEARCH_ITERATIONS}
    graphs = {"warm": starts.warm_start(path), "other_start": starts.other_start(path)}
    return {**iteration_limits, **graphs, "starts": starts.COUNT}


def _by_newton(path: Path) -> dict[str, Any]:
    lam = ca.SX.sym("lam", path.n)
    z, mu, D, c = (path.data_parts[name] for name in ("z", "mu", "D", "c"))
    F = ca.SX(path.pattern, path.data_parts["entries"])
    if path.exact:
        newton_outputs, newton_lam = _active_set(lam, z, F), ca.fmax(0, lam) * c * D
    else:
        s = z + F @ lam
        # For lam < s, mu / s is accurate to all digits, but the root is not.
        newton_outputs, newton_lam = _newton(lam, z, F, mu), ca.if_else(s > lam, mu / s, lam) * c * D
    return {
        "newton": dense_function("newton", [lam, path.data], list(newton_outputs)),
        "newton_solution": dense_function("newton_solution", [lam, path.data], [newton_lam]),
        "newton_iterations": NEWTON_ITERATIONS,
    }


def dense_function(name: str, inputs: list[ca.SX], outputs: list[ca.SX]) -> ca.Function:
    """Return a function of ``inputs`` whose outputs are dense."""
    return ca.Function(name, inputs, [ca.densify(value) for value in outputs])


def _newton(lam: ca.SX, z: ca.SX, F: ca.SX, mu: ca.SX) -> tuple[ca.SX, ca.SX]:
    s = z + F @ lam
    r = ca.sqrt((lam - s) ** 2 + 4 * mu)
    slope = (lam - s) / r
    matrix = ca.diag(1 - slope) + ca.diag(1 + slope) @ F
    step = solve_without_pivoting(matrix, r - lam - s)
    size = ca.mmax(ca.fabs(step))
    return lam + step, size > _NEWTON_TOLERANCE * ca.fmax(1, ca.mmax(ca.fabs(lam)))


def _active_set(lam: ca.SX, z: ca.SX, F: ca.SX) -> tuple[ca.SX, ca.SX]:
    active = lam > z + F @ lam
    matrix = ca.diag(1 - active) + ca.diag(active) @ F
    solution = solve_without_pivoting(matrix, -active * z)
    active_after = solution > z + F @ solution
    return solution, ca.mmax(ca.fabs(active_after - active)) > 0
