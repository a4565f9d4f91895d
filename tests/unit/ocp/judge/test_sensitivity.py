"""Sensitivities agree with differences of accurate solves, and are refused at points that have none."""

from __future__ import annotations

import functools
from typing import Any

import casadi as ca
import numpy as np
import pytest

from dynamics.contact import Barrier, ContactLaw, Exact
from dynamics.systems import Parameter, ParameterTable, lcs, signals, time_stepping
from ocp import Direct, InputError, MultipleShooting, Problem, SingleShooting, Solution, solve
from ocp.problem.problem import Scaling
from ocp.solve.solve import new_session
from ocp.solve.starts import solve_session
from problems import get
from tests.unit.ocp.continuation.test_tracking import R, between_walls, pressing

LAWS = {"exact": Exact(), "barrier": Barrier(mu=1e-3)}


@functools.cache
def solved(name: str, law: str) -> Solution:
    return solve(get(name), LAWS[law], Direct(), effort="quick")


def differences(name: str, law: ContactLaw, parameter: str, at: Solution) -> tuple[Any, ...]:
    """Return central differences of cost, x and u, with a step of a thousandth of the parameter's value."""
    value = at.values[parameter]
    h = 1e-3 * abs(value)
    there, back = (solve(get(name, **{parameter: value + s * h}), law, Direct(), warm_start=at) for s in (1, -1))
    return tuple(
        (a - b) / (2 * h)
        for a, b in (
            (there.cost, back.cost),
            (there.data["x"].values, back.data["x"].values),
            (there.data["u"].values, back.data["u"].values),
        )
    )


@pytest.mark.costly
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(
    ("name", "parameter"),
    [
        ("push-1d", "M"),
        ("push-1d", "qa0"),
        ("push-disc", "M"),
        ("cart-walls", "mp"),
        ("cart-walls", "u_max"),
        ("planar-push", "goal_x"),
    ],
)
def test_sensitivities_are_the_limit_of_re_solves(name: str, parameter: str, law: str) -> None:
    found = solved(name, law)
    ours = found.sensitivity(parameter)
    cost, x, u = differences(name, LAWS[law], parameter, found)
    assert float(ours["cost"]) == pytest.approx(cost, rel=2e-5, abs=1e-8)
    if (name, law) == ("push-1d", "exact"):
        # Where the pusher leaves the object it stays within 1e-4 m of it. The cost is flat there, so
        # that only the final state is known as accurately.
        assert ours["x"].values[0, -1, 0] == pytest.approx(x[0, -1, 0], rel=1e-4, abs=1e-6)
        return
    np.testing.assert_allclose(ours["x"].values, x, atol=1e-4 * max(np.abs(x).max(), 1e-3))
    np.testing.assert_allclose(ours["u"].values, u, atol=1e-4 * max(np.abs(u).max(), 1e-3))
    assert ours["x"].dims == found.data["x"].dims
    assert ours.attrs["parameter"] == parameter


@pytest.mark.costly
@pytest.mark.parametrize("method", [MultipleShooting(), SingleShooting()])
def test_shooting_has_the_sensitivity_of_direct(method) -> None:
    law = Barrier(mu=1e-3)
    ours = solve(get("push-1d"), law, method).sensitivity("M")
    direct = solved("push-1d", "barrier").sensitivity("M")
    for name in ("x", "u", "cost"):
        np.testing.assert_allclose(ours[name].values, direct[name].values, rtol=1e-5, atol=1e-7)


@pytest.mark.costly
def test_the_law_has_sensitivities_too() -> None:
    found = solved("push-1d", "barrier")
    costs = [solve(get("push-1d"), Barrier(mu=1e-3 * (1 + s)), Direct()).cost for s in (1e-3, -1e-3)]
    slope = (costs[0] - costs[1]) / 2e-6
    assert float(found.sensitivity("contact.mu")["cost"]) == pytest.approx(slope, rel=1e-5)


