"""The path solver for systems whose contact is no LCP with a P-matrix: curved gaps, friction.

With ``x_next = a + B lam`` the contact is the nonlinear complementarity problem
``lam gap(a + B lam, lam) = mu``. The path is followed twice, by the iteration of
:mod:`dynamics.contact.interior_point`: first with the gap linearised where the step starts, down to
:data:`MU_LINEAR`, then with the true gap, linearised at every iteration where it stands. Started
right away on the true gap, large trial impulses would spin light bodies round to solutions of no
meaning.
"""

from __future__ import annotations

import casadi as ca

from dynamics.contact import interior_point
from dynamics.systems import ContactSystem

MU_EXACT = 1e-12
"""The exact law is the path's point at this mu, in scaled units."""
MU_LINEAR = 1e-4
"""Where the path of the linearised gap is left for that of the true one, in scaled units."""

# The linear model of a curved gap promises a better point at every iteration, down to rounding.
_REST = 1e-12


def scaling(z: ca.SX, F: ca.SX, mu: ca.SX) -> tuple[ca.SX, ca.SX]:
    """D (n, 1) and c so that ``z D / c`` and ``D F D`` are of order one.

    As :func:`dynamics.contact.interior_point.scaling`; a slip pair, whose F_ii is zero, is scaled
    against the pairs that it meets.
    """
    n = z.numel()
    known = {i: 1 / ca.sqrt(F[i, i]) for i in range(n) if not F[i, i].is_zero()}
    D = dict(known)
    for i in set(range(n)) - set(known):
        met = [ca.fabs(F[i, j]) * known[j] for j in known if not F[i, j].is_zero()]
        D[i] = 1 / ca.mmax(ca.vertcat(*met))
    column = ca.vertcat(*(D[i] for i in range(n)))
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
    D, c = scaling(reduced.z_linear, reduced.F, 0 * mu if exact else mu)
    least = ca.SX.ones(n) * MU_EXACT
    target = least if exact else ca.fmax(mu / c**2, interior_point.MU_LEAST)
    start = target if reduced.affine else ca.fmax(target, MU_LINEAR)
    scaled = [reduced.z_linear * D / c, ca.diag(D) @ reduced.F @ ca.diag(D)]
    opening = ca.Function("opening", [x, u, p, mu], [
        *(ca.densify(v) for v in (reduced.a, reduced.B, D)), c, target, start, scaled[0],
        scaled[1][reduced.F.sparsity()].nz[:],
    ])  # fmt: skip
    arguments = [ca.MX.sym("x", system.nx), ca.MX.sym("u", system.nu),
                 ca.MX.sym("p", p.numel()), ca.MX.sym("mu", n)]  # fmt: skip
    *opened, start, z, F = opening(*arguments)
    data = [*arguments[:3], *opened]
    first = _linear_iteration(reduced.F.sparsity())
    pair = interior_point.follow(first)(ca.MX.ones(2 * n), z, F, start)
    if not reduced.affine:
        pair = interior_point.follow(_iteration(system))(pair, *data)
    names = ["x", "u", "p", "mu"], ["x_next", "lam", "gap", "error"]
    outputs = list(_closing(system)(pair, *data))
    return ca.Function("contact_ncp", arguments, outputs, *names)


def _linear_iteration(pattern: ca.Sparsity) -> ca.Function:
    """One iteration on a scaled LCP: ``(pair, z, nonzeros of F, mu) -> pair``."""
    n = pattern.size1()
    pair, z, mu = ca.SX.sym("pair", 2 * n), ca.SX.sym("z", n), ca.SX.sym("mu", n)
    F = ca.SX.sym("F", pattern.nnz())
    moved = interior_point.advance(pair[:n], pair[n:], z, ca.SX(pattern, F), mu)
    return ca.Function("path_linear", [pair, z, F, mu], [ca.vertcat(*moved)])


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
    moved = interior_point.advance(lam, s, gap - F @ lam, F, mu, _REST)
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
