"""The solver of one step whose contact is not linear: the interior-point path, then many other starts.

The direction of a curved gap may reverse within a step; the path may then fail although the step has a
solution. A point of the path, lam s = mu with lam, s > 0, is a root of the smoothed complementarity function of
Fischer and Burmeister,

``phi(lam, s) = lam + s - sqrt(lam² + s² + 2 mu)``

(Kanzow, doi 10.1137/S1052623493262862); a solver for this root may pass through lam and s that are not
positive. The Levenberg-Marquardt method minimises ``|phi(lam, gap(lam))|²`` at the given mu, and
starts again from another point if it stalls. Such steps have several solutions; the impulses of the
starts increase, so that solutions in which light bodies are thrown far are tried last.
"""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca

from dynamics.contact.interior_point import repeat_until_rest
from dynamics.contact.path import MAX_ERROR, Path
from dynamics.contact.reduced_path import path_of
from dynamics.contact.starts import MIN_EXPONENT, TINY_IMPULSE, irrational_numbers
from dynamics.systems import ContactSystem

# Scaled violation below which a point is a solution and the search ends.
_SOLVED_ERROR = 1e-10
# Maximum number of starts, as a power of two.
_LOG2_STARTS = 8
# Maximum number of iterations from each start, as a power of two.
_LOG2_ITERATIONS = 6
# Largest impulse at the first of the other starts, as a power of ten in scaled units.
_MAX_EXPONENT_FIRST = -1
# Largest impulse at the last start, as a power of ten in scaled units.
_MAX_EXPONENT_LAST = 2
# Damping of Levenberg and Marquardt at the start of a descent.
_FIRST_DAMPING = 1e-2
# Minimum damping.
_MIN_DAMPING = 1e-14
# Damping above which a descent counts as stalled.
_MAX_DAMPING = 1e12
# Residual of the complementarity function that counts as a root.
_ROOT_RESIDUAL = 1e-11
# Relative residual below which the path solver polishes the root.
_POLISH_ERROR = 1e-6


def ncp_solver(system: ContactSystem, exact: bool = False) -> ca.Function:
    """Return the solver ``(x, u, p, mu) -> (x_next, lam, gap, error)`` of one step of a system.

    ``p`` are the system's parameters; ``mu``, ``lam``, ``gap``, ``error`` are (nlam, 1). ``error`` is each
    pair's scaled violation, at most 1e-10 if the step was solved. With ``exact`` mu is ignored, and the
    point of the path at :data:`~dynamics.contact.path.MU_EXACT` is returned.
    """
    names = ["x", "u", "p", "mu"], ["x_next", "lam", "gap", "error"]
    step_symbols, mu = [system.x, system.u, system.parameters.vector], ca.SX.sym("mu", system.nlam)
    if not system.nlam:
        outputs = [system.x_next_expr, mu, mu, mu]
        return ca.Function("contact_0", [*step_symbols, mu], outputs, *names, {"cse": True})
    path = path_of(system, exact)
    opening = ca.Function("opening", [*step_symbols, mu], [path.opening_data_of(system, mu)], {"cse": True})
    x_next = ca.Function("x_next", [*step_symbols, system.lam], [system.x_next_expr], {"cse": True})
    arguments = [ca.MX.sym(f"in_{k}", opening.numel_in(k)) for k in range(4)]
    data, ending, followed = opening(*arguments), path.ending_function(), repeat_until_rest(path.iteration_function())
    pair = followed(ca.MX.ones(path.size), data)
    lam, gap, error = _recovery_function(path, followed)(*ending(pair, data), pair, data)
    outputs = [x_next(*arguments[:3], lam), lam, gap, error]
    return ca.Function("contact_ncp", arguments, outputs, *names)


