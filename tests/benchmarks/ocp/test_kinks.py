"""Named problems with ``|u|`` in their costs: ``pytest -m bench -s tests/benchmarks/ocp/test_kinks.py``."""

from __future__ import annotations

import time
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from ocp import Problem, solve
from problems import get

NAMES = ("wall-1d", "push-1d", "cart-walls", "hopper-1d", "box-slide")
WEIGHTS = (0.01, 0.1, 1.0)


def with_fuel(problem: Problem, weight: float) -> Problem:
    """Return the problem with ``weight`` times the mean of ``|u|``, in characteristic inputs and costs."""
    inputs = ca.sum1(ca.fabs(problem.system.u / ca.DM(problem.scales.u)))
    return replace(problem, stage_cost=problem.stage_cost + weight * problem.scales.cost / problem.N * inputs)


@pytest.mark.bench
@pytest.mark.parametrize("name", NAMES)
def test_least_fuel(name):
    for weight in WEIGHTS:
        problem, start = with_fuel(get(name), weight), time.process_time()
        solution = solve(problem, contact="exact", effort="quick")
        seconds = time.process_time() - start
        zeros = int((np.abs(solution.arrays["u"][0]) < 1e-6 * problem.scales.u).sum())
        certificate = solution.certificate.stationarity
        print(f"| `{name}` | {weight:g} | {solution.cost:.6g} | {certificate} | {zeros} | {seconds:.1f} |")
        assert solution.cost <= solution.idle_cost + 1e-9 * abs(solution.idle_cost)
