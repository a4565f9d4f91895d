"""The softened linear complementarity problem ``lam (z + F lam) = mu``, iteration by iteration.

:func:`advance` is one step of the primal-dual path solver as a graph, :func:`follow` repeats it,
:func:`scalar_solution` is the closed form for one contact.
"""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca

from dynamics.contact.compliance import Compliance

_STAGES = (8, 8, 16, 32, 64, 128)
ITERATIONS = sum(_STAGES)
"""Iterations that the path solver is given; ten suffice mostly."""
_BOUNDARY = 0.995
_CENTRING = 0.3
_NEAR = 0.5
_NEIGHBOURHOOD = 1e-2
_FEASIBILITY = 3e-3
_SETTLED = 1e-5
_FLOOR = 1e-8


def scalar_solution(z: ca.SX, F: ca.SX, mu: ca.SX) -> ca.SX:
    """Root of ``lam (z + F lam) = mu`` with lam >= 0, one contact, F > 0, mu >= 0.

    ``lam = 2 mu / (z + r)`` for z > 0 and ``(r - z) / (2 F)`` otherwise, r = sqrt(z² + 4 F mu):
    either form cancels on the other side (abs, eq. 3.1; pathologies, eq. 5).
    """
    r = ca.sqrt(z * z + 4 * F * mu)
    positive = z > 0
    return ca.if_else(positive, 2 * mu / (ca.if_else(positive, z, 1) + r), (r - z) / (2 * F))


def exact_scalar_solution(z: ca.SX, F: ca.SX) -> ca.SX:
    """Solution of ``0 <= lam ⟂ z + F lam >= 0`` for one contact: max(0, -z) / F."""
    return ca.fmax(0, -z) / F


