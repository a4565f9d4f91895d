"""Certificate of stationarity for the problem as posed, independent of the solver's status."""

from __future__ import annotations

import time
from bisect import insort
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np

from ocp.judge.findings import Finding, make_finding
from ocp.judge.lpec import Descent, LinearModel, negative_curvature
from ocp.programs.program import Program

if TYPE_CHECKING:
    import scipy.sparse as sp

Stationarity = Literal["B", "KKT", "not", "undecided"]
RADII = (1e-3, 1e-4)
"""Radii of the trust regions, in characteristic sizes, within which a descent direction is searched for."""
_BIACTIVE = 1e-6
"""Value of a pair's member, relative to its characteristic size, below which the member counts as zero."""
_FLAT = 1e-4
"""Decrease per radius, as a fraction of the cost's typical change, that still counts as zero."""
_NOISE = 1e-6
"""Gain, as a fraction of the cost's typical change, that still counts as zero."""
_STEEP = 100.0
"""Multiple of the cost's typical change above which the effect of one variable hides the gain by other variables."""
WITHIN = 1e-2
"""Longest step along a descent direction, in characteristic sizes, for which its gain is computed."""


UNJUDGED = "the point is not feasible"
"""Reason of a certificate for a point that is not feasible."""
_MOST_MOVES = 3
"""Maximum number of contact changes that a verdict lists."""
PAIR_CHANGES = {
    "normal": ("opening contact", "closing contact"),
    "limit": ("leaving limit", "meeting limit"),
    "friction": ("dropping", "applying"),
    "slip": ("stopping", "starting"),
    "table": ("stopping", "starting"),
    "pair": ("freeing the second of", "freeing the first of"),
}
"""Mapping from a pair's kind to words for the event in which its gap, or its multiplier, grows from zero."""


@dataclass(frozen=True)
class ContactChange:
    """A pair that opens or closes along the steepest descent direction, at steps ``first`` to ``last``.

    ``change`` describes this in words, such as "opening contact"; ``contact`` is the pair's name.
    """

    change: str
    contact: str
    scenario: int
    first: int
    last: int

    def __str__(self) -> str:
        """Return the change, the contact's name and the steps as text."""
        span = f"{self.first}-{self.last}" if self.last > self.first else f"{self.first}"
        plural = "s" if self.last > self.first else ""
        return f"{self.change} {self.contact!r} at step{plural} {span}"


@dataclass(frozen=True)
class Certificate:
    """First-order optimality of a point, recomputed from derivatives and independent of the solver.

    ``stationarity`` is "B" if no first-order move, with any change of contact, lowers the cost; "KKT" if this holds
    for a problem without complementarity; "not" if some move lowers the cost; "undecided" if the linear programs were
    not solved. ``reason`` says why they were not solved, or why moves that lower the cost were not made. ``kind`` is
    the strongest of S, M, C, W whose signs the multipliers at biactive pairs have (Scheel and Scholtes 2000), ""
    without pairs.

    ``biactive`` counts pairs with both members below 1e-6 of their characteristic size; ``lpec_decrease`` is the
    first-order decrease of the cost per unit of the trust region's radius along the steepest direction that satisfies
    complementarity, zero if certified. ``tolerance`` is the largest decrease that counts as zero: 1e-4 of
    :meth:`~ocp.programs.program.Program.typical_change`. It does not depend on constant terms of the cost, on the
    number of steps in a sum, or on a single steep entry. ``slope`` is the scaled 1-norm of the cost's gradient, the
    decrease per radius without constraints. ``gain`` is the decrease along the descent direction within a hundredth
    of the characteristic sizes, with the Lagrangian's curvature included. ``kkt_residual`` is the largest entry of
    the Lagrangian's projected gradient, divided by IPOPT's scale of the multipliers. ``negative_curvature`` is the
    number of negative eigenvalues of the Lagrangian's Hessian on the null space of the active constraints, -1 if not
    computed.
    """

    stationarity: Stationarity
    kind: str = ""
    biactive: int = 0
    lpec_decrease: float = float("nan")
    kkt_residual: float = float("nan")
    tolerance: float = float("nan")
    slope: float = float("nan")
    gain: float = 0.0
    negative_curvature: int = -1
    moves: list[ContactChange] = field(default_factory=list)
    reason: str = ""
    seconds: float = 0.0

    @property
    def certified(self) -> bool:
        """Whether the point is stationary for the problem as posed."""
        return self.stationarity in ("B", "KKT")

    @property
    def findings(self) -> list[Finding]:
        """Findings on stationarity, and on moves that would lower the cost."""
        if self.stationarity == "B":
            return [make_finding("B-stationary")]
        if self.stationarity == "KKT":
            return [make_finding("stationary")]
        if self.stationarity == "undecided":
            return [make_finding("stationarity-undecided", reason=self.reason)]
        moves = " and ".join(str(move) for move in self.moves[:_MOST_MOVES]) or "moving with the same contacts"
        unlisted = len(self.moves) - _MOST_MOVES
        moves += f" (and {unlisted} more)" if unlisted > 0 else ""
        refused = [make_finding("moves-not-made", "; ", reason=self.reason)] if self.reason else []
        return [make_finding("not-stationary", moves=moves, gain=self.gain), *refused]

    @property
    def sentence(self) -> str:
        """The findings joined into one clause."""
        return "".join(finding.joint + finding.sentence for finding in self.findings)


