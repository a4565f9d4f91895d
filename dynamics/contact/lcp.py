"""The solver of one step whose contact is a linear complementarity problem."""

from __future__ import annotations

from functools import cache

import casadi as ca

from dynamics.contact.interior_point import exact_scalar_solution, follow, scalar_solution
from dynamics.contact.path import Path


@cache
def lcp_solver(n: int, exact: bool = False) -> ca.Function:
    """Solve ``lam (z + F lam) = mu`` for lam > 0: ``(z, F, mu) -> (lam, s, error)``.

    ``z``, ``mu``, ``lam`` (impulse), ``s`` (gap), ``error`` are (n, 1), F is a (n, n) P-matrix;
    ``error`` is each contact's scaled violation ``max(|lam s - mu|, |z + F lam - s|)``, 1e-10 or
    less where the path was followed to its end, infinite where the iterates diverged (F is no
    P-matrix). With ``exact`` mu is ignored: the path is followed to
    :data:`~dynamics.contact.path.MU_EXACT`, the contacts with lam > s taken as active, and the
    linear system on that active set solved, so that the complementarity is exact to rounding.

    One contact is solved in closed form. No derivative of this function is of use: differentiate
    through the implicit function theorem (:mod:`dynamics.contact.step`).
    """
    z, mu, F = ca.SX.sym("z", n), ca.SX.sym("mu", n), ca.SX.sym("F", n, n)
    names = ["z", "F", "mu"], ["lam", "s", "error"]
    if n == 1:
        lam = exact_scalar_solution(z, F) if exact else scalar_solution(z, F, mu)
        s = ca.fmax(0, z) if exact else ca.if_else(z > 0, z + F * lam, mu / ca.fmax(lam, 1e-300))
        return ca.Function("contact_1", [z, F, mu], [lam, s, 0 * z], *names)
    path = Path(ca.Sparsity.dense(n, n), exact)
    opening = ca.Function("opening", [z, F, mu], [path.opening(z, F, mu)])
    arguments = [ca.MX.sym("z", n), ca.MX.sym("F", n, n), ca.MX.sym("mu", n)]
    data = opening(*arguments)
    pair = follow(path.iteration())(ca.MX.ones(path.size), data)
    return ca.Function(f"contact_{n}", arguments, list(path.ending()(pair, data)), *names)
