"""The contact solve of several contacts, as graphs for a loop: Newton's method, then the path.

Newton's method on the smoothed complementarity

    lam + s - sqrt((lam - s)^2 + 4 mu) = 0,    s = z + F lam,

whose root is that of lam s = mu with lam, s > 0, needs three to five iterations from the solution
that each contact would have alone. Where it does not come to rest (a few problems in a hundred,
ill-conditioned and close to complementarity) the interior-point path of
`dynamics.contact.interior_point`, which does not fail on a P-matrix, starts afresh. The exact law
has the active set in place of the root: solve on {lam > s}, until the set stays as it is.

All of it is in the solver's scaling, where F has a unit diagonal. Where the contact is no such
problem (friction, curved gaps) there is the path of :mod:`dynamics.contact.path` alone, in a
rollout from where the step before ended. A sample whose path is lost is tried from the starts of
:mod:`dynamics.contact.starts`, and reported where none of them leads to a solution.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca

from dynamics.contact import interior_point, starts
from dynamics.contact.path import Path
from dynamics.systems.elimination import solve_without_pivoting

# Most iterations of Newton's method before the path.
NEWTON_ITERATIONS = 12
# Newton's error after a step is of the order of its square over sqrt(mu); mu is 1e-14 or more.
_NEWTON_TOLERANCE = 1e-11
# Scaled violation above which the end of a path is no solution.
_MAX_PATH_ERROR = 1e-7
# Most iterations from the step before; ten suffice mostly, and a path that needs many more is lost.
_WARM_ITERATIONS = 16
# Most iterations from ones.
_COLD_ITERATIONS = 24
# Most iterations from each further start.
_SEARCH_ITERATIONS = 40


@dataclass(frozen=True)
class InnerLoop:
    """Graphs of the solve; `data` describes one branch, and every branch is solved on its own.

    `pair` has the `n_pair` unknowns of the path, the last of them where it stands, see
    :class:`~dynamics.contact.path.Path`.

    - `opening: (x, theta, w, p) -> (lam, data)`, first guess and data of all branches in turn
    - `path: (pair, data) -> pair`, from ones until it has arrived
    - `followed: (pair, data) -> lam` [N s], the end of the path out of the scaling, infinite where
      that is no solution, so that the sample is reported with those that are not finite
    - `closing: (x, theta, w, p, lam) -> (x_next, lam, cost)`

    Either with Newton's method before a path of `most` iterations at most,

    - `newton: (lam, data) -> (lam, open)`, open 1 while the iteration has not come to rest
    - `settled: (lam, data) -> lam` [N s], the end of Newton's method out of the scaling

    or with other starts: the path has `most_warm` iterations from `warm`, or `most` from ones, and
    where it does not arrive `most_further` from each of `starts` others, of which the first that
    leads to a solution counts.

    - `warm: (lam_before, data) -> pair`, from the multipliers [N s] of the step before
    - `further: (k, data) -> pair`, start number k
    """

    with_p: ClassVar[tuple[str, ...]] = ("opening", "closing")

    opening: ca.Function
    path: ca.Function
    followed: ca.Function
    closing: ca.Function
    n: int
    n_pair: int
    n_data: int
    branches: int
    newton: ca.Function | None = None
    settled: ca.Function | None = None
    warm: ca.Function | None = None
    further: ca.Function | None = None
    newton_iterations: int = 0
    most: int = interior_point.ITERATIONS
    most_warm: int = 0
    most_further: int = 0
    starts: int = 0

    def graphs(self) -> dict[str, ca.Function]:
        """The graphs that there are, by name."""
        names = ("opening", "newton", "settled", "warm", "further", "path", "followed", "closing")
        by_name = {name: getattr(self, name) for name in names}
        return {name: graph for name, graph in by_name.items() if graph is not None}


def newton_guess(path: Path, data: ca.SX) -> ca.SX:
    """Start of Newton's method: what each contact would have alone, with F_ii = 1."""
    if not path.unique:
        return ca.SX.zeros(path.n)
    z, mu = path.split_data(data)["z"], path.split_data(data)["mu"]
    if path.exact:
        return ca.fmax(0, -z)
    larger_root = ca.fabs(z) + ca.sqrt(z**2 + 4 * mu)
    return ca.if_else(z > 0, 2 * mu / larger_root, larger_root / 2)


def solver_fields(path: Path) -> dict[str, Any]:
    """The fields of an `InnerLoop` that the path determines."""
    pair = ca.SX.sym("pair", path.size)
    path_end = path.ending_function()(pair, path.data)
    sizes = {"n": path.n, "n_pair": path.size, "n_data": path.data.numel()}
    # Infinite where the path was not followed to its end: no sample counts then.
    checked_end = path_end[0] / (ca.mmax(path_end[2]) <= _MAX_PATH_ERROR)
    followed = _function("followed", [pair, path.data], [checked_end])
    return {
        **sizes,
        "path": path.iteration_function(),
        "followed": followed,
        **(_by_newton(path) if path.unique else _from_starts(path)),
    }


def _from_starts(path: Path) -> dict[str, Any]:
    """Fields of a path without Newton's method before it: multipliers may not be unique."""
    iteration_limits = {"most": _COLD_ITERATIONS, "most_warm": _WARM_ITERATIONS, "most_further": _SEARCH_ITERATIONS}
    graphs = {"warm": starts.warm_start(path), "further": starts.further_start(path)}
    return {**iteration_limits, **graphs, "starts": starts.COUNT}


def _by_newton(path: Path) -> dict[str, Any]:
    lam = ca.SX.sym("lam", path.n)
    z, mu, D, c = (path.data_parts[name] for name in ("z", "mu", "D", "c"))
    F = ca.SX(path.pattern, path.data_parts["entries"])
    if path.exact:
        newton_outputs, settled_lam = _active_set(lam, z, F), ca.fmax(0, lam) * c * D
    else:
        s = z + F @ lam
        # Where lam is the small one of the pair, mu / s has all its digits; the root has not.
        newton_outputs, settled_lam = _newton(lam, z, F, mu), ca.if_else(s > lam, mu / s, lam) * c * D
    return {
        "newton": _function("newton", [lam, path.data], list(newton_outputs)),
        "settled": _function("settled", [lam, path.data], [settled_lam]),
        "newton_iterations": NEWTON_ITERATIONS,
    }


def _function(name: str, inputs: list[ca.SX], outputs: list[ca.SX]) -> ca.Function:
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