def certify(
    nlp: Program, x: np.ndarray, p: np.ndarray, bounds: dict[str, np.ndarray], multipliers: np.ndarray | None = None
) -> Certificate:
    """Return the first-order certificate of a feasible point ``x`` of ``nlp``, with its negative curvature.

    A mathematical program with complementarity constraints must be given as reformulation "none",
    in which contact is stated only by the pairs; ``bounds`` are the problem's own. The objective and
    constraints are linearised at the point, and a direction ``|d_i| <= rho`` (in characteristic
    sizes) that lowers the cost is sought:

    1. by weak duality, without solving a program, from the solver's ``multipliers`` of the rows, if given, and from
    the least-squares multipliers, which are free of the errors that the barrier of
       an interior-point solver leaves at every bound of a long horizon;
    2. by a linear program in which both members of pairs near zero may grow: if it finds
       no descent, the point is strongly stationary, which implies B-stationarity;
    3. by the linear program with complementarity constraints (LPEC), with one binary per near pair.

    A point is B-stationary if the LPEC finds no descent for some rho; rho falls from 1e-3 to 1e-4,
    so that a descent has to persist as the region shrinks (Leyffer and Munson 2007; Nurkanovic and
    Leyffer, arXiv 2501.13835). Constraints and bounds within 1e-4 count as active.

    A direction that gains less than 1e-6 of the typical change, curvature included, does not count
    as descent; for a flat cost, only this test distinguishes a gradient from rounding errors.
    """
    start_time = time.perf_counter()
    model = LinearModel.at(nlp, x, p, bounds)
    complementary = nlp.reformulation == "none" and nlp.pairs.size > 0
    if not (np.isfinite(nlp.values(x, p)[0]) and model.finite):
        return Certificate("undecided", reason="a function or derivative is NaN or infinite at the point")
    slope = float(np.abs(model.cost).sum())
    tolerance = tolerance_of(model)
    fitted = multipliers if multipliers is not None else fit_multipliers(model)
    hessian = nlp.scaled_hessian(x, p, fitted, model.sizes)
    verdict, strong, descent, gain = _judge(model, multipliers, hessian)
    steep = _steep_factors(model, hessian)
    if verdict == "B" and np.any(steep < 1):
        damped, curved = model.damped(steep), hessian.multiply(steep[:, None]).multiply(steep)
        verdict, strong, descent, gain = _judge(damped, multipliers, curved.tocsr())
    return Certificate(
        stationarity=verdict if complementary or verdict != "B" else "KKT",
        kind=("S" if strong else _kind(model, fitted)) if complementary and verdict == "B" else "",
        biactive=int(model.near(_BIACTIVE).sum()),
        lpec_decrease=0.0 if verdict == "B" else descent.decrease,
        kkt_residual=_kkt_residual(model, fitted, nlp.natural.f),
        tolerance=tolerance,
        slope=slope,
        gain=gain,
        negative_curvature=_curvature(model, hessian) if verdict == "B" else -1,
        moves=_moves(nlp, model, descent) if verdict == "not" else [],
        reason=descent.trouble,
        seconds=time.perf_counter() - start_time,
    )


