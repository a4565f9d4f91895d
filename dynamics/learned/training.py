"""Training of networks on transitions with clean or noised inputs."""

from __future__ import annotations

import functools
import hashlib
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np

from dynamics.errors import InputError
from dynamics.learned.mlp import MlpModel
from dynamics.learned.transitions import Samples, split_rows
from dynamics.settings import Configured, read_value, setting


@dataclass(frozen=True)
class Recipe(Configured):
    """Hyperparameters of a network's training; defaults are those of Suh et al. for 1e5 transitions of pushing.

    With held_out = 0 training uses all rows, runs all epochs, and returns the last weights instead of the best.
    """

    name: ClassVar = "mlp"
    hidden: tuple[int, ...] = setting(
        (128,) * 4, "units of each hidden layer", hint="one a layer, with commas, such as 64,64", least=1, most=100_000
    )
    epochs: int = setting(200, "largest number of passes over the data", least=1)
    batch: int = setting(2048, "samples of a step, or all where there are fewer", least=1)
    rate: float = setting(1e-3, "learning rate of Adam", above=0)
    held_out: float = setting(0.1, "share of the rows that is never trained on", least=0, below=1)
    patience: int = setting(30, "epochs without a lower held-out error after which training ends", least=1)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.hidden:
            raise InputError("mlp: hidden has no layers; give at least one, such as 128")


@dataclass(frozen=True)
class Epoch:
    """Mean squared errors per coordinate after one pass over the data, in units of the scales of y.

    ``train`` is the mean over the pass, with the noise of training; ``clean`` and ``noised`` are the
    errors on held-out rows (NaN if no row is held out), ``best`` is the lowest ``noised`` so far.
    """

    number: int
    train: float
    clean: float
    noised: float
    best: float


class Training:
    """Training run that minimises ``E |h(z + sigma w) - y|²`` by Adam, with new w ~ N(0, I) in every minibatch.

    The loss is eq. 3 of "How does noising data affect learned contact dynamics?" (Suh et al.). z and y are
    normalised; noise is added to z only. The network predicts the next state as in the paper, so that the
    minimiser is the smoothed step ``g_sigma(z~) = E[y | z~]``, where z~ is the noised z. A network for the
    increment, added to the noised state x~, would give a different law: ``x~ + E[y - x | x~]`` contains the
    noise, and its rollouts do not return to the data.

    Training is in float32. The same seed, data and recipe give the same bits on one computer with the same
    settings of JAX and the same number of processors, which determines the order of sums. If ``state`` is the
    state of an earlier training, that training is continued, with the same bits as an uninterrupted run; an
    interrupted epoch is repeated.

    Raises ``ValueError`` for a negative sigma, too few rows, a constant column, or a state of another
    training, and if the extra ``learn`` is not installed.
    """

    def __init__(
        self,
        data: Samples,
        sigma: float,
        recipe: Recipe | None = None,
        seed: int = 0,
        state: dict[str, np.ndarray] | None = None,
    ) -> None:
        self.data, self.sigma, self.seed = data, read_value("mlp: sigma", sigma, float, least=0), seed
        self.recipe = recipe or Recipe()
        self.trained_on, self.held_out = split_rows(len(data.z), self.recipe.held_out, seed)
        if len(self.trained_on) < 2 or (self.recipe.held_out and not len(self.held_out)):
            raise ValueError(
                f"data: {len(data.z)} rows are too few to train on with"
                f" {100 * self.recipe.held_out:g} % of them held out; collect more"
            )
        self._scales = data.scales
        self._network = Network(data.z.shape[1], data.y.shape[1], self.recipe, self.sigma, seed)
        self._now = self._initial_progress(state)

    @property
    def epoch(self) -> int:
        """Number of passes over the data so far."""
        return self._now.number

    @property
    def error(self) -> float:
        """Lowest mean squared error so far on held-out rows with noised inputs; infinite if no row is held out."""
        return self._now.least

    @property
    def done(self) -> bool:
        """Whether all epochs are done or the held-out error has not decreased for ``patience`` epochs."""
        progress, recipe = self._now, self.recipe
        stale = len(self.held_out) > 0 and progress.number - progress.best_at >= recipe.patience
        return progress.number >= recipe.epochs or stale

    def epochs(self) -> Iterator[Epoch]:
        """Run the remaining epochs, and yield the errors after each; raise ``ValueError`` when training diverges."""
        z, y = (
            scales.normalise(rows).astype(np.float32)
            for scales, rows in zip(self._scales, (self.data.z, self.data.y), strict=True)
        )
        network = self._network
        samples = network.on_device(z[self.trained_on], y[self.trained_on])
        held_out_samples = network.on_device(z[self.held_out], y[self.held_out])
        while not self.done:
            progress, train = network.epoch(self._now, *samples)
            clean = noised = math.nan
            if len(self.held_out):
                clean, noised = network.errors(progress.layers, *held_out_samples)
            if not math.isfinite(train):
                raise ValueError(
                    f"mlp: training diverged in epoch {progress.number}; lower rate (now {self.recipe.rate:g})"
                )
            if not len(self.held_out) or noised < progress.least:
                progress = replace(progress, best=progress.layers, best_at=progress.number, least=noised)
            self._now = progress
            yield Epoch(progress.number, train, clean, noised, progress.least)

    @property
    def state(self) -> dict[str, np.ndarray]:
        """Arrays of a checkpoint: current and best weights, Adam's moments, the epoch, and a digest of the inputs."""
        identity = np.frombuffer(self._identity(), dtype=np.uint8)
        return {"identity": identity, **self._network.arrays(self._now)}

    def _initial_progress(self, state: dict[str, np.ndarray] | None) -> Progress:
        if state is None:
            return self._network.start
        if "identity" not in state or bytes(state["identity"]) != self._identity():
            raise ValueError("mlp: the checkpoint has other data, recipe, sigma or seed; start again")
        return self._network.progress(state)

    def _identity(self) -> bytes:
        """Return a digest of everything that determines the weights, except epochs and patience, which may change."""
        recipe = self.recipe
        identity = recipe.hidden, recipe.batch, recipe.rate, recipe.held_out, self.sigma, self.seed
        identity = (*identity, self.data.hash)
        return hashlib.sha256(repr(identity).encode()).digest()

    def model(self) -> MlpModel:
        """Return the network with the best weights so far, or with the last weights if no row is held out."""
        best_layers = self._now.best
        weights = tuple(np.array(layer.weight, float) for layer in best_layers)
        biases = tuple(np.array(layer.bias, float) for layer in best_layers)
        data_origin = self.data.origin
        origin = replace(data_origin, data_hash=data_origin.data_hash or self.data.hash)
        return MlpModel(weights, biases, *self._scales, self.sigma, origin, self.seed)


