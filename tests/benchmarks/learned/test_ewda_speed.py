"""Speed of the weighted average of 100,000 points, as ratios to alternatives."""

from __future__ import annotations

import numpy as np
import pytest

from dynamics.learned.ewda import EwdaModel
from dynamics.learned.transitions import Normalisation
from tests.benchmarks.batch.race import Row, race, tell
from tests.benchmarks.learned.ewda_peers import HAS_KEOPS, Average
from tests.unit.dynamics.learned.ewda_reference import origin

pytestmark = pytest.mark.bench
N, NZ, NY = 100_000, 11, 7
STEPS = 20
MANY, FEW = 10_000, 400
BLOCKS = (8, 80)
"""Queries per block: few, so that distances stay in the cache, and many, for large products."""


def data(nz: int, ny: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return points, half of them anywhere and half near a line, their targets, and a path along the line."""
    rng = np.random.default_rng(0)
    begin, end = rng.uniform(-1, 1, (2, nz))
    along = rng.uniform(0, 1, (N // 2, 1))
    tube = begin + along * (end - begin) + 0.2 * rng.standard_normal((N // 2, nz))
    z = rng.permutation(np.vstack((rng.uniform(-1.7, 1.7, (N - N // 2, nz)), tube)))
    y = z[:, :ny] + 0.1 * np.sin(z @ rng.standard_normal((nz, ny)))
    path = begin + np.linspace(0, 1, STEPS)[:, None] * (end - begin)
    return z, y, path + 0.1 * rng.standard_normal(path.shape)


def model(z: np.ndarray, y: np.ndarray, sigma: float, **options) -> EwdaModel:
    scales = Normalisation.from_rows(z, [f"z{k}" for k in range(z.shape[1])])
    return EwdaModel(z, y, scales, sigma, origin(z.shape[1], y.shape[1]), **options)


@pytest.mark.parametrize("sigma", [0.2, 1.0])
def test_value_and_jacobian_along_steps(sigma):
    z, y, path = data(NZ, NY)
    one, two = (model(z, y, sigma, threads=k) for k in (1, 2))
    peer = Average(one.scales.normalise(z), y, sigma)
    q = one.scales.normalise(path)
    forms = {
        "BLAS, all points": peer.blas(N),
        "BLAS, 8192 points at a time": peer.blas(8192),
        "BLAS, points that count": peer.blas_near(),
    }
    peers = {name: lambda f=f: [f(each) for each in q] for name, f in forms.items()}
    peers["JAX"] = peer.jax_along(q)
    ours = {
        name: lambda m=m: [m.jacobians(path[i : i + 1]) for i in range(STEPS)]
        for name, m in (("one", one), ("two", two))
    }
    got = one.jacobians(path)
    for run in peers.values():
        answers = run()
        values, slopes = answers if isinstance(answers, tuple) else zip(*answers, strict=True)
        np.testing.assert_allclose(got[0][:, :-1], np.array(values), rtol=1e-9, atol=1e-9)
        slopes = np.array(slopes) / one.scales.scale
        np.testing.assert_allclose(got[1][:, :-1], slopes, rtol=0, atol=1e-8)
    seconds = race({**peers, **ours}, rounds=15)
    best = min(peers, key=lambda name: seconds[name].wall)
    rows = [Row(name, 1e3 * seconds[name].wall, " ms") for name in peers]
    rows += [Row(f"C, {name}", 1e3 * seconds[name].wall, " ms") for name in ours]
    fast = min(seconds[name].wall for name in ours)
    rows.append(Row(f"best of the others ({best}) / C", seconds[best].wall / fast, "x", 3.0))
    alone = min(seconds[name].processor for name in peers) / seconds["one"].processor
    rows.append(Row("the same in time of all processors, C on one thread", alone, "x"))
    tell(f"value and Jacobian, {STEPS} steps over {N:,} points, sigma = {sigma}", rows)


@pytest.mark.parametrize(("sigma", "least"), [(0.2, 2.0), (1.0, 1.0)])
def test_many_queries_at_once(sigma, least):
    """The others' time per query does not depend on the number, so that they get fewer queries."""
    z, y, _ = data(NZ, NY)
    rng = np.random.default_rng(1)
    ours = model(z, y, sigma, threads=2)
    at = z[rng.integers(N, size=MANY)] + 0.1 * rng.standard_normal((MANY, NZ))
    peer, q = Average(ours.scales.normalise(z), y, sigma), ours.scales.normalise(at[:FEW])
    peers = {f"BLAS, blocks of {block}": peer.blas_blocks(q, block) for block in BLOCKS}
    peers |= {f"JAX, blocks of {block}": peer.jax_blocks(q, block) for block in BLOCKS}
    if HAS_KEOPS:
        peers["PyKeOps"] = peer.keops(q)
    else:
        print("PyKeOps is not installed here: not compared")
    got = ours.values(at)[:FEW, :-1]
    for run in peers.values():
        np.testing.assert_allclose(got, run(), rtol=1e-9, atol=1e-9)
    seconds = race({**peers, "ours": lambda: ours.values(at)}, rounds=3)
    best = min(peers, key=lambda name: seconds[name].wall)
    per_query = {name: 1e6 * seconds[name].wall / FEW for name in peers}
    fast = 1e6 * seconds["ours"].wall / MANY
    rows = [Row(f"{name}: a query", each, " us") for name, each in per_query.items()]
    rows.append(Row("C, two threads: a query", fast, " us"))
    rows.append(Row(f"best of the others ({best}) / C", per_query[best] / fast, "x", least))
    tell(f"values, {MANY:,} queries against {N:,} points, sigma = {sigma}", rows)


@pytest.mark.parametrize("sigma", [0.2, 1.0])
def test_all_stages_of_a_program(sigma):
    """One iteration of a transcription of planar-push at N = 20 evaluates the model this often."""
    z, y, path = data(7, 5)
    push = model(z, y, sigma)
    weights = np.random.default_rng(2).standard_normal((STEPS, 6))
    stages = {
        "value": lambda: push.values(path),
        "value, Jacobian": lambda: push.jacobians(path),
        "curvature": lambda: push.curvatures(path, weights),
        "all": lambda: (push.jacobians(path), push.curvatures(path, weights)),
    }
    seconds = race(stages, rounds=15)
    rows = [Row(name, 1e3 * seconds[name].wall, " ms") for name in stages if name != "all"]
    rows.append(Row("value, Jacobian and curvature", 1e3 * seconds["all"].wall, " ms", most=50.0))
    tell(f"all {STEPS} stages at {N:,} points, sigma = {sigma}", rows)
