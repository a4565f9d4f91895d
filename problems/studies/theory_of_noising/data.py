"""N0: theory of learning from noised data, checked with weighted averages and networks."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from dynamics.learned.collecting import collect_transitions
from dynamics.learned.ewda import EwdaModel
from dynamics.learned.transitions import DataOrigin, Normalisation, Transitions
from dynamics.systems.parameters import Signal
from problems.regions import region_of
from problems.registry import spec
from problems.studies.progress import track_items
from problems.studies.shared.noised_line import LinePusher, average_of, model_values, network_of
from problems.studies.study import CODE, StudyParams, dataset, setting
from problems.studies.theory_of_noising import lemmas


class Params(StudyParams):
    """Parameters of study N0; the paper gives no numbers."""

    rho: float = setting(0.99, "1", "slope of the pusher's step in contact", above=0, most=1)
    sigma: float = setting(0.1, "m", "noise of the networks and of the rollouts", CODE, above=0)
    epochs: int = setting(1500, "1", "steps in which a network is trained", least=1)
    repeats: int = setting(5, "1", "draws of pairs, each for another network", least=1)
    n_samples: int = setting(100_000, "1", "data in many dimensions", least=100)


QUICK = {"epochs": 15, "repeats": 1, "n_samples": 2000}


def run(params: Params) -> xr.Dataset:
    """Compute the checks of the lemmas, of walls, ends of the data, networks and effective neighbours."""
    rho, sigma, seed = params.rho, params.sigma, params.seed
    variables = {
        # The networks come first, since the libraries for training may be missing.
        **train_networks(rho, sigma, params.epochs, params.repeats, seed),
        **lemmas.uniform_data(),
        **lemmas.noised_risks(rho, seed),
        **lemmas.score_error(seed),
        **lemmas.truncated_normal(),
        **lemmas.climb_density(sigma, seed),
        **lemmas.near_the_ends(rho),
        **uniform_cloud(params.n_samples, seed),
        **along_the_task(params.n_samples, seed),
    }
    coordinates = {
        "command": (lemmas.COMMANDS, "1", "slope of the step in contact"),
        "width": (lemmas.WIDTHS, "m", "sigma"),
        "place": (lemmas.PLACES, "1", "of the kink between two data"),
        "spacing": (lemmas.SPACINGS, "1", "of the data over sigma"),
        "case": list(lemmas.CASES),
        "change": (lemmas.CHANGES, "m", "perturbation, root mean square"),
        "candidate": list(lemmas.CANDIDATES),
        "dimension": (lemmas.DIMENSIONS, "1", "coordinates"),
        "spread": (lemmas.SPREADS, "1", "sigma over the data's deviation"),
        "gap": (lemmas.GAPS, "m", "distance of the walls"),
        "depth": (lemmas.DEPTHS, "1", "penetration over sigma"),
        "sample": (lemmas.SAMPLES, "1", "random states between the walls"),
        "end": list(lemmas.ENDS),
        "distance": (lemmas.DISTANCES, "1", "from the data's end over sigma"),
        "units": (UNITS, "1", "in each of two layers"),
        "pairs": (PAIRS, "1", "noised pairs trained on"),
        "dim": (DIMENSIONS, "1", "coordinates"),
        "normalised": (SPREADS, "1", "sigma over deviation"),
        "problem": list(PROBLEMS),
        "drawn": list(DRAWN),
    }
    return dataset(variables, coordinates)


PAIRS = np.array([32, 128, 512, 2048])
"""Numbers of noised input-output pairs for the training of networks."""
UNITS = np.array([2, 4, 16])
"""Numbers of units in each of the two layers of a network."""
_COMMANDS = 200
"""Number of commands in the data for the networks."""
_NETWORK_QUERIES = 2000
"""Number of points at which networks are compared with g_sigma."""


def train_networks(rho: float, sigma: float, epochs: int, repeats: int, seed: int) -> dict[str, Any]:
    """Compute the root mean square of h_sigma - g_sigma over the noised data, for networks of several sizes.

    Each network is trained on a separate draw of noise on the same 200 commands, with all pairs in one batch.
    """
    pusher, rng = LinePusher(rho), np.random.default_rng([seed, 4])
    u = rng.uniform(-1, 1, _COMMANDS)
    model = average_of(u, pusher.step(u), sigma)
    queries = rng.choice(u, _NETWORK_QUERIES) + sigma * rng.standard_normal(_NETWORK_QUERIES)
    g = model_values(model, queries)
    errors = np.empty((len(UNITS), len(PAIRS), repeats))
    for row, column, repeat in track_items("networks", list(np.ndindex(errors.shape))):
        n, units = int(PAIRS[column]), int(UNITS[row])
        commands = rng.choice(u, n)
        z = commands + sigma * rng.standard_normal(n)
        recipe = {"hidden": (units, units), "epochs": epochs, "batch": n, "rate": 1e-2, "held_out": 0.0}
        h = network_of(z, pusher.step(commands), 0.0, repeat, **recipe)
        errors[row, column, repeat] = np.sqrt(np.mean((model_values(h, queries) - g) ** 2))
    noise = np.sqrt(np.mean((g - pusher.step(queries)) ** 2))
    return {
        "network_error": (("units", "pairs", "repeat"), errors, "m", "root mean square of h_sigma - g_sigma"),
        "noising_effect": ((), noise, "m", "root mean square of g_sigma - f"),
    }


DIMENSIONS = np.arange(1, 13)
"""Numbers of dimensions of the uniform cloud."""
SPREADS = np.array([0.1, 0.2, 0.4])
"""Ratios of sigma to the data's standard deviation in each coordinate."""
PROBLEMS = ("planar-push", "planar-hand")
"""Names of the problems whose effective neighbours are counted."""
DRAWN = ("ranges alone", "half in the tube")
"""Names of the regions from which transitions are drawn: uniform ranges, or half around the line to the goal."""
_NEIGHBOUR_QUERIES = 100
"""Number of points whose effective neighbours are counted."""


