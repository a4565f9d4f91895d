"""Height to which a thrust lifts a mass: its slope is positive above the weight, zero below, ambiguous at it."""

from __future__ import annotations

import casadi as ca
import pytest

from dynamics.systems import Parameter, ParameterTable, signals, time_stepping
from ocp import InputError, solve
from ocp.problem.problem import Problem, Scaling

STEP, N, MASS, WEIGHT = 0.05, 8, 2.0, 20.0


def lifted(thrust: float) -> Problem:
    """Return a problem whose cost is the height after N steps under ``thrust`` [N], with the optimal input zero."""
    table = ParameterTable([Parameter("thrust", thrust, "N")])
    system = time_stepping(
        "lifted",
        states=signals("z [m]; v [m/s]"),
        inputs=signals("u [N]"),
        contacts=signals("floor [N s]"),
        h=STEP,
        mass=MASS,
        impulse=lambda q, v, u: STEP * (u + table["thrust"] - WEIGHT),
        distance=lambda q: q,
        parameters=table,
    )
    return Problem(
        "lifted",
        system,
        N,
        system.u**2,
        ca.SX(0),
        ca.SX([0, 0]),
        table,
        u_lower=-9,
        u_upper=9,
        scaling=Scaling(impulse=1, gap=0.1, u=5),
    )


@pytest.mark.costly_cases("18.0-False")
@pytest.mark.parametrize(("thrust", "lifts"), [(18.0, False), (23.0, True)])
def test_the_slope_of_the_height_is_that_of_the_free_flight_or_none(thrust: float, lifts: bool) -> None:
    """``z_N = h² N (N + 1) / (2 m) (F - m g)`` above the weight."""
    slope = STEP**2 * N * (N + 1) / (2 * MASS) if lifts else 0.0
    found = solve(lifted(thrust), effort="quick")
    assert found.data["x"].values[0, -1, 0] == pytest.approx(slope * (thrust - WEIGHT), rel=1e-5, abs=1e-7)
    sensitivity = found.sensitivity("thrust")
    assert float(sensitivity["x"][0, -1, 0]) == pytest.approx(slope, rel=1e-5, abs=1e-7)


def test_at_its_weight_there_is_no_slope() -> None:
    with pytest.raises(InputError):
        solve(lifted(WEIGHT), effort="quick").sensitivity("thrust")
