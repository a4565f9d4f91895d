"""The exponentially weighted distance average of data, with first and second derivatives."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from dynamics.batch.engines.kernels import choose_backend
from dynamics.batch.engines.parallel import checked_threads
from dynamics.learned.ewda_kernel import Cloud, CompiledMoments, NumpyMoments
from dynamics.learned.stored import EWDA
from dynamics.learned.transitions import DataOrigin, Normalisation

if TYPE_CHECKING:
    import xarray as xr

_MIN_SIGMA = 1e-50
"""Minimum sigma in normalised units; its fourth power does not underflow."""
_MAX_SIGMA = 1e50
"""Maximum sigma in normalised units; its fourth power does not overflow."""
_MAX_WIDTHS_FROM_DATA = 1e150
"""Maximum size of a query in normalised units, relative to min(sigma, 1); squared distances do not overflow."""


@dataclass(frozen=True, eq=False)
class EwdaModel:
    """Model ``g(z) = E_w y`` with weights ``w_i = exp(-|z~ - z~_i|² / 2 sigma²)``, where z~ is z in normalised units.

    The equation is eq. 11 (lemma 3) of "How does noising data affect learned contact dynamics?" (Suh et al.).
    sigma is in normalised units too. The last output is ``log p(z)``, the logarithm of
    the mean of the Gaussian densities of width sigma around the data, in normalised coordinates.
    The derivatives are moments under the weights,

        dy/dz~ = Cov(y, z~) / sigma²,              dlog p/dz~ = (E z~ - z~) / sigma²,
        d²(nu'y)/dz~² = E[nu'(y - E y) d d'] / sigma⁴, d²log p/dz~² = E[d d'] / sigma⁴ - I / sigma²

    with ``d = z~_i - E z~``. Far from the data g is the target of the nearest point.

    ``z`` (n, nz) and ``y`` (n, ny) are the data in their own units. `backend` is ``c``, ``numpy``,
    or ``auto`` for the faster one that is available; `threads` is the number of threads of ``c``, None for all
    CPUs. Results of a backend do not depend on the threads or on other queries.

    Raises ``ValueError`` for sigma or data that are not finite, for sigma <= 0, and for shapes that do not fit
    each other; a call raises ``ValueError`` for a query that is not finite.
    """

    kind: ClassVar[str] = EWDA

    z: np.ndarray
    y: np.ndarray
    scales: Normalisation
    sigma: float
    origin: DataOrigin
    seed: int = 0
    backend: str = field(default="auto", kw_only=True)
    threads: int | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        _check_sigma(self.sigma)
        _check_data(self.z, self.y)
        checked_threads(self.threads)
        for quantity, size, n_named in (
            ("coordinates of z", self.z.shape[1], len(self.origin.z)),
            ("targets", self.y.shape[1], len(self.origin.y)),
            ("scales", self.z.shape[1], self.scales.scale.size),
        ):
            if size != n_named:
                raise ValueError(f"ewda: the data have {size} {quantity}, but {n_named} are named")

    @property
    def n_in(self) -> int:
        """Number of entries of z."""
        return self.z.shape[1]

    @property
    def n_out(self) -> int:
        """Number of outputs: the entries of y, and the logarithm of the density."""
        return self.y.shape[1] + 1

    def values(self, z: np.ndarray) -> np.ndarray:
        """Return ``(g, log p)`` (n, ny + 1) at ``z`` (n, nz)."""
        q = self._queries(z)
        return self._values(q, *self._engine.first_moments(q, slopes=False))

    def jacobians(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return ``(g, log p)`` (n, ny + 1) and its Jacobian (n, ny + 1, nz) at ``z`` (n, nz)."""
        q = self._queries(z)
        nearest, sums = self._engine.first_moments(q, slopes=True)
        mean = sums / sums[:, :1, :1]
        slopes = np.empty((len(q), self.n_out, self.n_in))
        slopes[:, :-1] = mean[:, 1:, 1:] - mean[:, 1:, :1] * mean[:, :1, 1:]
        slopes[:, -1] = (self._points.z[nearest] - q) + mean[:, 0, 1:]
        return self._values(q, nearest, sums), slopes / (self.sigma**2 * self.scales.scale)

    def curvatures(self, z: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Return ``sum_i weights_i d²(g, log p)_i/dz²`` (n, nz, nz), for ``weights`` (n, ny + 1)."""
        q = self._queries(z)
        _, sums = self._engine.first_moments(q, slopes=True)
        mean = sums / sums[:, :1, :1]
        total, products = self._engine.second_moments(q, mean[:, 0, 1:], mean[:, 1:, 0], weights)
        curvatures = products / total[:, None, None] / self.sigma**2
        curvatures -= weights[:, -1, None, None] * np.eye(self.n_in)
        return curvatures / (self.sigma**2 * np.outer(self.scales.scale, self.scales.scale))

    def _values(self, q: np.ndarray, nearest: np.ndarray, sums: np.ndarray) -> np.ndarray:
        n, nz = self.z.shape
        y = np.empty((len(q), self.n_out))
        y[:, :-1] = self.y[nearest] + sums[:, 1:, 0] / sums[:, :1, 0]
        square = np.sum(((self._points.z[nearest] - q) / self.sigma) ** 2, axis=1)
        peak = np.log(n) + nz * (0.5 * np.log(2 * np.pi) + np.log(self.sigma))
        y[:, -1] = np.log(sums[:, 0, 0]) - 0.5 * square - peak
        return y

    def _queries(self, z: np.ndarray) -> np.ndarray:
        """Return ``z`` in normalised units; raise ``ValueError`` for a wrong shape or numbers that are not finite."""
        z = np.asarray(z, dtype=float)
        if z.ndim != 2 or z.shape[1] != self.n_in:
            raise ValueError(f"ewda: queries must be (n, {self.n_in}), one a row, not {z.shape}")
        q = self.scales.normalise(z)
        if not (within := np.abs(q) < _MAX_WIDTHS_FROM_DATA * min(self.sigma, 1.0)).all():
            row, column = np.argwhere(~within)[0]
            name = self.origin.z[column].name
            raise ValueError(
                f"ewda: query {row} is infinitely far from the data or not finite"
                f" ({name} = {z[row, column]:g}); give finite states and inputs"
            )
        return q

    @cached_property
    def _points(self) -> Cloud:
        y = np.ascontiguousarray(self.y, dtype=float)
        return Cloud(np.ascontiguousarray(self.scales.normalise(self.z)), y, float(self.sigma))

    @cached_property
    def _engine(self) -> CompiledMoments | NumpyMoments:
        makers = {
            "c": lambda: CompiledMoments(self._points, self.threads),
            "numpy": lambda: NumpyMoments(self._points),
        }
        return choose_backend(self.backend, makers, "the weighted average of data")[1]

    def dataset(self) -> xr.Dataset:
        """Return the model as arrays and attributes for a file; :meth:`from_dataset` is the inverse."""
        import xarray as xr

        data = {
            "z_data": (("sample", "z"), self.z),
            "y_data": (("sample", "state"), self.y),
            "z_shift": ("z", self.scales.shift),
            "z_scale": ("z", self.scales.scale),
        }
        attributes = self.origin.attributes(EWDA) | {
            "sigma": float(self.sigma),
            "seed": int(self.seed),
        }
        return xr.Dataset(data, coords=self.origin.coordinates(), attrs=attributes)

    @classmethod
    def from_dataset(cls, dataset: xr.Dataset) -> EwdaModel:
        """Return the model that :meth:`dataset` stored, equal to the last bit.

        Raises ``ValueError`` for a dataset that is not such a model or is incomplete.
        """
        origin = DataOrigin.from_dataset(dataset, EWDA)
        names = ("z_data", "y_data", "z_shift", "z_scale")
        z, y, shift, scale = (np.ascontiguousarray(dataset[name].values, dtype=float) for name in names)
        attributes = dataset.attrs
        scales, sigma = Normalisation(shift, scale), float(attributes["sigma"])
        return cls(z, y, scales, sigma, origin, int(attributes["seed"]))


def _check_sigma(sigma: float) -> None:
    if not _MIN_SIGMA <= sigma <= _MAX_SIGMA:
        raise ValueError(
            "ewda: sigma, the width of the noise in normalised units, must be above 0 and finite"
            f" (from {_MIN_SIGMA:g} to {_MAX_SIGMA:g}), not {sigma:g}; 0.2 is a common choice"
        )


def _check_data(z: np.ndarray, y: np.ndarray) -> None:
    if z.ndim != 2 or y.ndim != 2 or len(z) != len(y) or not len(z):
        raise ValueError(
            f"ewda: the data must be z (n, nz) and y (n, ny) with one row a sample and at least"
            f" one, not {z.shape} and {y.shape}"
        )
    for name, array in (("z", z), ("y", y)):
        if not np.isfinite(array).all():
            row = np.argwhere(~np.isfinite(array))[0][0]
            raise ValueError(f"ewda: row {row} of {name} is not finite; leave such samples out")