def advance(
    lam: ca.SX, s: ca.SX, gap: ca.SX, F: Compliance, mu: ca.SX, rest: float = 0.0
) -> tuple[ca.SX, ca.SX]:
    """The pair after one iteration on the scaled problem, as expressions: ``lam, s``.

    All (n, 1); ``gap`` is ``z + F lam`` at lam; lam, s > 0, and ``s = gap`` holds only in the
    limit. Algorithm 3 of adaptive barrier smoothing: Mehrotra's affine predictor
    and centring, fraction to the boundary. Differently from it, the affine step aims at the wanted
    mu and the target never falls below it, so that the end is *at* mu; the second-order correction
    is taken only where it shortens no step and lowers the violation (with it alone, one problem in
    ten cycles); the centring goes at least two thirds of the way and steps near the end are damped
    (else strongly coupled contacts stall or circle there); pairs far below their target are lifted
    back (without it, rare problems jam at the boundary); the products wait for the defect of
    ``s = z + F lam``, and both shrink together. Once rounding stops the progress, or the relative
    violation is ``rest`` or less, the point is returned unchanged: a fixed point ends the loop.
    """
    n = lam.numel()
    defect, solve = gap - s, F.factored(lam, s)

    def direction(target: ca.SX, keep: ca.SX | float) -> tuple[ca.SX, ca.SX]:
        step, opened = solve(target - lam * s - lam * (1 - keep) * defect)
        return step, opened + (1 - keep) * defect

    def length(step_lam: ca.SX, step_s: ca.SX, fraction: ca.SX | float) -> ca.SX:
        decrease = ca.vertcat(-step_lam / lam, -step_s / s)
        return 1 / ca.fmax(1, ca.mmax(decrease) / fraction)

    violation = ca.mmax(ca.vertcat(ca.fabs(lam * s - mu), ca.fabs(defect)))
    fraction = ca.fmax(_BOUNDARY, 1 - violation)
    affine = direction(mu, 0.0)
    reach = length(*affine, 1.0)
    excess = ca.sum1(ca.fabs(lam * s - mu)) / n
    excess_affine = ca.sum1(ca.fabs((lam + reach * affine[0]) * (s + reach * affine[1]) - mu)) / n
    centring = ca.fmin(_CENTRING, (excess_affine / ca.fmax(excess, 1e-300)) ** 3)
    remaining = (1 - reach) ** 2
    behind = _FEASIBILITY * (1 - reach) * ca.mmax(ca.fabs(defect))
    near = ca.logic_and(
        ca.mmax(ca.fabs(lam * s - mu) / mu) < _NEAR,
        ca.mmax(ca.fabs(defect) / (1 + s)) < 1e-10,
    )
    target = ca.if_else(near, mu, ca.fmax(mu + centring * excess, behind))

    plain = direction(target, remaining)
    corrected = direction(target - reach**2 * affine[0] * affine[1], remaining)
    step_plain, step_corrected = length(*plain, fraction), length(*corrected, fraction)

    def moved(step: ca.SX, along: tuple[ca.SX, ca.SX]) -> tuple[ca.SX, ca.SX]:
        return lam + step * along[0], s + step * along[1]

    def off(step: ca.SX) -> ca.SX:
        at_lam, at_s = moved(step, plain)
        return ca.mmax(ca.fabs(at_lam * at_s - mu) / mu)

    step_plain = ca.if_else(near, _best([step_plain / 2**k for k in range(6)], off), step_plain)
    at_plain, at_corrected = moved(step_plain, plain), moved(step_corrected, corrected)
    better = ca.sum1(ca.fabs(at_corrected[0] * at_corrected[1] - mu)) < ca.sum1(
        ca.fabs(at_plain[0] * at_plain[1] - mu)
    )
    use = ca.logic_and(better, ca.logic_and(step_corrected >= 0.9 * step_plain, 1 - near))
    new_lam = ca.if_else(use, at_corrected[0], at_plain[0])
    new_s = ca.if_else(use, at_corrected[1], at_plain[1])
    # The smaller one alone: the larger one is right, and moving it would spoil s = z + F lam.
    lift = ca.fmax(1, _NEIGHBOURHOOD * target / (new_lam * new_s))
    small = new_lam < new_s
    new_lam = new_lam * ca.if_else(small, lift, 1)
    new_s = new_s * ca.if_else(small, 1, lift)

    def relative(at_lam: ca.SX, at_s: ca.SX) -> ca.SX:
        off = ca.fabs(gap + F.across(at_lam - lam) - at_s) / (1 + at_s)
        return ca.mmax(ca.vertcat(ca.fabs(at_lam * at_s - mu) / ca.fmax(mu, _FLOOR), off))

    now = relative(lam, s)
    settled = ca.logic_and(now < _SETTLED, ca.logic_not(relative(new_lam, new_s) < now))
    settled = ca.logic_or(settled, now <= rest) if rest else settled
    return ca.if_else(settled, lam, new_lam), ca.if_else(settled, s, new_s)


def _best(steps: list[ca.SX], merit: Callable[[ca.SX], ca.SX]) -> ca.SX:
    """Return the step of least merit."""
    best, least = steps[0], merit(steps[0])
    for step in steps[1:]:
        value = merit(step)
        best, least = ca.if_else(value < least, step, best), ca.fmin(value, least)
    return best


def follow(body: ca.Function, stage: int = 0) -> ca.Function:
    """Repeat ``body: (pair, *data) -> pair`` until it moves no more, at most 256 times.

    CasADi evaluates a branch of a conditional only when it is taken, so that a problem which is
    solved in ten iterations does not pay for the hundreds that the worst one needs.
    """
    pair, *data = (ca.MX.sym(body.name_in(k), *body.size_in(k)) for k in range(body.n_in()))
    before, now = pair, pair
    for _ in range(_STAGES[stage]):
        before, now = now, body(now, *data)
    if stage + 1 < len(_STAGES):
        stay = ca.Function("stay", [pair, *data], [pair])
        more = ca.Function.if_else("more", follow(body, stage + 1), stay)
        now = more(ca.mmax(ca.fabs(now - before)) > 0, now, *data)
    return ca.Function(f"{body.name()}_{stage}", [pair, *data], [now])
