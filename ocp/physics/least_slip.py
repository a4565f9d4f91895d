"""The way slid that a trajectory shows: what the law of friction leaves open is the least."""

from __future__ import annotations

import numpy as np

from dynamics.contact import Step


def least_slip(step: Step, lam: np.ndarray, gap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """lam and gap (..., n) with every psi the least that the motion allows.

    In ``0 <= beta± ⟂ psi ± h J_t v+ >= 0`` and ``0 <= psi ⟂ f gamma - beta+ - beta- >= 0`` any psi
    of at least ``|h J_t v+|`` will do where gamma = 0: nothing else depends on it. Under the exact
    law it is lowered by the smaller one of the two gaps of its contact, to ``|h J_t v+|``; no
    product lam gap grows by that. A smoothed law determines psi, and a learned one has none.
    """
    pairs, lam, gap = step.system.pairs, lam.copy(), gap.copy()
    if not step.exact or step.n < len(pairs):
        return lam, gap
    for rows in step.rows:
        for i, pair in enumerate(pairs):
            sides = [rows.start + j for j, other in enumerate(pairs)
                     if (other.kind, other.contact) == ("friction", pair.contact)]  # fmt: skip
            if pair.kind == "slip" and sides:
                spare = np.maximum(0, gap[..., sides].min(axis=-1))
                spare = np.minimum(spare, lam[..., rows.start + i])
                lam[..., rows.start + i] -= spare
                gap[..., sides] -= spare[..., None]
    return lam, gap
