"""Multilayer perceptrons learned from transitions, with first and second derivatives by matrix products."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from dynamics.learned.stored import MLP
from dynamics.learned.transitions import DataOrigin, Normalisation

if TYPE_CHECKING:
    import xarray as xr

QUERIES_PER_BLOCK = 256
"""Maximum number of queries that are evaluated at once; it limits the memory of the layers' Jacobians."""
# Number of queries up to which each is a separate matrix product.
SMALL_BATCH = 64
IGNORE_OVERFLOW = np.errstate(over="ignore", invalid="ignore")
"""Context that suppresses NumPy's overflow warnings; callers check for results that are not finite."""


@dataclass(frozen=True, eq=False)
class MlpModel:
    """Network ``y = shift_y + scale_y (W_L a_L + b_L)``, ``a_{l+1} = elu(W_l a_l + b_l)``.

    ``a_0`` is z normalised; ``weights[l]`` (n_{l+1}, n_l) and ``biases[l]`` (n_{l+1},) are float64, although training
    is in float32. ``elu(s) = s`` for s > 0, else ``exp(s) - 1``, has one continuous derivative; the second derivative
    jumps at s = 0, where the left limit is used. ``sigma`` is the standard deviation of the training noise in
    normalised units of z, 0 for clean data.

    Far from the data y grows linearly. For a query that is not finite, the result is the limit of y or is not
    finite; the other queries are not affected.
    """

    kind: ClassVar[str] = MLP

    weights: tuple[np.ndarray, ...]
    biases: tuple[np.ndarray, ...]
    z_scales: Normalisation
    y_scales: Normalisation
    sigma: float
    origin: DataOrigin
    seed: int = 0

    @property
    def n_in(self) -> int:
        """Number of entries of z."""
        return self.weights[0].shape[1]

    @property
    def n_out(self) -> int:
        """Number of entries of y."""
        return self.weights[-1].shape[0]

    @property
    def hidden(self) -> tuple[int, ...]:
        """Number of units of each hidden layer."""
        return tuple(bias.size for bias in self.biases[:-1])

    @IGNORE_OVERFLOW
    def values(self, z: np.ndarray) -> np.ndarray:
        """Return ``y`` (n, n_out) at ``z`` (n, n_in)."""
        y = np.empty((len(z), self.n_out))
        for rows in _blocks(len(z)):
            a = self.z_scales.normalise(z[rows])
            for W, b in zip(self.weights[:-1], self.biases[:-1], strict=True):
                a = _elu(a @ W.T + b)[0]
            y[rows] = self.y_scales.denormalise(a @ self.weights[-1].T + self.biases[-1])
        return y

    @IGNORE_OVERFLOW
    def jacobians(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return ``y`` (n, n_out) and ``dy/dz`` (n, n_out, n_in), by forward mode through the layers."""
        y, jacobians = np.empty((len(z), self.n_out)), np.empty((len(z), self.n_out, self.n_in))
        for rows in _blocks(len(z)):
            last, J = self._forward(z[rows])[-1]
            y[rows] = self.y_scales.denormalise(last)
            jacobians[rows] = self.y_scales.scale[:, None] * J.swapaxes(1, 2)
        return y, jacobians

    @IGNORE_OVERFLOW
    def curvatures(self, z: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Return ``sum_i weights_i d²y_i/dz²`` (n, n_in, n_in), symmetric, for ``weights`` (n, n_out).

        It is ``sum_l J_l' diag(adj_l elu''(s_l)) J_l`` over the hidden layers, with pre-activations s_l,
        ``J_l = ds_l/dz``, and adj_l the derivative of ``weights'y`` with respect to ``elu(s_l)``.
        """
        curvatures = np.empty((len(z), self.n_in, self.n_in))
        for rows in _blocks(len(z)):
            curvatures[rows] = self._curvatures(z[rows], weights[rows])
        return curvatures

    def _curvatures(self, z: np.ndarray, weights: np.ndarray) -> np.ndarray:
        adjoint = (weights * self.y_scales.scale) @ self.weights[-1]
        curvatures = np.zeros((len(z), self.n_in, self.n_in))
        hidden = self._forward(z)[:-1]
        for W, (s, J) in zip(reversed(self.weights[:-1]), reversed(hidden), strict=True):
            _, slope, curvature = _elu(s)
            curvatures += (J * (adjoint * curvature)[:, None, :]) @ J.swapaxes(1, 2)
            adjoint = (adjoint * slope) @ W
        # The product of a matrix and its scaled transpose is symmetric only up to rounding.
        return 0.5 * (curvatures + curvatures.swapaxes(1, 2))

    def _forward(self, z: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return each layer's pre-activation s (n, n_l) and ``ds/dz`` (n, n_in, n_l); the last s is y, normalised."""
        W, b = self.weights[0], self.biases[0]
        J = np.broadcast_to((W / self.z_scales.scale).T, (len(z), self.n_in, b.size))
        layers = [(self.z_scales.normalise(z) @ W.T + b, J)]
        for W, b in zip(self.weights[1:], self.biases[1:], strict=True):
            s, J = layers[-1]
            a, slope, _ = _elu(s)
            layers.append((a @ W.T + b, _product(J * slope[:, None, :], W)))
        return layers

    def dataset(self) -> xr.Dataset:
        """Return the network as arrays and attributes for a file; :meth:`from_dataset` is the inverse."""
        import xarray as xr

        data = {}
        dimensions = ["z", *(f"unit_{layer}" for layer in range(len(self.hidden))), "state"]
        for layer, (W, b) in enumerate(zip(self.weights, self.biases, strict=True)):
            dimension_in, dimension_out = dimensions[layer : layer + 2]
            data |= {f"weight_{layer}": ((dimension_out, dimension_in), W), f"bias_{layer}": (dimension_out, b)}
        data |= {
            "z_shift": ("z", self.z_scales.shift),
            "z_scale": ("z", self.z_scales.scale),
            "y_shift": ("state", self.y_scales.shift),
            "y_scale": ("state", self.y_scales.scale),
        }
        attributes = self.origin.attributes(MLP) | {
            "sigma": float(self.sigma),
            "seed": int(self.seed),
        }
        attributes |= {"activation": "elu", "layers": len(self.weights)}
        return xr.Dataset(data, coords=self.origin.coordinates(), attrs=attributes)

    @classmethod
    def from_dataset(cls, dataset: xr.Dataset) -> MlpModel:
        """Return the network that :meth:`dataset` stored, equal to the last bit.

        Raises ``ValueError`` for a dataset that is not a network or is incomplete.
        """
        origin = DataOrigin.from_dataset(dataset, MLP)
        layers = range(int(dataset.attrs["layers"]))
        names = [f"{array}_{layer}" for layer in layers for array in ("weight", "bias")]
        names += ["z_shift", "z_scale", "y_shift", "y_scale"]
        arrays = {name: np.ascontiguousarray(dataset[name].values, float) for name in names}
        return cls(
            tuple(arrays[f"weight_{layer}"] for layer in layers),
            tuple(arrays[f"bias_{layer}"] for layer in layers),
            Normalisation(arrays["z_shift"], arrays["z_scale"]),
            Normalisation(arrays["y_shift"], arrays["y_scale"]),
            float(dataset.attrs["sigma"]),
            origin,
            int(dataset.attrs["seed"]),
        )


def _blocks(n: int) -> Iterator[slice]:
    return (slice(start, start + QUERIES_PER_BLOCK) for start in range(0, n, QUERIES_PER_BLOCK))


def _product(J: np.ndarray, W: np.ndarray) -> np.ndarray:
    """Return ``J_i W'`` (n, n_in, n_out) for J (n, n_in, k) and W (n_out, k)."""
    # One product of all rows uses several threads, but when other programs run it waits 8 ms for a
    # thread without a core; the small products of a plan's stages, each on one thread, take 0.3 ms.
    if len(J) <= SMALL_BATCH:
        return J @ W.T
    return (J.reshape(-1, J.shape[2]) @ W.T).reshape(*J.shape[:2], len(W))


def _elu(s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the activation elu(s) and its first and second derivatives."""
    below = np.minimum(s, 0.0)
    slope = np.exp(below)
    return np.maximum(s, 0.0) + np.expm1(below), slope, np.where(s > 0.0, 0.0, slope)
