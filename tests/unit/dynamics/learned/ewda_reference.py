"""Reference for the weighted average and its derivatives in 60 digits, term by term as in the equations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from mpmath import mp, mpf

from dynamics.learned.ewda import EwdaModel
from dynamics.learned.transitions import DataOrigin, Normalisation
from dynamics.systems.parameters import Signal

DIGITS = 60


@dataclass(frozen=True)
class Scaling:
    """Values ``(g, log p)`` (ny + 1,) at one query, their Jacobian (ny + 1, nz) and contracted curvature (nz, nz)."""

    values: np.ndarray
    jacobian: np.ndarray
    curvature: np.ndarray


def model_of(z: np.ndarray, y: np.ndarray, sigma: float, **options) -> EwdaModel:
    """Return a model of data z, y with the data's own scales and invented names."""
    names = [f"z{k}" for k in range(z.shape[1])]
    scales = Normalisation.from_rows(z, names) if len(z) > 1 else _unit(z.shape[1])
    return EwdaModel(z, y, scales, sigma, origin(z.shape[1], y.shape[1]), **options)


def origin(nz: int, ny: int) -> DataOrigin:
    """Return the origin of data whose states are the first ``ny`` entries of z."""
    z = tuple(Signal(f"z{k}", "m") for k in range(nz))
    return DataOrigin(z, tuple(Signal(f"z{k}", "m") for k in range(ny)), "made-up", {"m": 2.0}, "ab12")


def _unit(n: int) -> Normalisation:
    return Normalisation(np.zeros(n), np.ones(n))


def reference(model: EwdaModel, query: np.ndarray, weights: np.ndarray) -> Scaling:
    """Return the reference at one query (nz,), normalised in float64 and computed in 60 digits."""
    with mp.workdps(DIGITS):
        return _reference(model, query, weights)


def _reference(model: EwdaModel, query: np.ndarray, weights: np.ndarray) -> Scaling:
    z = _exact(model.scales.normalise(model.z))
    q, y = _exact(model.scales.normalise(query)), _exact(model.y)
    scale, nu = _exact(model.scales.scale), _exact(weights)
    variance = mpf(model.sigma) ** 2
    square = ((z - q) ** 2).sum(axis=1)
    least = min(square)
    w = np.array([mp.exp(-(s - least) / (2 * variance)) for s in square])
    total = w.sum()
    w = w / total
    mean_z, mean_y = w @ z, w @ y
    d, e = z - mean_z, y - mean_y
    peak = mp.log(len(z)) + len(q) * mp.log(2 * mp.pi * variance) / 2
    log_p = mp.log(total) - least / (2 * variance) - peak
    slopes = np.vstack(((e * w[:, None]).T @ d, mean_z - q)) / variance
    third = (d * (w * (e @ nu[:-1]))[:, None]).T @ d
    second = (d * w[:, None]).T @ d / variance - _exact(np.eye(len(q)))
    bends = third / variance**2 + nu[-1] * second / variance
    return Scaling(np.append(mean_y, log_p), slopes / scale, bends / (scale[:, None] * scale))


def _exact(array: np.ndarray) -> np.ndarray:
    return np.vectorize(mpf, otypes=[object])(array)


def gap(got: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """Return ``|got - exact|``, with the difference in 60 digits."""
    with mp.workdps(DIGITS):
        return np.abs(_exact(got) - exact).astype(float)
