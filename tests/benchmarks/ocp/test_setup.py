"""Time of the set-up, from the problem's parameters to a solver that is ready to start."""

from __future__ import annotations

import math

import pytest

from dynamics.contact import Barrier
from ocp.programs.solver import Solver
from tests.benchmarks.ocp.cases import FIVE, LCS, session
from tests.benchmarks.ocp.race import alternate, ms, tell

HORIZONS = (125, 250, 500, 1000)
LIMIT = 0.2


def set_up(name: str, N: int) -> None:
    """Build problem, closed step, NLP with its derivatives, initial guess and solver instance."""
    made = session(name, Barrier(mu=1e-3), N)
    nlp = made.nlp_of("product")
    made.first_point(nlp)
    Solver()._solver_function(nlp, {})  # private, since timing must stop before IPOPT starts


@pytest.mark.bench
def test_set_up_is_quick_and_linear_in_the_horizon() -> None:
    """It takes less than 0.2 s at N = 1000, and from 250 to 1000 grows by at most 4, the ratio of N."""
    rows, slow, steep = [], [], []
    for name in (*FIVE, LCS):
        runs = {str(N): lambda n=name, k=N: set_up(n, k) for N in HORIZONS}
        seconds, _ = alternate(runs, 5)
        power = math.log(seconds["1000"] / seconds["250"]) / math.log(4)
        rows.append([name, *(ms(seconds[str(N)]) for N in HORIZONS), f"{power:.2f}"])
        slow += [(name, seconds["1000"])] if seconds["1000"] >= LIMIT else []
        steep += [(name, power)] if power > 1.1 else []
    columns = ["problem", *(f"N = {N}" for N in HORIZONS), "power of N"]
    tell("Set-up, milliseconds", columns, rows)
    assert not slow
    assert not steep
