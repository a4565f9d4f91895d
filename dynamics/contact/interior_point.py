"""The interior-point iteration for the smoothed linear complementarity problem ``lam (z + F lam) = mu``.

:func:`advance_pair` is one iteration of the primal-dual path solver as a graph, :func:`repeat_until_rest`
repeats it, and :func:`scalar_solution` is the closed form for one contact.
"""

from __future__ import annotations

import casadi as ca

from dynamics.contact.compliance import Compliance

# Numbers of iterations of the stages; a stage runs only if the previous stage did not converge.
_STAGE_ITERATIONS = (8, 8, 16, 32, 64, 128)
ITERATIONS = sum(_STAGE_ITERATIONS)
"""Maximum number of iterations of the path solver; ten are usually enough."""
# Minimum fraction to the boundary: the part of the distance to lam = 0 or s = 0 that a step may cover.
_BOUNDARY_FRACTION = 0.995
# Maximum centring parameter, relative to the mean error of the products.
_MAX_CENTRING = 0.3
# Relative error of products below which an iterate counts as near the end and steps are damped.
_NEAR_ERROR = 0.5
# Minimum product lam s relative to its target; smaller products are raised to it.
_MIN_PRODUCT_SHARE = 1e-2
# Lower limit of the products' target relative to the largest defect |gap - s|.
_DEFECT_SHARE = 3e-3
# Relative error below which an iteration without progress counts as converged.
_REST_ERROR = 1e-5
FLOOR = 1e-8
"""Lower limit, in scaled units, of the mu that errors of products are divided by."""


def scalar_solution(z: ca.SX, F: ca.SX, mu: ca.SX) -> ca.SX:
    """Return the root lam >= 0 of ``lam (z + F lam) = mu`` for one contact, F > 0, mu >= 0.

    ``lam = 2 mu / (z + r)`` for z > 0 and ``(r - z) / (2 F)`` otherwise, r = sqrt(z² + 4 F mu); either form
    cancels for the other sign of z (adaptive barrier smoothing, eq. 3.1; Suh et al. on pathologies, eq. 5).
    """
    r = scalar_root(z, F, mu)
    is_open = z > 0
    return ca.if_else(is_open, 2 * mu / (ca.if_else(is_open, z, 1) + r), (r - z) / (2 * F))


def one_division_solution(z: ca.SX, F: ca.SX, mu: ca.SX) -> ca.SX:
    """Return :func:`scalar_solution`, computed with one division for both signs of z."""
    is_open = z > 0
    larger_root = ca.fabs(z) + scalar_root(z, F, mu)
    return ca.if_else(is_open, 2 * mu, larger_root) / ca.if_else(is_open, larger_root, 2 * F)


def scalar_root(z: ca.SX, F: ca.SX, mu: ca.SX) -> ca.SX:
    """Return ``sqrt(z² + 4 F mu)``, which is z + 2 F lam at the :func:`scalar_solution` lam."""
    return ca.sqrt(z * z + 4 * F * mu)


def exact_scalar_solution(z: ca.SX, F: ca.SX) -> ca.SX:
    """Return the solution max(0, -z) / F of ``0 <= lam ⟂ z + F lam >= 0`` for one contact."""
    return ca.if_else(z < 0, -z / F, 0)