@pytest.mark.cheap_cases("0.5")
@pytest.mark.parametrize("theta", [-2.0, 0.5, 2.0])
def test_between_two_walls_it_is_the_closed_form(theta: float) -> None:
    """The solution is x+ = u = clip(theta / (1 + r), -1, 1), free or at rest against a wall."""
    problem = between_walls(lambda u, _: R * u**2, lambda x, theta: (x - theta) ** 2)
    ours = solve_at(problem, theta).sensitivity("theta")
    free = abs(theta) < 1 + R
    u = theta / (1 + R) if free else np.sign(theta)
    assert ours["u"].values.item() == pytest.approx(1 / (1 + R) if free else 0.0, abs=1e-9)
    assert ours["x"].values[0, 1, 0] == pytest.approx(1 / (1 + R) if free else 0.0, abs=1e-9)
    assert float(ours["cost"]) == pytest.approx(2 * (theta - u), abs=1e-8)


def solve_at(problem: Problem, theta: float) -> Solution:
    session = new_session(problem, Exact(), Direct())
    session.values["theta"] = theta
    return solve_session(session)


def test_a_wall_that_is_just_touched_has_none() -> None:
    problem = between_walls(lambda u, _: R * u**2, lambda x, theta: (x - theta) ** 2)
    with pytest.raises(InputError, match=r"not strict at 'contact1', step 0|not solved near"):
        solve_at(problem, 1 + R).sensitivity("theta")


def test_an_optimum_that_can_move_has_none() -> None:
    """Only the sum of the two inputs enters the cost, through the final state."""
    problem = between_walls(lambda u, _: 0 * u, lambda x, theta: (x - theta) ** 2, N=2)
    with pytest.raises(InputError, match="singular"):
        solve_at(problem, 0.3).sensitivity("theta")


def elastic(start: float, h: float = 0.005, steps: int = 400, weight: float = 1e6) -> Problem:
    """Return a problem of a ball that bounces off a stiff spring, ``0 <= lam ⟂ z+ + lam / k >= 0``, from v = -1.

    There is no gravity. At T = 2 ``z = T - z0 - pi / sqrt(k)``, so that the true slope by z0 is -1.
    """
    p = ParameterTable(
        [
            Parameter("z0", start, "m"),
            Parameter("k", 1e4, "N/m"),
            Parameter("h", h, "s"),
        ]
    )
    h_ = p["h"]
    A = ca.SX.eye(2)
    A[0, 1] = h_
    system = lcs(
        "elastic",
        states=signals("z [m]; v [m/s]"),
        inputs=signals("u [N]"),
        contacts=signals("floor [N]"),
        A=A,
        B=ca.vertcat(h_**2, h_),
        C=ca.vertcat(h_**2, h_),
        D=ca.horzcat(ca.SX(1), h_),
        E=ca.SX(h_**2),
        F=1 / p["k"] + h_**2,
        h=h_,
        parameters=p,
    )
    return Problem(
        name="elastic",
        system=system,
        N=steps,
        stage_cost=weight * system.u**2,
        terminal_cost=system.x[0],
        x0=ca.vertcat(p["z0"], -1),
        parameters=p,
        u_lower=-10,
        u_upper=10,
        scaling=Scaling(impulse=50, gap=0.01, u=1),
    )


def end_of_flight(start: float, h: float, steps: int, k: float = 1e4) -> float:
    z, v = start, -1.0
    for _ in range(steps):
        v += h * max(0.0, -(z + h * v) / (1 / k + h * h))
        z += h * v
    return z


