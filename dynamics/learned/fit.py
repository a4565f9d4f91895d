"""Errors of a learned model on held-out data, and its behaviour outside the data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from dynamics.contact.learned_step import LearnedMap
from dynamics.learned.transitions import Samples

if TYPE_CHECKING:
    import xarray as xr

# Distances from the data, in normalised units, at which a model is evaluated outside the data.
RAY_DISTANCES = (0.0, 0.5, 1.0, 2.0, 4.0)
# Number of random directions in which rays leave the data.
N_RAYS = 256


@dataclass(frozen=True)
class Fit:
    """Errors of a learned model g, per coordinate of y and along rays that leave the data.

    ``clean`` and ``noised`` (ny,): root mean square of ``g(z) - y`` and of ``g(z + w) - y``, w of width
    ``sigma`` in normalised units of z, relative to the standard deviation of y in the data; multiplied
    by ``y_scale`` they are in the units of the coordinates. ``noised`` has a lower bound for every model, since noise
    can move samples with different y to the same z.

    A ray starts at the sample farthest out in a random direction of normalised z and follows this direction, so
    that ``distances`` (k,) are distances both to the data's convex hull and to the nearest sample. No y is
    known on the rays. ``displacement`` (k,) is the root mean square over rays and coordinates of ``g - y``
    relative to y's scale, where y belongs to the sample at which the ray starts: it tends to 0 if
    the model returns the nearest sample, and grows like the distance if the model extrapolates. ``outside`` (k,) is
    the fraction of rays on which a coordinate of g is outside the range of the data's y; it is 0 for averages of the
    data.
    """

    sigma: float
    y_scale: np.ndarray
    clean: np.ndarray
    noised: np.ndarray
    distances: np.ndarray
    displacement: np.ndarray
    outside: np.ndarray

    def dataset(self) -> xr.Dataset:
        """Return the errors as arrays with names ``fit_...``, to be stored in a model's file."""
        import xarray as xr

        return xr.Dataset(
            {
                "fit_sigma": self.sigma,
                **{f"fit_{name}": ("state", getattr(self, name)) for name in PER_COORDINATE},
                **{f"fit_{name}": ("fit_distance", getattr(self, name)) for name in ALONG_RAYS},
            },
            coords={"fit_distance": self.distances},
        )

    @classmethod
    def from_dataset(cls, dataset: xr.Dataset) -> Fit:
        """Return the errors stored in a model's dataset by :meth:`dataset`."""
        names = (*PER_COORDINATE, *ALONG_RAYS)
        arrays = {name: dataset[f"fit_{name}"].values for name in names}
        distances = dataset["fit_distance"].values
        return cls(sigma=float(dataset["fit_sigma"]), distances=distances, **arrays)


# Names of the fields of Fit with one entry per coordinate of y.
PER_COORDINATE = ("y_scale", "clean", "noised")
# Names of the fields of Fit with one entry per distance.
ALONG_RAYS = ("displacement", "outside")


def measure_fit(learned: LearnedMap, data: Samples, held_out: np.ndarray, sigma: float, seed: int = 0) -> Fit:
    """Measure a model's errors on the rows ``held_out`` of the data, and its extrapolation along rays out of the data.

    Raises ``ValueError`` if no row is held out, or if sizes of model and data differ.
    """
    ny = data.y.shape[1]
    if learned.n_in != data.z.shape[1] or learned.n_out < ny:
        raise ValueError(
            f"fit: the model maps {learned.n_in} numbers to {learned.n_out}, the data have {data.z.shape[1]} and {ny}"
        )
    if not len(held_out):
        raise ValueError("fit: no row is held out to compare the model with; hold some out")
    z_scales, y_scales = data.scales
    rng = np.random.default_rng([seed, 2])
    z, y = data.z[held_out], data.y[held_out]
    noised = z + sigma * z_scales.scale * rng.standard_normal(z.shape)
    clean_rms, noised_rms = (
        np.sqrt(np.mean(((learned.values(queries)[:, :ny] - y) / y_scales.scale) ** 2, axis=0))
        for queries in (z, noised)
    )
    directions = rng.standard_normal((N_RAYS, data.z.shape[1]))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    ray_errors = _rays(learned, data, directions)
    return Fit(float(sigma), y_scales.scale, clean_rms, noised_rms, np.array(RAY_DISTANCES), *ray_errors)


def _rays(learned: LearnedMap, data: Samples, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the arrays ``displacement`` and ``outside`` of :class:`Fit`, one entry per distance."""
    z_scales, y_scales = data.scales
    z = z_scales.normalise(data.z)
    exit_rows = np.array([np.argmax(z @ direction) for direction in directions])
    # A rounding error of an average must not count as outside.
    slack = 1e-9 * y_scales.scale
    y_min, y_max = data.y.min(axis=0) - slack, data.y.max(axis=0) + slack
    displacement, outside = np.empty(len(RAY_DISTANCES)), np.empty(len(RAY_DISTANCES))
    for i, distance in enumerate(RAY_DISTANCES):
        ray_points = data.z[exit_rows] + distance * z_scales.scale * directions
        y = learned.values(ray_points)[:, : data.y.shape[1]]
        displacement[i] = np.sqrt(np.mean(((y - data.y[exit_rows]) / y_scales.scale) ** 2))
        outside[i] = np.mean(((y < y_min) | (y > y_max)).any(axis=1))
    return displacement, outside