def tolerance_of(model: LinearModel) -> float:
    """Return the largest decrease per radius that counts as zero, see :class:`Certificate`."""
    return _FLAT * model.typical_change


def _judge(
    model: LinearModel, multipliers: np.ndarray | None, hessian: sp.csr_matrix
) -> tuple[Stationarity, bool, Descent, float]:
    """Return the result of :func:`_search` and the decrease; "B" if the decrease along its direction is noise."""
    verdict, strong, descent = _search(model, multipliers, tolerance_of(model))
    gain = _gain(descent, hessian) if verdict == "not" else 0.0
    if verdict == "not" and gain <= _NOISE * model.typical_change:
        return "B", strong, descent, 0.0
    return verdict, strong, descent, gain


def _steep_factors(model: LinearModel, hessian: sp.csr_matrix) -> np.ndarray:
    """Return factors (n,) that reduce the sizes of variables with far more than the typical effect on the cost.

    The curvature of one such variable, and rounding errors of the linear program, would hide the gain by all others.
    """
    change = np.abs(model.cost) + np.abs(hessian.diagonal()) / 2
    steep = change > max(_STEEP * model.typical_change, 1e-300)
    steep[model.pairs] = False
    return np.where(steep, model.typical_change / np.where(steep, change, 1.0), 1.0)


def _search(model: LinearModel, multipliers: np.ndarray | None, tolerance: float) -> tuple[Stationarity, bool, Descent]:
    """Return stationarity, whether it is strong, and the descent direction, searched in shrinking trust regions.

    Stationarity is "B" as soon as one region has no descent direction, and strong if there is none even when both
    members of near pairs may grow.
    """
    descent = Descent(0.0)
    for y in _candidates(model, multipliers):
        if model.dual_bound(y, RADII[0]) <= tolerance:
            return "B", True, descent
    for radius in RADII:
        descent = model.descend(radius, False, tolerance)
        if descent.decrease <= tolerance:
            return "B", True, descent
        if model.near(radius).any():
            descent = model.on_branch(descent, radius) or model.descend(radius, True, tolerance)
            if descent.decrease <= tolerance:
                return "B", False, descent
    if np.isnan(descent.decrease):
        return "undecided", False, Descent(np.nan, trouble=f"HiGHS reports {descent.trouble!r}")
    return "not", False, descent


def _candidates(model: LinearModel, multipliers: np.ndarray | None) -> Iterator[np.ndarray]:
    """Yield multipliers that may prove stationarity: the solver's, if any, then the least-squares multipliers."""
    if multipliers is not None:
        yield multipliers
        yield fit_multipliers(model)


