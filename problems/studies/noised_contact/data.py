"""N1: models of a pushed block and of a block between walls, learned from sparse or dense noised data."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import xarray as xr

from dynamics.learned.ewda import EwdaModel
from dynamics.learned.mlp import MlpModel
from problems.studies.shared.noised_line import LinePusher, Walls, average_of, model_values, network_of
from problems.studies.study import CODE, StudyParams, dataset, setting

REGIMES = ("sparse", "dense")
"""Names of the two amounts of data."""
STARTS = np.array([-1.6, -1.25, -1.05, 1.05, 1.25, 1.6])
"""Initial states of the rollouts [m], which penetrate the walls by at most six sigma."""
DOTS = np.linspace(-1.4, 1.4, 29)
"""Commands at which f_sigma is sampled [m]."""
SPARSE_STATES = 5
"""Number of the block's states in sparse data."""
SPARSE_REACH = 0.5
"""Largest distance [m] of the block's sparse states from the middle."""
STEPS = 12
"""Number of steps of a rollout."""
_TRAINING_ROWS = 2000
"""Number of rows up to which a small data set is repeated, so that minibatches average over the noise."""
_ROWS_TRAINED_ON = 1600
"""Number of training rows; the other rows select the best epoch, since the weights fluctuate until the end."""


class Params(StudyParams):
    """Parameters of study N1; the paper gives no numbers."""

    rho: float = setting(0.99, "1", "slope of the pusher's step in contact", above=0, most=1)
    sigma: float = setting(0.1, "m", "standard deviation of the noise", CODE, above=0)
    sparse: int = setting(10, "1", "commands in sparse data", least=3)
    dense: int = setting(1000, "1", "commands and states in dense data", least=100)
    draws: int = setting(1000, "1", "draws of noise for a dot of f_sigma", least=10)
    networks: int = setting(3, "1", "networks of each kind, of other seeds", least=1)
    units: int = setting(128, "1", "units in each of two layers", least=1)
    epochs: int = setting(2000, "1", "passes over 2000 rows of data in training", least=1)


QUICK = {"dense": 200, "draws": 100, "networks": 1, "units": 32, "epochs": 200}


def run(params: Params) -> xr.Dataset:
    """Compute the curves of fig. 1, rollouts, and the errors of g_sigma for many random data sets."""
    pusher, walls, sigma = LinePusher(params.rho), Walls(), params.sigma
    rng = np.random.default_rng([params.seed, 0])
    u, x = np.linspace(-1.4, 1.4, 421), np.linspace(-2, 2, 401)
    commands = {"sparse": rng.uniform(-1, 1, params.sparse), "dense": rng.uniform(-1, 1, params.dense)}
    states = {
        "sparse": rng.uniform(-SPARSE_REACH, SPARSE_REACH, SPARSE_STATES),
        "dense": rng.uniform(walls.low, walls.high, params.dense),
    }
    noise = sigma * rng.standard_normal((params.draws, len(DOTS)))
    samples = pusher.step(DOTS + noise)
    variables = {
        **_learned("pusher", "u", commands, u, pusher.step, params),
        **_learned("block", "x", states, x, lambda rest: rest, params),
        "f": ("u", pusher.step(u), "m", "block after a step, exact"),
        "f_sigma": ("u", pusher.smoothed(u, sigma), "m", "closed form"),
        "uniform_block": ("x", walls.noised(x, sigma), "m", "g_sigma of uniform states, closed form"),
        "sampled": ("dot", samples.mean(axis=0), "m", "f_sigma, mean of draws"),
        "sampled_error": (
            "dot",
            samples.std(axis=0, ddof=1) / np.sqrt(params.draws),
            "m",
            "standard error of that mean",
        ),
        "true_dots": ("dot", pusher.smoothed(DOTS, sigma), "m", "closed form"),
        **sample_sets(pusher, params.sparse, params.dense, params.seed),
    }
    return dataset(
        variables,
        {
            "u": (u, "m", "commanded pusher"),
            "x": (x, "m", "block before a step"),
            "dot": (DOTS, "m", "commanded pusher"),
            "regime": list(REGIMES),
            "start": (STARTS, "m", "block at first"),
            "step": (np.arange(STEPS + 1), "1", "steps"),
            "width": (WIDTHS, "m", "sigma"),
            "set": (np.arange(SETS), "1", "set of data"),
            "map": ["g_sigma", "h_sigma"],
        },
    )


def _learned(
    name: str,
    along: str,
    data: dict[str, np.ndarray],
    positions: np.ndarray,
    f: Callable[[np.ndarray], np.ndarray],
    params: Params,
) -> dict[str, Any]:
    """Return dataset variables of the map ``f``, of g_sigma and of networks h_sigma, at ``positions`` (k,).

    The variables include the data, rms values of h_sigma - g_sigma and g_sigma - f, weighted by the density of
    the noised data, and for the block rollouts from :data:`STARTS`.
    """
    g = np.empty((len(REGIMES), len(positions)))
    h = np.empty((len(REGIMES), params.networks, len(positions)))
    rms, effect = np.empty(h.shape[:2]), np.empty(len(REGIMES))
    paths = np.empty((len(REGIMES), 2, len(STARTS), STEPS + 1))
    variables = {}
    for row, regime in enumerate(REGIMES):
        z = data[regime]
        average = average_of(z, f(z), params.sigma)
        g[row], log_density = average.values(positions[:, None]).T
        density = np.exp(log_density) / np.exp(log_density).sum()
        effect[row] = np.sqrt(density @ (g[row] - f(positions)) ** 2)
        models: list[EwdaModel | MlpModel] = [average]
        for i in range(params.networks):
            models.append(_network(z, f(z), params, params.seed + i))
            h[row, i] = model_values(models[-1], positions)
            rms[row, i] = np.sqrt(density @ (h[row, i] - g[row]) ** 2)
        paths[row] = [roll_out_model(model) for model in models[:2]]
        variables[f"{name}_data_{regime}"] = (f"{name}_{regime}", np.sort(z), "m", f"{regime} data")
    if name == "block":
        dims = ("regime", "map", "start", "step")
        variables["rollout"] = (dims, paths, "m", "block, step after step")
    return {
        **variables,
        f"{name}_g": (("regime", along), g, "m", "g_sigma of random data"),
        f"{name}_h": (("regime", "network", along), h, "m", "h_sigma"),
        f"{name}_rms": (("regime", "network"), rms, "m", "of h_sigma - g_sigma"),
        f"{name}_effect": ("regime", effect, "m", "rms of g_sigma - f"),
    }


