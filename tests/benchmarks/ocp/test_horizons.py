"""Processor time per step of a solve with its verification, as the horizon grows."""

from __future__ import annotations

import time
from dataclasses import dataclass

import pytest

from docs.generator.measured import write_table
from dynamics.contact import Barrier, ContactLaw, Exact
from ocp.solve.judging import judge_outcome
from ocp.solve.solve import new_session
from problems import get
from tests.benchmarks.ocp.race import tell

LAWS: dict[str, ContactLaw] = {"exact": Exact(), "barrier": Barrier(mu=1e-3)}
LENGTHS = {"exact": (24, 50, 100, 200), "barrier": (20, 100, 400, 1000)}
EXACT = ("push-1d", "push-disc", "ball-bounce", "cart-walls", "box-slide", "hopper-1d", "planar-push")
RUNS = [*((name, "exact") for name in EXACT), ("push-disc", "barrier"), ("half-cheetah", "exact"), ("hopper", "exact")]
GROWTH = 2.0
"""Largest ratio of the time per step to that at the shortest horizon."""
MISSED = {"hopper"}
"""Cases that are known to miss the floor: at N = 50 to 200 relaxations take hundreds of iterations,
at N = 24 tens."""
LIMIT_S = 400.0
"""Limit [s] on the wall time of one run of IPOPT."""


@dataclass(frozen=True)
class Measured:
    """Measurements of one solve: processor time per step [s], iterations, and status."""

    step_s: float
    iterations: int
    status: str


def measured(name: str, law: ContactLaw, steps: int) -> Measured:
    """Set up, solve and verify a problem with a number of steps."""
    began = time.process_time()
    session = new_session(get(name, N=steps), law)
    session.solver.options["max_wall_time"] = LIMIT_S
    found = judge_outcome(session, session.solve(), 0)
    took = time.process_time() - began
    return Measured(took / steps, found.iterations, found.status.label)


@pytest.mark.bench
def test_time_of_a_step_hardly_grows_with_the_horizon() -> None:
    """Imports and caches of the process are ready before the first measurement."""
    measured("push-1d", Exact(), 8)
    title = "Time of a step over the horizon: set-up, solve, certificate and referee"
    columns = ["problem", "law", "N", "ms of processor a step", "ratio", "iterations", "status"]
    rows, missed = [], set()
    for name, law in RUNS:
        lengths = LENGTHS[law]
        found = [measured(name, LAWS[law], N) for N in lengths]
        ratios = [one.step_s / found[0].step_s for one in found]
        rows.append(
            [
                name,
                law,
                " / ".join(map(str, lengths)),
                " / ".join(f"{1e3 * one.step_s:.3g}" for one in found),
                " / ".join(f"{ratio:.2f}" for ratio in ratios),
                " / ".join(str(one.iterations) for one in found),
                " / ".join(dict.fromkeys(one.status for one in found)),
            ]
        )
        missed |= {name} if max(ratios) > GROWTH else set()
        # The table is printed after every row, since the last ones take minutes.
        write_table(
            "horizons",
            title=title,
            columns=columns,
            rows=rows,
            command="pytest -m bench -s tests/benchmarks/ocp/test_horizons.py",
            note=f"Floor: a ratio of {GROWTH:g} at most.",
        )
    tell(title, columns, rows)
    assert missed <= MISSED