def train_network(data: Samples, sigma: float, seed: int = 0, **recipe: Any) -> MlpModel:
    """Train a network to the end, see :class:`Training`; ``recipe`` contains the settings of :class:`Recipe`."""
    training = Training(data, sigma, Recipe(**recipe), seed)
    for _ in training.epochs():
        pass
    return training.model()


EPOCH_STREAM = 1
"""Index of the random stream that orders the rows and draws the noise of the epochs."""
HELD_OUT_STREAM = 2
"""Index of the random stream for the noise on held-out rows."""


@dataclass(frozen=True)
class Progress:
    """State of a training run: current layers and Adam's moments, and the layers with the lowest error so far.

    It is replaced as a whole after every epoch, so that an interrupted epoch leaves it unchanged.
    """

    layers: Any
    moments: Any
    best: Any
    number: int = 0
    best_at: int = 0
    least: float = math.inf


class Network:
    """A network in training: JAX functions that update its float32 weights and measure its errors."""

    def __init__(self, n_in: int, n_out: int, recipe: Recipe, sigma: float, seed: int) -> None:
        jax, _, optax = _libraries()
        self._jax, key = jax, jax.random.key(seed, impl="threefry2x32")
        self._sigma = np.float32(sigma)
        self._draws, self._held = (jax.random.fold_in(key, stream) for stream in (EPOCH_STREAM, HELD_OUT_STREAM))
        layers = _layers((n_in, *recipe.hidden, n_out), key)
        self.start = Progress(layers, optax.adam(recipe.rate).init(layers), layers)
        self._epoch, self._errors = _compiled(recipe.batch, recipe.rate, sigma > 0)

    def on_device(self, z: np.ndarray, y: np.ndarray) -> tuple[Any, Any]:
        """Return the rows as arrays on JAX's device."""
        return self._jax.device_put(z), self._jax.device_put(y)

    def epoch(self, progress: Progress, z: Any, y: Any) -> tuple[Progress, float]:
        """Return the progress after one more pass, with a new order and new noise, and the mean loss of the pass."""
        number = progress.number + 1
        key = self._jax.random.fold_in(self._draws, number)
        layers, moments, loss = self._epoch(progress.layers, progress.moments, key, self._sigma, z, y)
        return replace(progress, layers=layers, moments=moments, number=number), float(loss)

    def errors(self, layers: Any, z: Any, y: Any) -> tuple[float, float]:
        """Return the mean squared errors with clean and with noised inputs; the noise is the same in every call."""
        clean, noised = self._errors(layers, self._held, self._sigma, z, y)
        return float(clean), float(noised)

    def arrays(self, progress: Progress) -> dict[str, np.ndarray]:
        """Return the progress as a dict of arrays, for a checkpoint."""
        leaves = self._jax.tree.leaves((progress.layers, progress.moments, progress.best))
        leaf_arrays = {f"leaf_{i}": np.asarray(leaf) for i, leaf in enumerate(leaves)}
        return {"progress": np.array([progress.number, progress.best_at, progress.least]), **leaf_arrays}

    def progress(self, arrays: dict[str, np.ndarray]) -> Progress:
        """Return the progress stored by :meth:`arrays`."""
        jax, start = self._jax, self.start
        leaves, structure = jax.tree.flatten((start.layers, start.moments, start.best))
        restored_leaves = [jax.numpy.asarray(arrays[f"leaf_{i}"]) for i in range(len(leaves))]
        number, best_at, least_error = arrays["progress"]
        layers, moments, best_layers = jax.tree.unflatten(structure, restored_leaves)
        return Progress(layers, moments, best_layers, int(number), int(best_at), float(least_error))


