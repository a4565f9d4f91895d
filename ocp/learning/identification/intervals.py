"""How well transitions determine the parameters that were learned from them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ocp.learning.buffer import Buffer
from ocp.learning.identification.one_step import OneStepLoss

STEP = 1e-4
"""Of log psi in central differences."""
FLAT = 1e-10
"""Share of the largest eigenvalue of the information below which a direction is not seen."""
SEEN = 0.05
"""Part of a parameter's axis in unseen directions above which it is not determined."""


@dataclass(frozen=True, eq=False)
class Intervals:
    """``low`` and ``high`` (n,) of psi; [0, inf] for one that the transitions do not determine.

    ``information`` (n, n) is the mean over transitions of ``J_t' J_t``, J_t the derivative of the
    scaled errors by log psi; ``weakest`` (n,) the direction of log psi that it knows least of, of
    length 1, and ``least`` and ``most`` its smallest and largest eigenvalue.
    """

    low: np.ndarray
    high: np.ndarray
    information: np.ndarray
    weakest: np.ndarray
    least: float
    most: float


def intervals(
    loss: OneStepLoss,
    log_psi: np.ndarray,
    buffer: Buffer,
    level: float = 0.95,
    resamples: int = 400,
    seed: int = 0,
) -> Intervals:
    """Bootstrap over transitions, each resample's minimum being one Gauss-Newton step away.

    With J_t and errors r_t at ``log_psi`` (n_psi,), resample b's minimum is ``log_psi -
    (sum_b J_t'J_t)^(-1) sum_b J_t' r_t``. The interval has ``level`` of these minima and reaches to
    what was found: it tells of the noise in the data, and where those are exact, of how far the
    search stayed from their minimum. J_t is by central differences; transitions that do not solve
    there are left out. Two-sided quantiles, so an interval is one of each parameter alone.
    """
    J, r = _linearised(loss, log_psi, buffer)
    each = np.einsum("tia,tib->tab", J, J), np.einsum("tia,ti->ta", J, r)
    information = each[0].mean(axis=0)
    eigenvalues, axes = np.linalg.eigh(information)
    unseen = eigenvalues <= FLAT * eigenvalues[-1]
    lost = np.linalg.norm(axes[:, unseen], axis=1) > SEEN
    seen = axes[:, ~unseen]
    rng = np.random.default_rng([seed, 0])
    n = len(J)
    minima = [log_psi]
    for _ in range(resamples):
        weights = np.bincount(rng.integers(n, size=n), minlength=n)
        H = seen.T @ np.tensordot(weights, each[0], 1) @ seen
        minima.append(log_psi - seen @ np.linalg.lstsq(H, seen.T @ (weights @ each[1]))[0])
    tail = (1 - level) / 2
    low, high = np.quantile(minima[1:], [tail, 1 - tail], axis=0)
    return Intervals(
        np.where(lost, 0.0, np.exp(np.minimum(low, log_psi))),
        np.where(lost, np.inf, np.exp(np.maximum(high, log_psi))),
        information, axes[:, 0], float(eigenvalues[0]), float(eigenvalues[-1]),
    )  # fmt: skip


def _linearised(
    loss: OneStepLoss, log_psi: np.ndarray, buffer: Buffer
) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives (t, nx, n_psi) and errors (t, nx) where all of them are finite."""
    n = len(log_psi)
    around = log_psi + STEP * np.concatenate([np.zeros((1, n)), np.eye(n), -np.eye(n)])
    errors = loss.errors(around, buffer)
    good = np.isfinite(errors).all(axis=(0, 2))
    slopes = (errors[1 : n + 1] - errors[n + 1 :]) / (2 * STEP)
    return np.moveaxis(slopes, 0, 2)[good], errors[0][good]