def _recovery_function(path: Path, followed: ca.Function) -> ca.Function:
    """Return the function ``(lam, gap, error, pair, data) -> (lam, gap, error)`` that tries other starts if needed."""
    n, size = path.n, path.size
    names = {"lam": n, "gap": n, "error": n, "pair": size, "data": path.data.numel()}
    symbols = [ca.MX.sym(name, length) for name, length in names.items()]
    lam, gap, error, pair, data = symbols
    search = _repeat(_attempt(path, followed), _LOG2_STARTS, lambda best_point: best_point[size] > _SOLVED_ERROR)
    best_point = search(ca.vertcat(pair, ca.mmax(error), 0), data)
    # If the data are not finite, no start leads to a solution.
    best_point = ca.Function("starts", symbols, [*path.ending_function()(best_point[:size], data)])
    unchanged = ca.Function("stay", symbols, [lam, gap, error])
    is_lost = ca.logic_and(ca.mmax(error) > MAX_ERROR, ca.mmax(ca.fabs(data)) < ca.inf)
    recovery = ca.Function.if_else("again", best_point, unchanged)
    return ca.Function("recovered", symbols, [*recovery(is_lost, *symbols)])


def _attempt(path: Path, followed: ca.Function) -> ca.Function:
    """Return the function ``(best, data) -> best`` that tries one start.

    ``best`` contains the pair with the lowest error so far, this error, and the number of the next start.
    """
    n, size = path.n, path.size
    earlier, data = ca.MX.sym("best", size + 2), ca.MX.sym("data", path.data.numel())
    descent = _repeat(_damped_step(path), _LOG2_ITERATIONS, lambda point: point[n] < _MAX_DAMPING)
    lam = descent(_start_function(path)(earlier[size + 1], data), data)[:n]
    pair, root_error = _pair_function(path)(lam, data)
    pair = _where(root_error < _POLISH_ERROR, followed, pair, data)
    error = ca.mmax(path.ending_function()(pair, data)[2])
    best_pair = ca.if_else(error < earlier[size], ca.vertcat(pair, error), earlier[: size + 1])
    return ca.Function("attempt", [earlier, data], [ca.vertcat(best_pair, earlier[size + 1] + 1)])


def _start_function(path: Path) -> ca.Function:
    """Return the function ``(k, data) -> (lam, damping)`` (n + 1, 1) of start number k and its first damping.

    The first start has almost no impulse, as for a body in the air; the exponents of the others are a
    Kronecker sequence, which fills the cube evenly for any number of starts.
    """
    k, n = ca.SX.sym("k"), path.n
    gap, _ = path.true_gap_at(ca.SX.zeros(n))
    gap_size = ca.mmax(ca.vertcat(ca.fabs(gap), ca.sqrt(path.data_parts["mu"])))
    sequence = k * ca.DM(irrational_numbers(n))
    largest_exponent = _MAX_EXPONENT_FIRST + (_MAX_EXPONENT_LAST - _MAX_EXPONENT_FIRST) * k / 2**_LOG2_STARTS
    exponent = MIN_EXPONENT + (largest_exponent - MIN_EXPONENT) * (sequence - ca.floor(sequence))
    lam = ca.if_else(k > 0, 10**exponent, TINY_IMPULSE)
    return ca.Function("start", [k, path.data], [ca.vertcat(gap_size * lam, _FIRST_DAMPING)])


def _damped_step(path: Path) -> ca.Function:
    """Return the function ``(point, data) -> point`` of one iteration.

    ``point`` is (lam, damping); the damping is infinite at a root.
    """
    n, lam = path.n, ca.SX.sym("lam", path.n)
    residual = ca.Function("residual", [lam, path.data], [*_residual(path, lam)], {"cse": True})
    point, data = ca.MX.sym("point", n + 1), ca.MX.sym("data", path.data.numel())
    phi, jacobian = residual(point[:n], data)
    # A call of a linear solver: its operations as a graph would take seconds to build for 70 pairs, and run longer.
    trial_lam = point[:n] - ca.solve(_damped(jacobian, point[n]), jacobian.T @ phi, "ldl")
    new_point = _better(point, trial_lam, phi, residual(trial_lam, data)[0])
    return ca.Function("damped_step", [point, data], [new_point])


