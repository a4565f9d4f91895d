"""Rollouts with gradients on all cores against JAX on a graphics processor of the same computer.

``python -m tests.benchmarks.batch.graphics [N...]`` rewrites the site's table for batches of 2^N samples. JAX runs in
double precision in its fastest form: ``vmap`` over the whole batch, or blocks of it one after another, compiled, with
samples and results in the memory of the device.
"""

from __future__ import annotations

import os
import sys

import jax
import numpy as np

from docs.generator.measured import write_table
from tests.benchmarks.batch import jax_peer
from tests.benchmarks.batch.race import race
from tests.benchmarks.batch.test_batch_speed import CASES, jax_cost

COLUMNS = ("rollout", "samples", "C on all cores", "JAX on the graphics processor")
BLOCKS = (1 << 14, 1 << 17, 1 << 20)
"""Numbers of samples of a block on the graphics processor."""
NAMES = ("wall-1d", "four contacts")


def row(name: str, n: int) -> list[str | float]:
    """Return millions of rollouts with gradients a second of a case by each runner; costs agree to 1e-7."""
    case, cost = CASES[name](), jax_cost(name)
    theta = case.inputs(n)
    f = case.rollout(backend="c", threads=os.cpu_count())
    runners = {"ours": case.runner(f, theta)}
    sizes = sorted({min(block, n) for block in BLOCKS})
    runners |= {f"jax {size}": jax_peer.blocked(cost, theta, size) for size in sizes}
    expected = f(case.x0, theta).cost
    for key, run in runners.items():
        if key != "ours":
            np.testing.assert_allclose(np.asarray(run()[0]).ravel(), expected, rtol=1e-7)
    seconds = race(runners, rounds=5)
    for key, value in seconds.items():
        print(name, n, key, f"{n / value.wall / 1e6:.3g} M/s", flush=True)
    ours = seconds.pop("ours").wall
    rates = n / ours, n / min(value.wall for value in seconds.values())
    return [name, n, *(f"{rate / 1e6:.3g}" for rate in rates)]


def main() -> None:
    """Measure all cases, and write the table."""
    powers = [int(word) for word in sys.argv[1:]] or [10, 14, 17, 20]
    device = jax.devices("gpu")[0].device_kind
    write_table(
        "rollouts-on-graphics",
        title="Rollouts on a graphics processor",
        command="python -m tests.benchmarks.batch.graphics",
        columns=COLUMNS,
        rows=[row(name, 1 << power) for name in NAMES for power in powers],
        note=f"Millions of rollouts with gradients a second, by the clock, double precision; JAX {jax.__version__}"
        f" on {device}, samples and results in its memory, the fastest of several block sizes.",
    )


if __name__ == "__main__":
    main()
