"""The report on a fit is right for maps whose errors have closed forms."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from dynamics.learned.fit import RAY_DISTANCES, Fit, measure_fit
from dynamics.learned.transitions import DataOrigin, Samples
from dynamics.systems.parameters import Signal

NAMES = (Signal("q", "m"), Signal("turn", "rad"))
HELD_OUT = np.arange(4000)


@dataclass(frozen=True)
class Affine:
    """Model ``y = A z + b`` with one more output, as the data average has."""

    A: np.ndarray
    b: np.ndarray
    n_in: int = 2
    n_out: int = 3

    def values(self, z: np.ndarray) -> np.ndarray:
        return np.column_stack([z @ self.A.T + self.b, np.full(len(z), np.nan)])

    def jacobians(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        raise NotImplementedError

    def curvatures(self, z: np.ndarray, weights: np.ndarray) -> np.ndarray:
        raise NotImplementedError


@dataclass(frozen=True)
class Nearest(Affine):
    """Model that returns the y of the nearest datum, the data average without noise."""

    data: Samples | None = None

    def values(self, z: np.ndarray) -> np.ndarray:
        assert self.data is not None
        scale = self.data.z.std(axis=0)
        squares = ((z[:, None] / scale - self.data.z / scale) ** 2).sum(axis=2)
        y = self.data.y[squares.argmin(axis=1)]
        return np.column_stack([y, np.zeros(len(z))])


def still(n: int = 4000) -> Samples:
    """Draw n samples of the identity, with coordinates of different scales in metres and radians."""
    z = np.random.default_rng(0).normal(size=(n, 2)) * [0.1, 3.0] + [2.0, -1.0]
    return Samples(z, z.copy(), DataOrigin(NAMES, NAMES))


IDENTITY = Affine(np.eye(2), np.zeros(2))


def test_errors_of_the_identity_are_those_of_the_noise() -> None:
    """The clean error is 0, and the noised one sigma in normalised units, within four standard deviations."""
    data = still()
    report = measure_fit(IDENTITY, data, HELD_OUT, sigma=0.3)
    assert np.array_equal(report.clean, np.zeros(2))
    np.testing.assert_allclose(report.noised, 0.3, rtol=4 / np.sqrt(2 * len(HELD_OUT)))
    np.testing.assert_allclose(report.noised * report.y_scale, 0.3 * data.z.std(axis=0), rtol=0.05)
    off = measure_fit(replace(IDENTITY, b=np.array([0.02, 0.6])), data, HELD_OUT, sigma=0.0)
    np.testing.assert_allclose(off.clean * off.y_scale, [0.02, 0.6], rtol=1e-12)
    assert np.array_equal(off.clean, off.noised)


def test_along_rays_an_extrapolation_goes_as_far_as_the_query() -> None:
    """|g - y| equals the distance; the mean over 2 coordinates halves its square."""
    report = measure_fit(IDENTITY, still(), HELD_OUT, sigma=0.1)
    np.testing.assert_allclose(report.displacement, np.array(RAY_DISTANCES) / np.sqrt(2), atol=1e-12)
    assert report.outside[0] == 0 and np.all(np.diff(report.outside) >= 0)
    assert report.outside[-1] > 0.95


def test_along_rays_the_nearest_sample_is_where_they_left() -> None:
    """All data lie behind the plane from which a ray starts, as the report's distances assume."""
    data = still(500)
    report = measure_fit(Nearest(np.eye(2), np.zeros(2), data=data), data, np.arange(5), sigma=0.1)
    assert np.array_equal(report.displacement, np.zeros(len(RAY_DISTANCES)))
    assert np.array_equal(report.outside, np.zeros(len(RAY_DISTANCES)))


def test_a_report_stands_beside_a_model_in_one_file(tmp_path: Path) -> None:
    report = measure_fit(IDENTITY, still(), HELD_OUT, sigma=0.3)
    model = xr.Dataset({"weight_0": ("unit", np.ones(3))}, coords={"state": ["q", "turn"]})
    model.merge(report.dataset()).to_netcdf(tmp_path / "model.nc")
    with xr.open_dataset(tmp_path / "model.nc") as file:
        back = Fit.from_dataset(file.load())
    for name, wanted in vars(report).items():
        assert np.array_equal(getattr(back, name), wanted), name


def test_what_cannot_be_compared_is_said() -> None:
    data = still(10)
    with pytest.raises(ValueError, match="the model maps 3 numbers to 3, the data have 2 and 2"):
        measure_fit(replace(IDENTITY, n_in=3), data, np.arange(3), 0.1)
    with pytest.raises(ValueError, match="no row is held out"):
        measure_fit(IDENTITY, data, np.arange(0), 0.1)