@pytest.mark.costly
@pytest.mark.parametrize("start", [1.0015, 1.003])
def test_a_stiff_contacts_slope_is_told_beside_that_of_a_quarter_of_the_step(start: float) -> None:
    """The slope of the discrete map is 4.13 at h and -3.43 at h/4; the true slope is -1."""
    ours = solve(elastic(start), Exact(), Direct()).sensitivity("z0")
    slopes = [
        (end_of_flight(start + 1e-7, h, n) - end_of_flight(start - 1e-7, h, n)) / 2e-7
        for h, n in ((0.005, 400), (0.00125, 1600))
    ]
    assert slopes == pytest.approx([4.1296, -3.43], abs=5e-3)
    assert float(ours["cost"]) == pytest.approx(slopes[0], rel=1e-5)
    assert float(ours["cost_referee"]) == pytest.approx(slopes[0], rel=1e-5)
    assert float(ours["cost_refined"]) == pytest.approx(slopes[1], rel=1e-5)
    assert ours["x_refined"].values[0, -1, 0] == pytest.approx(slopes[1], rel=1e-5)
    words = ours.attrs["finding"]
    assert words.startswith("the sensitivity dcost/dz0 is 4.13, 4.13 in the replay, -3.4")
    assert words.endswith(
        " in the replay at h/4: right for the discrete map but not for the physics, since it depends on the step size"
    )


def falling(h: float = 0.1, N: int = 10) -> Problem:
    """Return a problem of a mass of 1 kg, pushed up from a floor with the force F against a weight of 10 N."""
    p = ParameterTable([Parameter("F", 10.5, "N"), Parameter("h", h, "s")])
    system = time_stepping(
        "lift-off",
        states=signals("z [m]; v [m/s]"),
        inputs=signals("u [N]"),
        mass=1.0,
        contacts=signals("floor [N s]"),
        h=p["h"],
        distance=lambda q: q,
        parameters=p,
        impulse=lambda q, v, u: p["h"] * (u + p["F"] - 10),
    )
    return Problem(
        name="lift-off",
        system=system,
        N=N,
        stage_cost=1e3 * system.u**2,
        x0=ca.SX.zeros(2),
        terminal_cost=system.x[0],
        parameters=p,
        u_lower=-20,
        u_upper=20,
        scaling=Scaling(impulse=1, gap=0.1, u=5),
    )


def test_a_slope_that_converges_with_the_step_is_confirmed() -> None:
    """``z_N = h² N (N + 1) / 2 (F - m g) / m`` has the slope 0.55 at h and 0.5125 at h/4."""
    ours = solve(falling(), Exact(), Direct(), effort="quick").sensitivity("F")
    assert ours["x"].values[0, -1, 0] == pytest.approx(0.55, rel=1e-4)
    assert ours["x_refined"].values[0, -1, 0] == pytest.approx(0.5125, rel=1e-4)
    assert float(ours["cost_refined"]) == pytest.approx(0.5125, rel=1e-3)
    assert "it depends on" not in ours.attrs["finding"]


def test_where_the_step_is_the_model_there_is_no_slope_at_a_quarter_of_it() -> None:
    ours = solved("push-1d", "exact").sensitivity("M")
    assert float(ours["cost_referee"]) == pytest.approx(float(ours["cost"]), rel=1e-5)
    assert np.isnan(float(ours["cost_refined"])) and np.isnan(ours["x_refined"].values).all()
    assert ours.attrs["refined_note"] == "the step size is part of the model"
    soft = solved("push-1d", "barrier").sensitivity("contact.mu")
    assert "in the replay: it depends on the law" in soft.attrs["finding"]


def test_what_is_no_parameter_or_no_solution_is_told() -> None:
    with pytest.raises(InputError, match=r"no parameter 'mass'.*there are"):
        solved("push-1d", "barrier").sensitivity("mass")
    found = solve(get("push-1d"), Barrier(mu=1e-3), Direct(), settings={"ipopt.max_iter": "1"})
    with pytest.raises(InputError, match="not solved"):
        found.sensitivity("M")


def test_pressed_against_a_wall_only_the_input_moves() -> None:
    """Pressed against the wall the cost c does not depend on theta, and u equals it."""
    ours = solve_at(pressing(1.0, size=10.0), 3.0).sensitivity("theta")
    assert ours["u"].values.item() == pytest.approx(1.0)
    assert float(ours["cost"]) == pytest.approx(0.0, abs=1e-9)
