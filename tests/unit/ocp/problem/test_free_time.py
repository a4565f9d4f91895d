"""Free final time: minimum-time motions in closed form, under every method that supports it."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from dynamics.contact import Barrier, ContactLaw, Exact
from dynamics.systems import Parameter, ParameterTable, signals, time_stepping
from ocp import (
    Constraint,
    Direct,
    InputError,
    MultipleShooting,
    Problem,
    SingleShooting,
    free,
    solve,
)
from ocp.problem.free_time import FreeStep
from problems import get
from tests.unit.ocp.user_problems import defaults

N, GOAL, FORCE, MASS = 10, 0.9, 3.0, 2.0


def dash(h: FreeStep | None, wall: float = 9.0, **more: object) -> Problem:
    """Return the problem of moving a mass from rest at 0 to GOAL in minimum time, with a wall at ``wall``."""
    p = ParameterTable([Parameter("h", 0.1, "s"), Parameter("m", MASS, "kg")])
    system = time_stepping(
        "dash",
        states=signals("x [m]; v [m/s]"),
        inputs=signals("u [N]"),
        contacts=signals("wall [N s]"),
        h=p["h"],
        mass=p["m"],
        parameters=p,
        impulse=lambda q, v, u: p["h"] * u,
        distance=lambda q: wall - q,
    )
    given = {
        "terminal": [Constraint("there", system.x[0] - GOAL, 0, 0)],
        "u_lower": -FORCE,
        "u_upper": FORCE,
        "stage_cost": 0,
        "terminal_cost": N * p["h"],
        "x0": [0, 0],
    }
    return Problem("dash", system, N, parameters=p, h=h, **given | more)  # pyright: ignore


def at_rest() -> Problem:
    plain = dash(None)
    rows = [*plain.terminal, Constraint("rest", plain.system.x[1], 0, 0)]
    return replace(plain, terminal=rows, h=free(0.01, 1.0))


@pytest.mark.cheap_cases("multiple-shooting")
@pytest.mark.parametrize("method", [Direct(), MultipleShooting()], ids=lambda one: one.name)
def test_the_least_time_to_rest_is_that_of_bang_bang(method: Direct) -> None:
    """n steps of a = F/m and n steps of -a reach ``d = a h² n²``, so that T = 2 n h = 2 sqrt(d / a)."""
    found = solve(at_rest(), Exact(), method)
    least = 2 * np.sqrt(GOAL * MASS / FORCE)
    assert found.cost == pytest.approx(least, rel=1e-6)
    h = found.data["x"].values[0, :, -1]
    assert h == pytest.approx(least / N, rel=1e-6)
    assert float(found.data["time"][-1]) == pytest.approx(least, rel=1e-6)
    assert found.certificate.stationarity == "B"


@pytest.mark.cheap_cases("law1-9.0")
@pytest.mark.parametrize(("law", "wall"), [(Exact(), GOAL), (Exact(), 9.0), (Barrier(1e-7), 9.0)])
def test_the_least_time_without_brakes(law: ContactLaw, wall: float) -> None:
    """Full force throughout, with or without a wall at the goal, gives ``a h² N (N + 1) / 2 = d``."""
    found = solve(dash(free(0.01, 1.0), wall=wall), law)
    least = N * np.sqrt(2 * GOAL * MASS / FORCE / (N * (N + 1)))
    assert found.cost == pytest.approx(least, rel=1e-6)
    assert found.referee.cost == pytest.approx(found.cost, rel=1e-6)


def test_bounds_of_the_step_size_hold() -> None:
    found = solve(dash(free(0.12, 1.0)), Exact())
    assert found.cost == pytest.approx(N * 0.12, rel=1e-7)


def test_the_most_exact_contact_model_has_the_same_free_step() -> None:
    plain = get("push-disc")
    freed = replace(plain, h=free(0.05, 0.2))
    sharp = freed.system.most_exact
    assert freed.system.referee_note == plain.system.referee_note
    assert ca.is_equal(sharp.x, freed.system.x, 3)
    x = np.append(np.array(plain.limits(plain.parameters.values)[0]).ravel(), 0.1)
    u, values = np.array([-0.2, 0.3]), list(defaults(plain).values())
    for of_plain, of_freed in ((plain.exact_step, freed.exact_step), (plain.referee_step, freed.referee_step)):
        there = np.array(of_freed.solve(x, u, values)[0]).ravel()
        assert there[:-1] == pytest.approx(np.array(of_plain.solve(x[:-1], u, values)[0]).ravel())
        assert there[-1] == 0.1


def test_a_step_size_that_is_no_parameter_is_refused() -> None:
    with pytest.raises(InputError, match="that of the system is not a parameter"):
        replace(dash(free(0.01, 1.0)), h=free(0.01, 1.0))


@pytest.mark.parametrize("ends", [(0.0, 1.0), (0.2, 0.1), (-1, 1), (np.nan, 1.0)])
def test_bounds_out_of_order_are_refused(ends: tuple[float, float]) -> None:
    with pytest.raises(InputError, match="needs 0 < lower <= upper"):
        free(*ends)


def test_a_bound_in_the_step_size_is_refused() -> None:
    plain = dash(None)
    with pytest.raises(InputError, match="u_upper depends on the step size, which is free"):
        replace(plain, u_upper=plain.parameters["h"] * 5, h=free(0.01, 1.0))


def test_single_shooting_names_what_can_choose_it() -> None:
    with pytest.raises(InputError, match="use method direct or multiple-shooting"):
        solve(dash(free(0.01, 1.0)), Exact(), SingleShooting())
