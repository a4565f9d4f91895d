"""Ten drawn scenes by the default command: ``python -m tests.benchmarks.ocp.world [WORD ...]``.

Prints cost, cost of standing still, seconds, certificate and the referee's word of each scene whose
name has one of the words. A scene that takes longer than :data:`LIMIT` is not waited for.
"""

from __future__ import annotations

import multiprocessing as mp
import sys
import time
import warnings
from typing import Any

from ocp import solve
from tests.benchmarks.ocp.world_scenes import SCENES

LIMIT = 180
HEAD = f"{'scene':<22}{'cost':>9}{'idle':>9}{'s':>7}  {'certificate':<12}referee"


def measured(name: str) -> tuple[Any, ...]:
    """Cost, idle cost, seconds, certificate and the referee's word of one scene."""
    warnings.simplefilter("ignore")
    began = time.perf_counter()
    found = solve(SCENES[name](), contact="exact")
    seconds = time.perf_counter() - began
    kind = found.certificate.stationarity if found.certificate.certified else "none"
    return found.cost, found.idle_cost, seconds, kind, found.referee.word


def main(words: list[str]) -> None:
    """Print the table."""
    print(HEAD)
    good, chosen = 0, [n for n in SCENES if not words or any(word in n for word in words)]
    for name in chosen:
        with mp.get_context("spawn").Pool(1) as pool:
            try:
                cost, idle, seconds, kind, word = pool.apply_async(measured, (name,)).get(LIMIT)
            except mp.TimeoutError:
                print(f"{name:<22}{'':>9}{'':>9}{'>' + str(LIMIT):>7}", flush=True)
                continue
        good += kind != "none" and word == "survives" and seconds <= 60
        print(f"{name:<22}{cost:>9.4f}{idle:>9.4f}{seconds:>7.1f}  {kind:<12}{word}", flush=True)
    print(f"{good} of {len(chosen)} certified and surviving within 60 s")


if __name__ == "__main__":
    main(sys.argv[1:])