def _residual(path: Path, lam: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return the complementarity function phi (n, 1) and its derivative by lam (n, n)."""
    gap, slopes = path.true_gap_at(lam)
    phi, by_lam, by_gap = _phi(path, lam, gap)
    return phi, ca.diag(by_lam) + ca.diag(by_gap) @ slopes


def _damped(jacobian: ca.MX, damping: ca.MX) -> ca.MX:
    """Return the damped normal matrix (n, n) of Levenberg and Marquardt."""
    normal = jacobian.T @ jacobian
    return normal + damping * ca.diag(ca.fmax(ca.diag(normal), 1e-12))


def _better(point: ca.MX, trial_lam: ca.MX, phi: ca.MX, trial_phi: ca.MX) -> ca.MX:
    """Return the point after a trial: at ``trial_lam`` with less damping if phi is smaller there, else with more."""
    lam, damping = point[:-1], point[-1]
    better = ca.sumsqr(trial_phi) < ca.sumsqr(phi)
    lam, phi = ca.if_else(better, trial_lam, lam), ca.if_else(better, trial_phi, phi)
    damping = ca.if_else(better, ca.fmax(damping / 5, _MIN_DAMPING), 4 * damping)
    is_at_root = ca.mmax(ca.fabs(phi)) <= _ROOT_RESIDUAL
    return ca.vertcat(lam, ca.if_else(is_at_root, ca.inf, damping))


def _pair_function(path: Path) -> ca.Function:
    """Return the function ``(lam, data) -> (pair, error)``: the pair at lam, and the relative residual of phi there."""
    lam, mu = ca.SX.sym("lam", path.n), path.data_parts["mu"]
    gap, _ = path.true_gap_at(lam)
    # Near a root only the larger member of a pair is accurate.
    larger = ca.fmax(ca.fmax(lam, gap), _ROOT_RESIDUAL)
    smaller = mu / larger
    pair = [ca.if_else(lam > gap, *pair_values) for pair_values in ((larger, smaller), (smaller, larger))]
    root_error = ca.mmax(ca.fabs(_phi(path, lam, gap)[0]) / (1 + larger))
    outputs = [path.pack_pair(*pair), root_error]
    return ca.Function("paired", [lam, path.data], outputs, {"cse": True})


def _phi(path: Path, lam: ca.SX, gap: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return the complementarity function phi of every pair, and its derivatives with respect to lam and gap."""
    size = ca.sqrt(lam**2 + gap**2 + 2 * path.data_parts["mu"])
    return lam + gap - size, 1 - lam / size, 1 - gap / size


def _repeat(body: ca.Function, doublings: int, unfinished: Callable[[ca.MX], ca.MX]) -> ca.Function:
    """Return a function that repeats ``body: (point, data) -> point`` while ``unfinished(point)``.

    It evaluates ``body`` at least once and at most 2^doublings times.
    """
    name, size, n_data = body.name(), body.numel_in(0), body.numel_in(1)
    for k in range(doublings):
        point, data = ca.MX.sym("point", size), ca.MX.sym("data", n_data)
        repeated = body(point, data)
        repeated = _where(unfinished(repeated), body, repeated, data)
        body = ca.Function(f"{name}_{k}", [point, data], [repeated])
    return body


def _where(condition: ca.MX, body: ca.Function, point: ca.MX, data: ca.MX) -> ca.MX:
    """Return ``body(point, data)`` if ``condition`` holds, else ``point`` (``body`` is then not evaluated)."""
    symbols = [ca.MX.sym("point", point.numel()), ca.MX.sym("data", data.numel())]
    unchanged = ca.Function("stay", symbols, symbols[:1])
    return ca.Function.if_else(f"if_{body.name()}", body, unchanged)(condition, point, data)
