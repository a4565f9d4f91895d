"""How many data an average is taken over, in many dimensions: the curse of dimension."""

from __future__ import annotations

from typing import Any

import numpy as np

from dynamics.learned.collecting import collect
from dynamics.learned.ewda import EwdaModel
from dynamics.learned.normalisation import Normalisation
from dynamics.learned.origin import Origin
from dynamics.learned.transitions import Transitions
from dynamics.systems.parameters import Signal
from problems.regions import region_of
from problems.registry import spec
from problems.studies.study import quantity_of

DIMENSIONS = np.arange(1, 13)
SPREADS = np.array([0.1, 0.2, 0.4])
"""sigma over the deviation of the data in each coordinate."""
PROBLEMS = ("planar-push", "planar-hand")
DRAWN = ("ranges alone", "half in the tube")
_QUERIES = 100


def effective(
    z: np.ndarray, scales: Normalisation, sigma: float, queries: np.ndarray
) -> np.ndarray:
    """``(sum w)²/sum w²`` (k,) of the weights of data z (n, d) at ``queries`` (k, d).

    w² are the weights of width sigma/sqrt(2), so that both sums are densities, that lemma 3's
    denominator says the logarithm of: ``(sqrt(4 pi) sigma)^d n p_sigma²/p_(sigma/sqrt(2))``.
    """
    names = tuple(Signal(f"z{i}", "1") for i in range(z.shape[1]))
    wide, narrow = (
        EwdaModel(z, z[:, :1], scales, s, Origin(names, names[:1])).values(queries)[:, -1]
        for s in (sigma, sigma / np.sqrt(2))
    )
    bells = z.shape[1] * np.log(np.sqrt(4 * np.pi) * sigma)
    return np.exp(bells + np.log(len(z)) + 2 * wide - narrow)


def uniform_cloud(n: int, seed: int) -> dict[str, Any]:
    """Median over queries near the middle of n points, uniform in every coordinate, deviation 1.

    Where many are near, it is ``n (2 sqrt(pi) sigma/length)^d``, the quotient of the integrals.
    """
    rng = np.random.default_rng([seed, 5])
    half, most = np.sqrt(3.0), int(DIMENSIONS[-1])
    cloud, at = rng.uniform(-half, half, (n, most)), rng.uniform(-0.3, 0.3, (_QUERIES, most))
    found = np.empty((len(DIMENSIONS), len(SPREADS)))
    for row, dim in enumerate(DIMENSIONS):
        scales = Normalisation(np.zeros(dim), np.ones(dim))
        z = np.ascontiguousarray(cloud[:, :dim])
        found[row] = [np.median(effective(z, scales, s, at[:, :dim])) for s in SPREADS]
    law = n * (np.sqrt(np.pi / 3) * SPREADS) ** DIMENSIONS[:, None]
    both = ("dim", "normalised")
    return {
        "neighbours": quantity_of(both, found, "1", "effective neighbours, median of queries"),
        "neighbours_law": quantity_of(both, law, "1", "the same by integrals"),
    }


def along_the_task(n: int, seed: int) -> dict[str, Any]:
    """The papers' two problems: n transitions, and queries in the tube from start to goal."""
    shape = (len(PROBLEMS), len(DRAWN), len(SPREADS))
    found, size = np.empty(shape), np.empty(len(PROBLEMS))
    for row, name in enumerate(PROBLEMS):
        own = spec(name)
        problem = own.problem()
        region, step = region_of(own, own.params({}), problem), problem.exact_step
        mixed = collect(step, region, n, seed)
        ranges, tube = _rows(collect(step, region, 2 * n, seed + 1)), slice(-_QUERIES, None)
        scales, queries = mixed.normalisation, ranges[tube]
        size[row] = queries.shape[1]
        for column, z in enumerate((ranges[:n], _rows(mixed))):
            found[row, column] = [np.median(effective(z, scales, s, queries)) for s in SPREADS]
    return {
        "task_neighbours": quantity_of(("problem", "drawn", "normalised"), found, "1",
                                       "effective neighbours in the tube, median of queries"),
        "task_size": quantity_of("problem", size, "1", "coordinates of state and input"),
    }  # fmt: skip


def _rows(data: Transitions) -> np.ndarray:
    return np.hstack([data.x, data.u])
