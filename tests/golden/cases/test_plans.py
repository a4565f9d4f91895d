"""Plans of the kind that users ask about: small units, constants, and hard terminal constraints."""

from __future__ import annotations

import re
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import minimize

from dynamics.systems import (
    Link,
    Machine,
    Parameter,
    ParameterTable,
    Sphere,
    signals,
    time_stepping,
)
from ocp import Constraint, Solution, Status, free, solve
from ocp.problem.problem import Problem, Scaling
from tests.findings import codes

TABLE = ParameterTable([Parameter("h", 0.1, "s")])


def braked(gap_unit: float = 1.0, offset: float = 0.0, **more) -> Problem:
    """Return a problem of a mass at 2.5 m/s, 0.9 m before a wall, with a brake of 0.1 N s per step."""
    system = time_stepping(
        "braked",
        states=signals("x [m]; v [m/s]"),
        inputs=signals("J [N s]"),
        contacts=signals("wall [N s]"),
        h=TABLE["h"],
        mass=1.0,
        impulse=lambda q, v, u: u,
        distance=lambda q: q / gap_unit,
        parameters=TABLE,
    )
    x, v = system.x[0], system.x[1]
    given = {
        "stage_cost": 0.1 * system.u**2,
        "terminal_cost": 10 * (x - 0.25) ** 2 + 10 * v**2 + offset,
        "u_lower": -0.1,
        "u_upper": 0.1,
        "scaling": Scaling(impulse=1.0, gap=0.1),
    }
    return Problem("braked", system, 20, x0=ca.SX([0.9, -2.5]), parameters=TABLE, **given | more)


def best_of_all_windows() -> float:
    """Return the cost of the best plan of :func:`braked`, over all first and last steps of contact.

    Between them the mass rests at the wall; before and after it moves freely. Each window gives a
    convex program in the inputs, which are zero during the rest.
    """
    h, N = 0.1, 20

    def roll(u: np.ndarray, first: int, last: int) -> tuple[float, float, float]:
        x, v, lowest = 0.9, -2.5, np.inf
        for k in range(N):
            v += u[k]
            if first <= k <= last:
                # The wall stops it at x = 0 at the end of the step, and cannot pull.
                lowest = min(lowest, -(x + h * v))
                v = -x / h
            x += h * v
            if not first <= k <= last:
                lowest = min(lowest, x)
        return x, v, lowest

    def cost(u: np.ndarray, first: int, last: int) -> float:
        x, v, _ = roll(u, first, last)
        return 0.1 * float(u @ u) + 10 * (x - 0.25) ** 2 + 10 * v**2

    least = np.inf
    for first in range(1, 8):
        for last in range(first + 1, N):
            found = minimize(
                cost,
                np.zeros(N),
                (first, last),
                bounds=[(-0.1, 0.1)] * N,
                constraints={
                    "type": "ineq",
                    "fun": lambda u, *window: roll(u, *window)[2],
                    "args": (first, last),
                },
                method="SLSQP",
                options={"ftol": 1e-12},
            )
            if roll(found.x, first, last)[2] > -1e-7:
                least = min(least, found.fun)
    return least


@pytest.mark.slow
def test_the_braked_mass_is_the_best_of_all_windows() -> None:
    assert solve(braked(), effort="quick").cost == pytest.approx(best_of_all_windows(), rel=1e-4)


@pytest.mark.cheap_cases("1e-06")
@pytest.mark.parametrize("unit", [1e-9, 1e-6, 1e3])
def test_a_gap_in_another_unit_is_the_same_gap(unit: float) -> None:
    known, found = (solve(problem, effort="quick") for problem in (braked(), braked(unit)))
    assert known.success and found.success
    assert found.cost == pytest.approx(known.cost, rel=1e-4, abs=1e-7)
    assert found.referee.survives == known.referee.survives


def verdict_words(found: Solution) -> list[str]:
    """Return the verdict without numbers, which depend on the constant."""
    return [found.status.label, found.grade, re.sub(r"-?\d[\d.e+-]*", "#", found.verdict)]


@pytest.mark.costly_cases("-1000000.0")
@pytest.mark.parametrize("offset", [1e6, -1e6])
def test_a_large_constant_does_not_make_standing_still_the_best(offset: float) -> None:
    """Sliding into the wall without the brake costs 0.2 more."""
    found = solve(braked(offset=offset))
    assert found.idle_cost - found.cost > 0.1
    assert "standing-still" not in codes(found)
    assert verdict_words(found) == verdict_words(solve(braked()))


