"""The path solver for systems whose contact is no LCP with a P-matrix: curved gaps, friction.

With ``x_next = a + B lam`` the contact is the nonlinear complementarity problem
``lam gap(a + B lam, lam) = mu``. Each iteration of the path solver sees its linearisation at the
present lam, whose defect is the true one; the rest is that of
:mod:`dynamics.contact.interior_point`.
"""

from __future__ import annotations

import casadi as ca

from dynamics.contact import interior_point
from dynamics.systems import ContactSystem

MU_EXACT = 1e-12
"""The exact law is the path's point at this mu, in scaled units."""


def is_linear(system: ContactSystem) -> bool:
    """Whether the contact is an LCP whose matrix has a positive diagonal."""
    F = system.reduced.F
    return system.reduced.affine and not any(F[i, i].is_zero() for i in range(system.nlam))


def scaling(z: ca.SX, F: ca.SX, mu: ca.SX) -> tuple[ca.SX, ca.SX]:
    """D (n, 1) and c so that ``z D / c`` and ``D F D`` are of order one.

    As :func:`dynamics.contact.interior_point.scaling`; a slip pair, whose F_ii is zero, is scaled
    against the pairs that it meets.
    """
    n = z.numel()
    D: list[ca.SX | None] = [None if F[i, i].is_zero() else 1 / ca.sqrt(F[i, i]) for i in range(n)]
    first = list(D)
    for i in range(n):
        if first[i] is None:
            met = [ca.fabs(F[i, j]) * first[j] for j in range(n)
                   if first[j] is not None and not F[i, j].is_zero()]  # fmt: skip
            D[i] = 1 / ca.mmax(ca.vertcat(*met))
    column = ca.vertcat(*[ca.SX(d) for d in D])
    size = ca.mmax(ca.vertcat(ca.fabs(z * column), ca.sqrt(mu)))
    return column, ca.fmax(size, 1e-150)


def ncp_solver(system: ContactSystem, exact: bool = False) -> ca.Function:
    """Solve one step of a system: ``(x, u, p, mu) -> (x_next, lam, gap, error)``.

    ``p`` are the system's parameters, ``mu``, ``lam``, ``gap``, ``error`` (nlam, 1), error each
    pair's scaled violation, 1e-10 or less where the path was followed to its end. With ``exact``
    mu is ignored and the point at :data:`MU_EXACT` returned.
    """
    x, u, p = system.x, system.u, system.parameters.vector
    mu, n = ca.SX.sym("mu", system.nlam), system.nlam
    reduced = system.reduced
    D, c = scaling(reduced.z, reduced.F, 0 * mu if exact else mu)
    least = ca.SX.ones(n) * MU_EXACT
    target = least if exact else ca.fmax(mu / c**2, interior_point.MU_LEAST)
    opening = ca.Function(
        "opening", [x, u, p, mu], [*(ca.densify(v) for v in (reduced.a, reduced.B, D)), c, target]
    )
    body, closing = _iteration(system), _closing(system)
    arguments = [ca.MX.sym("x", system.nx), ca.MX.sym("u", system.nu),
                 ca.MX.sym("p", p.numel()), ca.MX.sym("mu", n)]  # fmt: skip
    data = [*arguments[:3], *opening(*arguments)]
    end = interior_point.follow(body)(ca.MX.ones(2 * n), *data)
    names = ["x", "u", "p", "mu"], ["x_next", "lam", "gap", "error"]
    return ca.Function("contact_ncp", arguments, closing(end, *data), *names)


def _linearised(system: ContactSystem) -> tuple[list[ca.SX], ca.SX, ca.SX, ca.SX, ca.SX]:
    """Symbols ``(x, u, p, a, B, D, c, mu)``, scaled lam, and the scaled gap and F there."""
    n, nx = system.nlam, system.nx
    a, B, D = ca.SX.sym("a", nx), ca.SX.sym("B", nx, n), ca.SX.sym("D", n)
    c, mu, lam = ca.SX.sym("c"), ca.SX.sym("mu", n), ca.SX.sym("lam", n)
    by_state, by_lam = (ca.jacobian(system.gap, part) for part in (system.x_next, system.lam))
    at = c * D * lam
    gap, by_state, by_lam = ca.substitute(
        [system.gap, by_state, by_lam], [system.x_next, system.lam], [a + B @ at, at]
    )
    F = ca.diag(D) @ (by_lam + by_state @ B) @ ca.diag(D)
    symbols = [system.x, system.u, system.parameters.vector, a, B, D, c, mu]
    return symbols, lam, gap * D / c, F, mu


def _iteration(system: ContactSystem) -> ca.Function:
    """One iteration: ``(pair, x, u, p, a, B, D, c, mu) -> pair``, pair = (lam, s) scaled."""
    n, s = system.nlam, ca.SX.sym("s", system.nlam)
    symbols, lam, gap, F, mu = _linearised(system)
    moved = interior_point.advance(lam, s, gap - F @ lam, F, mu)
    pair = ca.SX.sym("pair", 2 * n)
    out = ca.substitute(ca.vertcat(*moved), ca.vertcat(lam, s), pair)
    return ca.Function("path_ncp", [pair, *symbols], [out])


def _closing(system: ContactSystem) -> ca.Function:
    """Out of the scaling: ``(pair, x, u, p, a, B, D, c, mu) -> (x_next, lam, gap, error)``."""
    n = system.nlam
    s = ca.SX.sym("s", n)
    symbols, lam, gap, _, mu = _linearised(system)
    a, B, D, c = symbols[3:7]
    error = ca.fmax(ca.fabs(lam * s - mu), ca.fabs(gap - s) / (1 + s))
    # Diverged: not a number, which would pass for small in a comparison.
    error = ca.if_else(error < ca.inf, error, ca.inf)
    at = c * D * lam
    pair = ca.SX.sym("pair", 2 * n)
    out = ca.substitute([a + B @ at, at, s * c / D, error], [ca.vertcat(lam, s)], [pair])
    return ca.Function("closing", [pair, *symbols], [ca.densify(v) for v in out])