def advance_pair(lam: ca.SX, s: ca.SX, gap: ca.SX, F: Compliance, mu: ca.SX, per_mu: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return ``lam, s`` after one iteration on the scaled problem, as expressions.

    All arguments but F are (n, 1); ``gap`` is ``z + F lam`` at lam, ``per_mu`` is 1/mu; lam, s > 0, and
    ``s = gap`` holds only in the limit. This is algorithm 3 of adaptive barrier smoothing, Mehrotra's affine
    predictor, then centring and a fraction-to-boundary rule, with five changes. The affine step aims at the given mu
    and the target is never less, so that the path ends *at* mu. The second-order correction is used only if the step
    does not become much shorter and the violation is lower (otherwise the iteration cycles in one problem of ten).
    The centring is limited and steps near the end are damped (otherwise iterations for strongly coupled contacts
    stall or cycle there). Products far below their target are raised (otherwise the iterates of rare problems stay at
    the boundary). The products' target has a lower limit proportional to the defect of ``s = gap``, so that both
    decrease together.

    A direction satisfies ``lam ds + s dlam = target - lam s``, so that ``dlam ds`` alone determines the
    products after a step.
    """
    n, product = lam.numel(), lam * s
    defect, product_error = gap - s, product - mu
    inverse = 1 / product
    per_lam, per_s = s * inverse, lam * inverse
    ratio = lam * per_s
    solve = F.factorise(ratio)

    def direction(target: ca.SX, kept_share: ca.SX | float) -> tuple[ca.SX, ca.SX]:
        remaining_defect = (1 - kept_share) * defect
        step_length, gap_change = solve((target - product) * per_s - ratio * remaining_defect)
        return step_length, gap_change + remaining_defect

    def excess(pair_step: tuple[ca.SX, ca.SX], step_length: ca.SX, target: ca.SX) -> ca.SX:
        return product_error + step_length * (target - product) + step_length**2 * (pair_step[0] * pair_step[1])

    largest = ca.mmax(ca.fabs(defect))
    worst = ca.mmax(ca.fabs(product_error) * per_mu)
    is_near = ca.logic_and(worst < _NEAR_ERROR, largest < 1e-10)
    fraction = ca.fmax(_BOUNDARY_FRACTION, 1 - ca.fmax(ca.mmax(ca.fabs(product_error)), largest))
    affine_step = direction(mu, 0.0)
    affine_length = _step_length(affine_step, (per_lam, per_s), 1.0)
    total_error = ca.sum1(ca.fabs(product_error))
    affine_error = ca.sum1(ca.fabs(excess(affine_step, affine_length, mu)))
    centring = ca.fmin(_MAX_CENTRING, (affine_error / ca.fmax(total_error, 1e-300)) ** 3)
    defect_target = _DEFECT_SHARE * (1 - affine_length) * largest
    target = ca.if_else(is_near, mu, ca.fmax(mu + centring * total_error / n, defect_target))

    second_order = affine_length**2 * affine_step[0] * affine_step[1]
    plain_step = direction(target, (1 - affine_length) ** 2)
    corrected_step = direction(target - second_order, (1 - affine_length) ** 2)
    step_plain, step_corrected = (_step_length(s, (per_lam, per_s), fraction) for s in (plain_step, corrected_step))
    # The error of the products after a step is at most (1 - step) error + step^2 dlam ds.
    curvature = ca.mmax(ca.fabs(plain_step[0] * plain_step[1]) * per_mu)
    step_plain = ca.if_else(
        is_near, ca.fmin(step_plain, worst / ca.fmax(ca.fmax(2 * curvature, worst), 1e-300)), step_plain
    )
    corrected_error = ca.sum1(ca.fabs(excess(corrected_step, step_corrected, target - second_order)))
    better = corrected_error < ca.sum1(ca.fabs(excess(plain_step, step_plain, target)))
    use_corrected = ca.logic_and(better, ca.logic_and(step_corrected >= 0.9 * step_plain, 1 - is_near))
    step_length = ca.if_else(use_corrected, step_corrected, step_plain)
    new_lam = lam + step_length * ca.if_else(use_corrected, corrected_step[0], plain_step[0])
    new_s = s + step_length * ca.if_else(use_corrected, corrected_step[1], plain_step[1])
    return _lift(new_lam, new_s, _MIN_PRODUCT_SHARE * target)


def _step_length(step: tuple[ca.SX, ca.SX], inverses: tuple[ca.SX, ca.SX], fraction: ca.SX | float) -> ca.SX:
    """Return the largest factor <= 1 of a step that covers at most ``fraction`` of the distance to a zero of lam or s.

    ``inverses`` are 1/lam and 1/s.
    """
    decrease = -ca.vertcat(step[0] * inverses[0], step[1] * inverses[1])
    return 1 / ca.fmax(1, ca.mmax(decrease) / fraction)


def _lift(lam: ca.SX, s: ca.SX, smallest_product: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return lam and s, the smaller raised if lam s is too small; raising the larger would violate s = gap."""
    lam_is_smaller = lam < s
    lift_lam = ca.logic_and(lam_is_smaller, lam * s < smallest_product)
    lift_s = ca.logic_and(ca.logic_not(lam_is_smaller), lam * s < smallest_product)
    lifted = smallest_product * (1 / ca.fmax(lam, s))
    return ca.if_else(lift_lam, lifted, lam), ca.if_else(lift_s, lifted, s)


def has_settled(
    pair: tuple[ca.SX, ca.SX],
    new_pair: tuple[ca.SX, ca.SX],
    gap: ca.SX,
    F: Compliance,
    mu: ca.SX,
) -> ca.SX:
    """Return an expression that is true if rounding errors prevent progress from ``pair`` to ``new_pair``."""

    def relative(lam: ca.SX, s: ca.SX, gap: ca.SX) -> ca.SX:
        gap_error = ca.fabs(gap - s) / (1 + s)
        return ca.mmax(ca.vertcat(ca.fabs(lam * s - mu) / ca.fmax(mu, FLOOR), gap_error))

    violation = relative(*pair, gap)
    new_violation = relative(*new_pair, gap + F.multiply(new_pair[0] - pair[0]))
    return ca.logic_and(violation < _REST_ERROR, ca.logic_not(new_violation < violation))


def repeat_until_rest(body: ca.Function, stage: int = 0) -> ca.Function:
    """Return a function that repeats ``body: (pair, *data) -> pair`` until pair no longer changes, at most 256 times.

    CasADi evaluates a branch of a conditional only when it is taken, so that a problem which is solved
    in ten iterations does not cost the hundreds of iterations that the worst problem needs.
    """
    pair, *data = (ca.MX.sym(body.name_in(k), *body.size_in(k)) for k in range(body.n_in()))
    previous, current = pair, pair
    for _ in range(_STAGE_ITERATIONS[stage]):
        previous, current = current, body(current, *data)
    if stage + 1 < len(_STAGE_ITERATIONS):
        unchanged = ca.Function("stay", [pair, *data], [pair])
        continued = ca.Function.if_else("more", repeat_until_rest(body, stage + 1), unchanged)
        current = continued(ca.mmax(ca.fabs(current - previous)) > 0, current, *data)
    return ca.Function(f"{body.name()}_{stage}", [pair, *data], [current])