def tipped(offset: float) -> Problem:
    """Return a problem of a wheel with an arm that can push on the ground and lift it."""
    machine = Machine(
        links=(
            Link("hub", None, mass=0.9, inertia=0.08, joint="free"),
            Link("arm", "hub", mass=0.25, inertia=0.01, com=(0.15, 0), gear=4.0),
        ),
        spheres=(Sphere("wheel", "hub", (0, 0), 0.12), Sphere("tip", "arm", (0.35, 0), 0.04)),
    )
    system = machine.system("tipped", TABLE, h=TABLE["h"], friction=0.6)
    x = system.x
    return Problem(
        "tipped",
        system,
        8,
        0.01 * ca.sumsqr(system.u),
        80 * (x[0] - 0.2) ** 2 + ca.sumsqr(x[4:]) + offset,
        ca.SX([0, 0.12, 0, 0, 0, 0, 0, 0]),
        TABLE,
        u_lower=-1,
        u_upper=1,
        scaling=Scaling(impulse=0.5, gap=0.1),
    )


@pytest.mark.slow
@pytest.mark.parametrize("offset", [20.0, -300.0])
def test_a_constant_changes_no_word_on_a_machine(offset: float) -> None:
    plain, moved = solve(tipped(0.0)), solve(tipped(offset))
    assert np.array_equal(plain.data["u"].values, moved.data["u"].values)
    assert verdict_words(plain) == verdict_words(moved)


@pytest.mark.cheap_cases("1e-09")
@pytest.mark.parametrize("unit", [1e-12, 1e-9, 1.0, 1e6])
def test_rows_that_contradict_each_other_are_infeasible_in_any_unit(unit: float) -> None:
    plain = braked(u_lower=-1, u_upper=1)
    x = plain.system.x[0]
    rows = [
        Constraint("here", unit * x, unit * 0.2, unit * 0.2),
        Constraint("there", unit * x, unit * 0.3, unit * 0.3),
    ]
    found = solve(replace(plain, terminal=rows), effort="quick")
    assert not found.success
    assert "ot converged" in found.verdict or "ot solved" in found.verdict


@pytest.mark.costly
@pytest.mark.parametrize(("goal", "reached"), [(0.8, True), (1.0, True), (1.15, False)])
def test_a_goal_behind_a_wall_is_not_reached(goal: float, reached: bool) -> None:
    system = time_stepping(
        "fenced",
        states=signals("x [m]; v [m/s]"),
        inputs=signals("F [N]"),
        contacts=signals("fence [N s]"),
        h=TABLE["h"],
        mass=1.0,
        impulse=lambda q, v, u: TABLE["h"] * u,
        distance=lambda q: 1.0 - q,
        parameters=TABLE,
    )
    end = [Constraint("goal", system.x[0] - goal, 0, 0)]
    found = solve(
        Problem(
            "fenced",
            system,
            12,
            0.01 * system.u**2,
            ca.SX(0),
            ca.SX([0, 0]),
            TABLE,
            u_lower=-20,
            u_upper=20,
            terminal=end,
        )
    )
    assert found.success == reached
    assert reached or found.status is Status.INFEASIBLE


@pytest.mark.costly_cases("12-1.6-3.0-5.0")
@pytest.mark.parametrize(("N", "way", "mass", "force"), [(2, 0.7, 1.0, 2.0), (12, 1.6, 3.0, 5.0)])
def test_the_shortest_time_to_rest_at_a_wall_is_the_closed_form(N: int, way: float, mass: float, force: float) -> None:
    """The plan has full force throughout, and the wall stops the mass in the last step.

    In N - 1 steps of semi-implicit Euler the distance is ``a h² (N - 1) N / 2``, so that
    ``N h = sqrt(2 d N / (a (N - 1)))``.
    """
    system = time_stepping(
        "dash",
        states=signals("x [m]; v [m/s]"),
        inputs=signals("F [N]"),
        contacts=signals("wall [N s]"),
        h=TABLE["h"],
        mass=mass,
        impulse=lambda q, v, u: TABLE["h"] * u,
        distance=lambda q: way - q,
        parameters=TABLE,
    )
    x, v = system.x[0], system.x[1]
    found = solve(
        Problem(
            "dash",
            system,
            N,
            ca.SX(0),
            N * TABLE["h"],
            ca.SX([0, 0]),
            TABLE,
            u_lower=-force,
            u_upper=force,
            terminal=[Constraint("there", x - way, 0, 0), Constraint("rest", v, 0, 0)],
            h=free(0.001, 3.0),
        )
    )
    assert found.success
    assert found.cost == pytest.approx(np.sqrt(2 * way * N * mass / (force * (N - 1))), rel=1e-6)
