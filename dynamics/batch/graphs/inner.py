"""The contact solve of several contacts, as graphs for a loop: Newton's method, then the path.

Newton's method on the smoothed complementarity

    lam + s - sqrt((lam - s)^2 + 4 mu) = 0,    s = z + F lam,

whose root is that of lam s = mu with lam, s > 0, needs three to five iterations from the solution
that each contact would have alone. Where it does not come to rest (a few problems in a hundred,
ill-conditioned and close to complementarity) the interior-point path of
`dynamics.contact.interior_point`, which does not fail on a P-matrix, starts afresh. The exact law
has the active set in place of the root: solve on {lam > s}, until the set stays as it is.

All of it is in the solver's scaling, where F has a unit diagonal. Where the contact is no such
problem (friction, curved gaps) there is the path alone, that of :mod:`dynamics.contact.nonlinear`:
a sample whose path is lost is reported, and not tried from other starts as
:mod:`dynamics.contact.ncp` does.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from dynamics.contact import interior_point
from dynamics.contact.nonlinear import NonlinearPath
from dynamics.systems.elimination import solve_without_pivoting

NEWTON_ITERATIONS = 12
# Newton's error after a step is of the order of its square over sqrt(mu); mu is 1e-14 or more.
_SETTLED = 1e-11
_FOLLOWED = 1e-7


@dataclass(frozen=True)
class InnerLoop:
    """Graphs of the solve; `data` describes one branch, and every branch is solved on its own.

    `pair` has the `n_pair` unknowns of the path.

    - `opening: (x, theta, w, p) -> (lam, data)`, first guess and data of all branches in turn
    - `newton: (lam, data) -> (lam, open)`, open 1 while the iteration has not come to rest
    - `settled: (lam, data) -> lam` [N s], the end of Newton's method out of the scaling
    - `path: (pair, data) -> pair`, from ones until nothing changes, `path_iterations` at most
    - `followed: (pair, data) -> lam` [N s], the end of the path out of the scaling, infinite where
      that is no solution, so that the sample is reported with those that are not finite
    - `closing: (x, theta, w, p, lam) -> (x_next, lam, cost)`
    """

    opening: ca.Function
    newton: ca.Function
    settled: ca.Function
    path: ca.Function
    followed: ca.Function
    closing: ca.Function
    n: int
    n_pair: int
    n_data: int
    branches: int
    newton_iterations: int
    path_iterations: int


@dataclass(frozen=True)
class ScaledProblem:
    """One branch's problem in scaled numbers, packed in one column `data`."""

    data: ca.SX
    z: ca.SX
    F: ca.SX
    mu: ca.SX
    D: ca.SX
    c: ca.SX

    @classmethod
    def symbols(cls, pattern: ca.Sparsity) -> ScaledProblem:
        """The problem as symbols; `pattern` is that of F (n, n)."""
        n, entries = pattern.size1(), pattern.nnz()
        ends = [0, n, n + entries, 2 * n + entries, 3 * n + entries, 3 * n + entries + 1]
        data = ca.SX.sym("data", ends[-1])
        z, F, mu, D, c = ca.vertsplit(data, ends)
        return cls(data, z, ca.SX(pattern, F), mu, D, c)

    @classmethod
    def scale(
        cls, z: ca.SX, F: ca.SX, mu: ca.SX, pattern: ca.Sparsity, exact: bool
    ) -> ScaledProblem:
        """The problem `lam (z + F lam) = mu` scaled; the exact law's path ends at a small mu."""
        z, F, mu, D, c = interior_point.scale(z, F, mu, exact)
        F = ca.project(F, pattern)
        return cls(ca.densify(ca.vertcat(z, F.nz[:], mu, D, c)), z, F, mu, D, c)

    def guess(self, exact: bool) -> ca.SX:
        """What each contact would have alone, with F_ii = 1."""
        if exact:
            return ca.fmax(0, -self.z)
        q = ca.fabs(self.z) + ca.sqrt(self.z**2 + 4 * self.mu)
        return ca.if_else(self.z > 0, 2 * self.mu / q, q / 2)


def loop_graphs(pattern: ca.Sparsity, exact: bool) -> dict[str, ca.Function]:
    """The graphs `newton`, `settled`, `path` and `followed` of an `InnerLoop`."""
    n, problem = pattern.size1(), ScaledProblem.symbols(pattern)
    lam, pair = ca.SX.sym("lam", n), ca.SX.sym("pair", 2 * n)
    scaled = (problem.z, problem.F, problem.mu)
    moved = interior_point.iteration(n)(pair[:n], pair[n:], *scaled)
    ends = interior_point.unscale(n, exact)(pair[:n], pair[n:], *scaled, problem.D, problem.c)
    if exact:
        stepped, at_rest = _active_set(lam, problem), ca.fmax(0, lam)
    else:
        s = problem.z + problem.F @ lam
        # Where lam is the small one of the pair, mu / s has all its digits; the root has not.
        stepped, at_rest = _newton(lam, problem), ca.if_else(s > lam, problem.mu / s, lam)
    graphs = {
        "newton": ([lam, problem.data], list(stepped)),
        "settled": ([lam, problem.data], [at_rest * problem.c * problem.D]),
        "path": ([pair, problem.data], [ca.vertcat(*moved)]),
        "followed": ([pair, problem.data], [_solved(ends[0], ends[2])]),
    }
    return {
        name: ca.Function(name, inputs, [ca.densify(value) for value in outputs])
        for name, (inputs, outputs) in graphs.items()
    }


def path_graphs(path: NonlinearPath) -> dict[str, ca.Function]:
    """The graphs of an `InnerLoop` that follows the path from its start, with no Newton method."""
    lam, data = ca.SX.sym("lam", path.n), path.data
    pair = ca.SX.sym("pair", 2 * path.n + 1)
    ends = path.ending()(pair, data)
    return {
        "newton": ca.Function("newton", [lam, data], [lam, ca.SX(ca.DM.ones(1))]),
        "settled": ca.Function("settled", [lam, data], [lam]),
        "path": path.iteration(),
        "followed": ca.Function("followed", [pair, data], [_solved(ends[0], ends[2])]),
    }


def _solved(lam: ca.SX, error: ca.SX) -> ca.SX:
    """``lam``, or infinity where the path was not followed to its end: no sample counts then."""
    return lam / (ca.mmax(error) <= _FOLLOWED)


def _newton(lam: ca.SX, problem: ScaledProblem) -> tuple[ca.SX, ca.SX]:
    s = problem.z + problem.F @ lam
    r = ca.sqrt((lam - s) ** 2 + 4 * problem.mu)
    lean = (lam - s) / r
    matrix = ca.diag(1 - lean) + ca.diag(1 + lean) @ problem.F
    step = solve_without_pivoting(matrix, r - lam - s)
    size = ca.mmax(ca.fabs(step))
    return lam + step, size > _SETTLED * ca.fmax(1, ca.mmax(ca.fabs(lam)))


def _active_set(lam: ca.SX, problem: ScaledProblem) -> tuple[ca.SX, ca.SX]:
    active = lam > problem.z + problem.F @ lam
    matrix = ca.diag(1 - active) + ca.diag(active) @ problem.F
    solved = solve_without_pivoting(matrix, -active * problem.z)
    again = solved > problem.z + problem.F @ solved
    return solved, ca.mmax(ca.fabs(again - active)) > 0