def _network(z: np.ndarray, y: np.ndarray, params: Params, seed: int) -> MlpModel:
    times = max(1, _TRAINING_ROWS // len(z))
    return network_of(
        np.tile(z, times),
        np.tile(y, times),
        params.sigma,
        seed,
        hidden=(params.units, params.units),
        epochs=params.epochs,
        batch=_ROWS_TRAINED_ON // 2,
        rate=3e-3,
        held_out=1 - _ROWS_TRAINED_ON / _TRAINING_ROWS,
        patience=params.epochs,
    )


def roll_out_model(model: EwdaModel | MlpModel) -> np.ndarray:
    """Return the states (n_starts, STEPS + 1) of the model's rollouts from :data:`STARTS`."""
    path = [STARTS]
    for _ in range(STEPS):
        path.append(model_values(model, path[-1]))
    return np.transpose(path)


SETS = 20
"""Number of random data sets over which sampling errors are measured."""
WIDTHS = np.array([0.05, 0.1, 0.2])
"""Standard deviations sigma [m] of the noise, for data in [-1, 1] m."""
DEPTHS = np.array([0.0, 0.05, 0.1, 0.2, 0.5, 1.0, 10.0])
"""Penetrations [m] of the states from which g_sigma should return to between the walls in one step."""


def sample_sets(pusher: LinePusher, sparse: int, dense: int, seed: int) -> dict[str, Any]:
    """Compute, for many random data sets, errors and slopes of g_sigma and its next states from penetration.

    A weighted mean of random data has the standard error ``|w (y - g)|/sum w``. Errors divided by it
    have variance 1 if g_sigma differs from f_sigma only because the data are random.
    """
    shape = (len(WIDTHS), SETS)
    square, bias, error, at_end, steepest, flattest, inside = np.empty((7, *shape))
    penetrating = np.concatenate((-1 - DEPTHS, 1 + DEPTHS))
    for row, sigma in enumerate(WIDTHS):
        middle = np.linspace(-1 + 3 * sigma, 1 - 3 * sigma, 101)
        true = pusher.smoothed(middle, sigma)
        for i in range(SETS):
            rng = np.random.default_rng([seed, 1, i])
            u, few = rng.uniform(-1, 1, dense), rng.uniform(-1, 1, sparse)
            g, deviation = _with_error(u, pusher.step(u), sigma, middle)
            errors = g - true
            # Where the pusher does not touch the block, f and the errors are 0.
            has_error = deviation > 1e-3 * sigma
            square[row, i] = np.mean((errors / deviation)[has_error] ** 2)
            bias[row, i], error[row, i] = np.sqrt(np.mean(errors**2)), np.sqrt(np.mean(deviation**2))
            end, doubt = _with_error(u, pusher.step(u), sigma, np.array([1.0]))
            at_end[row, i] = (end[0] - pusher.smoothed(1.0, sigma)) / doubt[0]
            steepest[row, i], flattest[row, i] = _slopes(pusher, few, sigma)
            states = rng.uniform(-1, 1, dense)
            x_next = model_values(average_of(states, states, sigma), penetrating)
            inside[row, i] = np.min(1 - np.abs(x_next))
    dimensions = ("width", "set")
    return {
        "score_square": (dimensions, square, "1", "mean of ((g - f_sigma)/standard error)², 3 sigma off ends"),
        "dense_rms": (dimensions, bias, "m", "rms of g_sigma - f_sigma, 3 sigma off ends"),
        "dense_error": (dimensions, error, "m", "rms of the standard error of g_sigma"),
        "end_score": (dimensions, at_end, "1", "(g - f_sigma)/standard error at the upper end"),
        "steepest": (dimensions, steepest, "1", "slope of g_sigma over rho, sparse data"),
        "flattest": (dimensions, flattest, "1", "the least in contact, within the data"),
        "least_inside": (dimensions, inside, "m", "way inside the wall after one step"),
    }


def _with_error(z: np.ndarray, y: np.ndarray, sigma: float, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return g_sigma at ``positions`` (k,) and its standard error over random draws of the data, (k,) each."""
    g = average_of(z, y, sigma).values(positions[:, None])[:, 0]
    weight = np.exp(-0.5 * ((positions[:, None] - z) / sigma) ** 2)
    spread = np.sqrt(np.sum((weight * (y - g[:, None])) ** 2, axis=1))
    return g, spread / weight.sum(axis=1)


def _slopes(pusher: LinePusher, z: np.ndarray, sigma: float) -> tuple[float, float]:
    """Return the largest and smallest slope of g_sigma divided by rho, from sigma above the kink to the last datum."""
    model = average_of(z, pusher.step(z), sigma)
    positions = np.linspace(pusher.c + sigma, z.max(), 400)
    slope = model.jacobians(positions[:, None])[1][:, 0, 0] / pusher.rho
    return slope.max(), slope.min()