@functools.cache
def _compiled(batch: int, rate: float, noised: bool) -> tuple[Any, Any]:
    """Return the functions of one epoch and of the errors, compiled once by JAX for all networks of the same sizes."""
    jax, _, optax = _libraries()
    adam = optax.adam(rate)

    def noise(key: Any, z: Any, sigma: Any) -> Any:
        return z + sigma * jax.random.normal(key, z.shape, z.dtype) if noised else z

    def loss(layers: Any, z: Any, y: Any) -> Any:
        return jax.numpy.mean((jax.vmap(lambda row: evaluate_network(layers, row))(z) - y) ** 2)

    @jax.jit
    def epoch(layers: Any, moments: Any, key: Any, sigma: Any, z: Any, y: Any) -> Any:
        size = min(batch, len(z))
        steps = len(z) // size
        order, draws = jax.random.split(key)
        # The last rows, which do not fill a batch, are omitted; each epoch has another order of rows.
        rows = jax.random.permutation(order, len(z))[: steps * size].reshape(steps, size)

        def step(carried: Any, drawn: Any) -> Any:
            (layers, moments), (rows, key) = carried, drawn
            value, slopes = jax.value_and_grad(loss)(layers, noise(key, z[rows], sigma), y[rows])
            updates, moments = adam.update(slopes, moments)
            return (optax.apply_updates(layers, updates), moments), value

        keys = jax.random.split(draws, steps)
        carried, values = jax.lax.scan(step, (layers, moments), (rows, keys))
        return *carried, jax.numpy.mean(values)

    @jax.jit
    def errors(layers: Any, key: Any, sigma: Any, z: Any, y: Any) -> Any:
        return loss(layers, z, y), loss(layers, noise(key, z, sigma), y)

    return epoch, errors


def evaluate_network(layers: Any, z: Any) -> Any:
    """Return the output of a network of Equinox layers for one row; input and output are normalised."""
    import jax

    for layer in layers[:-1]:
        z = jax.nn.elu(layer(z))
    return layers[-1](z)


def _layers(sizes: tuple[int, ...], key: Any) -> tuple[Any, ...]:
    jax, eqx, _ = _libraries()
    keys = jax.random.split(key, len(sizes) - 1)
    return tuple(
        eqx.nn.Linear(n_in, n_out, dtype=jax.numpy.float32, key=key)
        for (n_in, n_out), key in zip(pairwise(sizes), keys, strict=True)
    )


def _libraries() -> tuple[Any, Any, Any]:
    """Import JAX, Equinox and Optax; raise ``ValueError`` with the name of the extra if they are not installed."""
    try:
        import equinox
        import jax
        import optax
    except ImportError as error:
        raise ValueError(
            "training a network needs JAX, Equinox and Optax, which the extra learn installs: pip"
            " install 'centralpath[learn]' (evaluating one needs none of them)"
        ) from error
    return jax, equinox, optax
