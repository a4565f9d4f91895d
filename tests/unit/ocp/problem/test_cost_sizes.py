"""Lower bounds of costs, and parameters that are weights of a cost."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from dynamics.systems import Parameter, ParameterTable, lcs
from ocp.problem.cost_sizes import cost_weights, least_value
from ocp.problem.problem import Problem, Scaling

X = ca.SX.sym("x", 2)
x, y = X[0], X[1]
BOUNDED = {
    "square": (3 * x**2 + 2, 2.0),
    "square of a positive value": ((x**2 + 3) ** 2, 9.0),
    "fourth power": ((1 + y**2) ** 4, 1.0),
    "sixth power": ((x - 2) ** 6, 0.0),
    "sixth power of a positive value": ((y**2 + 1.5) ** 6, 1.5**6),
    "high power": ((x - 2) ** 102, 0.0),
    "high power of a positive value": ((y**2 + 1.05) ** 102, 1.05**102),
    "even negative power": (x**-102, 0.0),
    "absolute value": (ca.fabs(x) + ca.fabs(y - 1) / 4, 0.0),
    "root": (ca.sqrt(x**2 + 16), 4.0),
    "cosh": (ca.cosh(x**2 + 1), np.cosh(1.0)),
    "exponential": (ca.exp(x**2 + y**2), 1.0),
    "exponential of any sign": (ca.exp(x), 0.0),
    "twice": ((x**2 + 3) + (x**2 + 3), 6.0),
    "logarithm": (ca.log(x**2 + 4), np.log(4.0)),
    "logarithm below one": (ca.log(x**2 + 0.5), np.log(0.5)),
    "product": ((x**2 + 2) * (y**2 + 3), 6.0),
    "product of unequal signs": ((x**2 + 2) * (y**2 - 3), -np.inf),
    "product of negative bounds": ((x**2 - 2) * (y**2 - 3), -np.inf),
    "quotient by a number": ((x**2 + 6) / 3, 2.0),
    "quotient": ((x**2 + 6) / (y**2 + 3), 0.0),
    "quotient by any sign": ((x**2 + 6) / y, -np.inf),
    "constant": (ca.SX(-3), -3.0),
    "symbol": (x, -np.inf),
    "difference": (x**2 - y**2, -np.inf),
    "odd power": ((x - 1) ** 3, -np.inf),
    "logarithm without bound": (ca.log(x**2), -np.inf),
    "logarithm of any sign": (ca.log(x), -np.inf),
}


@pytest.mark.parametrize("name", BOUNDED)
def test_lower_bounds_are_those_of_interval_arithmetic(name: str) -> None:
    """The bound is below all samples, and is the infimum of these functions where it is finite."""
    expression, bound = BOUNDED[name]
    assert least_value(expression) == pytest.approx(bound)
    positive = np.append(np.geomspace(1e-9, 300, 40), [1.0, 2.0])
    sides = np.concatenate([-positive, positive])
    samples = np.array(ca.Function("value", [X], [expression])(np.stack(np.meshgrid(sides, sides)).reshape(2, -1)))
    assert np.nanmin(samples) >= bound - 1e-9
    if np.isfinite(bound):
        assert np.nanmin(samples) == pytest.approx(bound, abs=2e-2)
    else:
        assert name == "product of unequal signs" or np.nanmin(samples) < -0.1


def weighted(cost) -> Problem:
    """Return a problem whose stage cost is ``cost(x, u, parameters)`` with the parameters w, m and goal."""
    p = ParameterTable([Parameter("w", 2.0), Parameter("m", 1.0), Parameter("goal", 0.5)])
    one = np.ones((1, 1))
    system = lcs("weighted", A=1.0, B=1 / p["m"], C=one, D=one, E=one, F=one, parameters=p)
    stage = cost(system.x, system.u, p)
    return Problem(
        "weighted", system, 3, stage, p["goal"] ** 2 * system.x, ca.SX([1.0]), p, scaling=Scaling(1, 1, 1, 1)
    )


def test_weights_are_the_parameters_in_which_the_cost_alone_is_linear() -> None:
    """Here m is in the dynamics too, and goal enters the terminal cost squared."""
    assert cost_weights(weighted(lambda x, u, p: p["w"] * u**2 + p["m"] * x**2)) == {"w"}
    assert cost_weights(weighted(lambda x, u, p: p["w"] ** 2 * u**2)) == set(), "not linear"
    assert cost_weights(weighted(lambda x, u, p: u**2)) == set(), "not in the cost"
    both = weighted(lambda x, u, p: p["w"] * u**2)
    assert cost_weights(replace(both, u_upper=both.parameters["w"] * 3)) == set(), "a bound too"
