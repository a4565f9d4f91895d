"""Fix the active set and solve without complementarity, so that it holds to solver tolerance."""

from __future__ import annotations

import numpy as np

from ocp.problem import Reference
from ocp.solvers.homotopy import WARM, Homotopy, translate
from ocp.solvers.solver import Point, Result
from ocp.transcription.nlp import NLP

_ROUNDS = 8
_NEAR = 1e-6


def polish(
    homotopy: Homotopy, source: NLP, result: Result, reference: Reference
) -> tuple[Result, NLP, bool]:
    """Fix ``gap = 0`` where contact acts and ``lam = 0`` elsewhere, and solve what remains.

    A pair near (0, 0) is put where it is larger in characteristic units; if its multiplier then
    asks for the other branch, it is moved there and the NLP solved again while the cost falls, so
    the answer is not left at a spurious corner. Every branch's answer is feasible for the exact
    problem. Returns the better of the input and the polished answer, and whether polishing worked.
    """
    nlp = homotopy.nlp_of("none")
    values = {**homotopy.values, "penalty": 0.0}
    p, limits = nlp.parameter_vector(values), nlp.bounds(values)
    lam_at, gap_at = nlp.pairs
    point = translate(result.point, source, nlp)
    active = point.x[lam_at] / reference.impulse > point.x[gap_at] / reference.gap
    best: Result | None = None
    for _ in range(_ROUNDS):
        bounds = {key: value.copy() for key, value in limits.items()}
        bounds["ubx"][gap_at[active]] = 0.0
        bounds["ubx"][lam_at[~active]] = 0.0
        start = Point(np.clip(point.x, bounds["lbx"], bounds["ubx"]), point.lam_x, point.lam_g)
        options = {**WARM, "mu_init": 1e-6} if homotopy.solver.name == "ipopt" else {}
        found = homotopy.solver.run(nlp, start, p, bounds, **options)
        homotopy.record("active set", float(active.sum()), nlp, found, p, bounds)
        if not found.ok or (best is not None and found.f > best.f - 1e-9 * (1 + abs(best.f))):
            break
        best, point = found, found.point
        wanted = _other_branch(found, lam_at, gap_at, active)
        if not wanted.any():
            break
        active = active ^ wanted
    if best is None:
        return result, source, False
    return best, nlp, True


def _other_branch(
    found: Result, lam_at: np.ndarray, gap_at: np.ndarray, active: np.ndarray
) -> np.ndarray:
    """Pairs at (0, 0) whose fixed member would lower the cost by growing."""
    x, lam_x = found.point.x, found.point.lam_x
    assert lam_x is not None
    both = (x[lam_at] < _NEAR) & (x[gap_at] < _NEAR)
    fixed = np.where(active, lam_x[gap_at], lam_x[lam_at])
    return both & (fixed > 1e-6)