def effective_neighbours(z: np.ndarray, scales: Normalisation, sigma: float, queries: np.ndarray) -> np.ndarray:
    """Return the effective neighbours ``(sum w)²/sum w²`` (k,) of data z (n, d) at ``queries`` (k, d).

    The squares w² are Gaussian weights of width sigma/sqrt(2), so that both sums are densities, as in the
    denominator of lemma 3: ``(sqrt(4 pi) sigma)^d n p_sigma²/p_(sigma/sqrt(2))``.
    """
    names = tuple(Signal(f"z{i}", "1") for i in range(z.shape[1]))
    wide, narrow = (
        EwdaModel(z, z[:, :1], scales, s, DataOrigin(names, names[:1])).values(queries)[:, -1]
        for s in (sigma, sigma / np.sqrt(2))
    )
    bells = z.shape[1] * np.log(np.sqrt(4 * np.pi) * sigma)
    return np.exp(bells + np.log(len(z)) + 2 * wide - narrow)


def uniform_cloud(n: int, seed: int) -> dict[str, Any]:
    """Compute median effective neighbours near the middle of n uniform points with standard deviation 1 per axis.

    A large number is close to ``n (2 sqrt(pi) sigma/length)^d``, for which integrals replace the sums.
    """
    rng = np.random.default_rng([seed, 5])
    half_width, largest_dimension = np.sqrt(3.0), int(DIMENSIONS[-1])
    cloud, queries = (
        rng.uniform(-half_width, half_width, (n, largest_dimension)),
        rng.uniform(-0.3, 0.3, (_NEIGHBOUR_QUERIES, largest_dimension)),
    )
    counts = np.empty((len(DIMENSIONS), len(SPREADS)))
    for row, dim in enumerate(track_items("neighbours", DIMENSIONS.tolist())):
        scales = Normalisation(np.zeros(dim), np.ones(dim))
        z = np.ascontiguousarray(cloud[:, :dim])
        counts[row] = [np.median(effective_neighbours(z, scales, s, queries[:, :dim])) for s in SPREADS]
    law = n * (np.sqrt(np.pi / 3) * SPREADS) ** DIMENSIONS[:, None]
    dimensions = ("dim", "normalised")
    return {
        "neighbours": (dimensions, counts, "1", "effective neighbours, median of queries"),
        "neighbours_law": (dimensions, law, "1", "the same by integrals"),
    }


def along_the_task(n: int, seed: int) -> dict[str, Any]:
    """Compute effective neighbours among n transitions of two problems, near the line from start to goal."""
    shape = (len(PROBLEMS), len(DRAWN), len(SPREADS))
    counts, size = np.empty(shape), np.empty(len(PROBLEMS))
    for row, name in enumerate(track_items("neighbours along tasks", PROBLEMS)):
        problem_spec = spec(name)
        problem = problem_spec.problem()
        region, step = region_of(problem_spec, problem_spec.params({}), problem), problem.exact_step
        mixed = collect_transitions(step, region, n, seed)
        ranges, tube = _rows(collect_transitions(step, region, 2 * n, seed + 1)), slice(-_NEIGHBOUR_QUERIES, None)
        scales, queries = mixed.normalisation, ranges[tube]
        size[row] = queries.shape[1]
        for column, z in enumerate((ranges[:n], _rows(mixed))):
            counts[row, column] = [np.median(effective_neighbours(z, scales, s, queries)) for s in SPREADS]
    return {
        "task_neighbours": (
            ("problem", "drawn", "normalised"),
            counts,
            "1",
            "effective neighbours in the tube, median of queries",
        ),
        "task_size": ("problem", size, "1", "coordinates of state and input"),
    }


def _rows(data: Transitions) -> np.ndarray:
    return np.hstack([data.x, data.u])