def fit_multipliers(model: LinearModel) -> np.ndarray:
    """Return least-squares multipliers of the rows (in units of the rows), without multipliers of the wrong sign.

    The multipliers minimise ``|cost + rows' y|²`` over the variables that no bound or pair fixes, by the augmented
    system, whose matrix is quasi-definite, so that pivots stay on the diagonal: other pivots fill the factors, for
    seconds in large scenes. Inequalities with the wrong sign are removed from the active set, in at most four rounds.
    """
    import scipy.sparse as sp
    import scipy.sparse.linalg as sla

    at_lower, at_upper = model.row_lower == 0, model.row_upper == 0
    active = at_lower | at_upper
    y, inside = np.zeros(model.row_scale.size), np.flatnonzero(model.free)
    for _ in range(4):
        acting = np.flatnonzero(active)
        A = sp.csr_matrix(model.rows[acting][:, inside])
        corner = -1e-10 * sp.identity(acting.size)
        augmented = sp.csc_matrix(sp.bmat([[sp.identity(inside.size), A.T], [A, corner]]))
        right = np.concatenate([-model.cost[inside], np.zeros(acting.size)])
        y[:] = 0.0
        try:
            factors = sla.splu(augmented, "MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        except RuntimeError:  # The matrix is singular.
            break
        y[acting] = factors.solve(right)[inside.size :]
        wrong = active & (((y > 0) & ~at_upper) | ((y < 0) & ~at_lower))
        if not wrong.any():
            break
        active &= ~wrong
    return np.nan_to_num(y) * model.row_scale


def _kkt_residual(model: LinearModel, multipliers: np.ndarray, cost: float) -> float:
    """Return the largest projected gradient of the Lagrangian, divided by the cost's natural unit and IPOPT's s_d."""
    slope, multipliers = model.reduced(multipliers) / cost, multipliers / cost
    slope = np.where((model.lower >= 0) & (slope > 0), 0.0, slope)
    slope = np.where((model.upper <= 0) & (slope < 0), 0.0, slope)
    slope[model.held] = 0.0
    scale = max(100.0, float(np.abs(multipliers).mean()) if multipliers.size else 0.0) / 100.0
    return float(np.abs(slope / model.sizes).max(initial=0.0)) / scale


def _kind(model: LinearModel, multipliers: np.ndarray) -> str:
    """Return the strongest of S, M, C, W whose signs the multipliers of biactive pairs have."""
    biactive = model.near(_BIACTIVE)
    if not biactive.any():
        return "S"
    first, second = model.reduced(multipliers)[model.pairs[:, biactive]]
    zero = _FLAT * float(np.abs(model.cost).max(initial=0.0))
    if np.all((first >= -zero) & (second >= -zero)):
        return "S"
    none = np.minimum(np.abs(first), np.abs(second)) <= zero
    if np.all(none | ((first > zero) & (second > zero))):
        return "M"
    return "C" if np.all(none | (first * second >= 0)) else "W"


def _gain(descent: Descent, hessian: sp.csr_matrix) -> float:
    """Return the largest value of ``decrease t - t² d'Hd / 2`` for t up to :data:`WITHIN`."""
    curvature = float(descent.step @ (hessian @ descent.step))
    t = min(WITHIN, descent.decrease / curvature) if curvature > 0 else WITHIN
    return descent.decrease * t - max(curvature, 0.0) * t**2 / 2


def _curvature(model: LinearModel, hessian: sp.csr_matrix) -> int:
    """Return the number of negative eigenvalues of the Hessian on the null space of the active constraints."""
    free = model.free
    active = (model.row_lower == 0) | (model.row_upper == 0)
    return negative_curvature(hessian[free][:, free], model.rows[active][:, free])


def _moves(nlp: Program, model: LinearModel, descent: Descent) -> list[ContactChange]:
    """Return the contact changes along the direction, without kinks; equal ones at successive steps are merged."""
    if not descent.near.size:
        return []
    was_active = model.members[0, descent.near] > model.members[1, descent.near]
    pair_changes = descent.step[model.pairs[:, descent.near]]
    grows = np.where(descent.active > 0.5, pair_changes[0], pair_changes[1]) > 1e-6
    biactive = np.all(model.members[:, descent.near] < _BIACTIVE, axis=0)
    changed = grows & (biactive | (was_active != (descent.active > 0.5)))
    changed_steps: dict[tuple[int, str, str], list[int]] = {}
    for index in np.flatnonzero(changed):
        pair = nlp.pair_name(int(descent.near[index]))
        if pair.kind not in PAIR_CHANGES:
            continue
        change = PAIR_CHANGES[pair.kind][int(descent.active[index] > 0.5)]
        insort(changed_steps.setdefault((pair.scenario, pair.name, change), []), pair.step)
    return [
        ContactChange(change, name, scenario, int(run[0]), int(run[-1]))
        for (scenario, name, change), steps in sorted(changed_steps.items(), key=lambda item: item[1][0])
        for run in np.split(steps, np.flatnonzero(np.diff(steps) != 1) + 1)
    ]
