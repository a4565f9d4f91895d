"""The contact solve of several contacts, as graphs for a loop: Newton's method, then the path.

Newton's method on the smoothed complementarity

    lam + s - sqrt((lam - s)^2 + 4 mu) = 0,    s = z + F lam,

whose root is that of lam s = mu with lam, s > 0, needs three to five iterations from the solution
that each contact would have alone. Where it does not come to rest (a few problems in a hundred,
ill-conditioned and close to complementarity) the interior-point path of
`dynamics.contact.interior_point`, which does not fail on a P-matrix, starts afresh. The exact law
has the active set in place of the root: solve on {lam > s}, until the set stays as it is.

All of it is in the solver's scaling, where F has a unit diagonal. Where the contact is no such
problem (friction, curved gaps) there is the path of :mod:`dynamics.contact.path` alone: a sample
whose path is lost is reported, and not tried from other starts as :mod:`dynamics.contact.ncp` does.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import casadi as ca

from dynamics.contact.path import Path
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

    with_p: ClassVar[tuple[str, ...]] = ("opening", "closing")

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


def guess(path: Path, data: ca.SX) -> ca.SX:
    """Where Newton's method starts: what each contact would have alone, with F_ii = 1."""
    if not path.unique:
        return ca.SX.zeros(path.n)
    z, mu = path.parts(data)["z"], path.parts(data)["mu"]
    if path.exact:
        return ca.fmax(0, -z)
    q = ca.fabs(z) + ca.sqrt(z**2 + 4 * mu)
    return ca.if_else(z > 0, 2 * mu / q, q / 2)


def loop_graphs(path: Path) -> dict[str, ca.Function]:
    """The graphs `newton`, `settled`, `path` and `followed` of an `InnerLoop`.

    Where the multipliers may not be unique there is no Newton method before the path.
    """
    lam, pair = ca.SX.sym("lam", path.n), ca.SX.sym("pair", path.size)
    z, mu, D, c = (path.known[name] for name in ("z", "mu", "D", "c"))
    ends = path.ending()(pair, path.data)
    F = ca.SX(path.pattern, path.known["entries"]) if path.unique else None
    if F is None:
        stepped, at_rest = (lam, ca.SX.ones(1)), lam
    elif path.exact:
        stepped, at_rest = _active_set(lam, z, F), ca.fmax(0, lam) * c * D
    else:
        s = z + F @ lam
        # Where lam is the small one of the pair, mu / s has all its digits; the root has not.
        stepped, at_rest = _newton(lam, z, F, mu), ca.if_else(s > lam, mu / s, lam) * c * D
    graphs = {
        "newton": ([lam, path.data], list(stepped)),
        "settled": ([lam, path.data], [at_rest]),
        "followed": ([pair, path.data], [_solved(ends[0], ends[2])]),
    }
    made = {
        name: ca.Function(name, inputs, [ca.densify(value) for value in outputs])
        for name, (inputs, outputs) in graphs.items()
    }
    return {**made, "path": path.iteration()}


def _solved(lam: ca.SX, error: ca.SX) -> ca.SX:
    """``lam``, or infinity where the path was not followed to its end: no sample counts then."""
    return lam / (ca.mmax(error) <= _FOLLOWED)


def _newton(lam: ca.SX, z: ca.SX, F: ca.SX, mu: ca.SX) -> tuple[ca.SX, ca.SX]:
    s = z + F @ lam
    r = ca.sqrt((lam - s) ** 2 + 4 * mu)
    lean = (lam - s) / r
    matrix = ca.diag(1 - lean) + ca.diag(1 + lean) @ F
    step = solve_without_pivoting(matrix, r - lam - s)
    size = ca.mmax(ca.fabs(step))
    return lam + step, size > _SETTLED * ca.fmax(1, ca.mmax(ca.fabs(lam)))


def _active_set(lam: ca.SX, z: ca.SX, F: ca.SX) -> tuple[ca.SX, ca.SX]:
    active = lam > z + F @ lam
    matrix = ca.diag(1 - active) + ca.diag(active) @ F
    solved = solve_without_pivoting(matrix, -active * z)
    again = solved > z + F @ solved
    return solved, ca.mmax(ca.fabs(again - active)) > 0
