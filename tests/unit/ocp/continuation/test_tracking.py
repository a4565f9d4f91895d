"""Events of continuation on small problems with closed forms: contacts, folds, switches."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from dynamics.contact import Exact
from dynamics.systems import Parameter, ParameterTable, lcs
from ocp import Direct
from ocp.continuation import Continuation, continue_over
from ocp.continuation.events import describe_events
from ocp.problem.problem import Problem, Scaling
from ocp.solve.solve import new_session

R = 0.5


def between_walls(stage, terminal, walls: float = 1.0, size: float = 1.0, N: int = 1) -> Problem:
    """Return a problem of ``N`` steps ``x+ = x + u + left - right`` from 0 between walls at -1 and 1.

    ``stage`` is a cost of (u, theta), ``terminal`` one of the last x and theta.
    """
    p = ParameterTable([Parameter("theta", 0.0)])
    F = [[1.0, -1.0], [-1.0, 1.0]]
    system = lcs(
        "between-walls",
        A=1.0,
        B=1.0,
        C=[[1.0, -1.0]],
        D=[[1.0], [-1.0]],
        E=[[1.0], [-1.0]],
        F=F,
        d=[walls, walls],
        parameters=p,
    )
    return Problem(
        name="between-walls",
        system=system,
        N=N,
        stage_cost=stage(system.u, p["theta"]),
        terminal_cost=terminal(system.x, p["theta"]),
        x0=ca.SX.zeros(1),
        parameters=p,
        scaling=Scaling(size, size, size, size),
    )


def follow(problem: Problem, start: float, end: float, steps: int) -> Continuation:
    return continue_over(new_session(problem, Exact(), Direct()), "theta", start, end, steps)


@pytest.mark.costly
def test_contacts_of_a_mass_between_two_walls_are_found_where_they_change() -> None:
    """The minimum of r u² + (x+ - theta)² is at x+ = u = clip(theta / (1 + r), -1, 1), without force of a wall."""
    problem = between_walls(lambda u, _: R * u**2, lambda x, theta: (x - theta) ** 2)
    path = follow(problem, -3.0, 3.0, 7)
    assert path.break_reason is None
    assert [event.kind for event in path.events] == ["contact", "contact"]
    for event, value in zip(path.events, (-(1 + R), 1 + R), strict=True):
        assert event.value == pytest.approx(value, abs=6e-6)
        assert event.cost == pytest.approx(R + R**2, rel=1e-5)
        assert event.steps == (0,)
    assert [(event.contact, event.change) for event in path.events] == [("contact0", "opens"), ("contact1", "touches")]
    for point in path.points:
        u = np.clip(point.value / (1 + R), -1, 1)
        assert point.solution.cost == pytest.approx(R * u**2 + (u - point.value) ** 2, rel=1e-9)


@pytest.mark.costly
@pytest.mark.parametrize("walls", [(1.0, 1.0), (1.0, 1.2)])
def test_contacts_that_change_at_one_value_are_one_degenerate_event(walls) -> None:
    """Two masses with one wall each touch it at theta = wall (1 + r)."""
    p = ParameterTable([Parameter("theta", 0.0)])
    one = np.eye(2)
    system = lcs("two-walls", A=one, B=one, C=-one, D=-one, E=-one, F=one, d=list(walls), parameters=p)
    problem = Problem(
        name="two-walls",
        system=system,
        N=1,
        stage_cost=R * ca.sumsqr(system.u),
        terminal_cost=ca.sumsqr(system.x - p["theta"]),
        x0=ca.SX.zeros(2),
        parameters=p,
        scaling=Scaling(1.0, 1.0, 1.0, 1.0),
    )
    path = follow(problem, 0.2, 3.1, 7)
    at_once = walls[0] == walls[1]
    assert [e.kind for e in path.events] == (["degenerate"] if at_once else ["contact"] * 2)
    wanted = [(1 + R) * wall for wall in dict.fromkeys(walls)]
    assert [e.value for e in path.events] == pytest.approx(wanted, abs=3e-6)
    if at_once:
        assert describe_events(path.events, "theta") == (
            "1 degenerate event: several pairs change at once (theta = 1.5)"
        )
    else:
        assert [e.contact for e in path.events] == ["contact0", "contact1"]


def pressing(c: float, size: float = 1.0) -> Problem:
    """Return ``min (u - theta)² + c x+²`` between walls, with two local minima for 1 < theta < 1 + c.

    In free flight x+ = u = theta / (1 + c); pressed against the wall u = theta at the cost c. Both
    cost the same at theta² = 1 + c.
    """
    return between_walls(lambda u, theta: (u - theta) ** 2, lambda x, _: c * x**2, size=size)


@pytest.mark.costly
def test_a_minimum_that_ends_at_a_contact_is_left_there() -> None:
    c = 40.0
    path = follow(pressing(c), 30.0, 0.2, 10)
    assert path.break_reason is None
    assert [event.kind for event in path.events] == ["contact", "switch"]
    ends, switch = path.events
    assert (ends.contact, ends.change) == ("contact1", "comes to rest")
    assert ends.value == pytest.approx(1.0, abs=3e-7)
    assert ends.cost == pytest.approx(c)
    assert switch.value == pytest.approx(1.0, abs=3e-5)
    assert switch.cost == pytest.approx(c / (1 + c), rel=1e-4)
    for point in path.points:
        free = c * point.value**2 / (1 + c)
        assert point.solution.cost == pytest.approx(c if point.value >= 1 else free, rel=1e-8)


@pytest.mark.costly
def test_another_minimum_is_taken_where_it_becomes_the_cheaper() -> None:
    """With wide characteristic sizes the linear program includes both sides of the wall."""
    c = 1.0
    path = follow(pressing(c, size=10.0), 0.5, 3.0, 10)
    assert path.break_reason is None
    assert [event.kind for event in path.events] == ["switch"]
    assert path.events[0].value == pytest.approx(np.sqrt(1 + c), abs=2.5e-6)
    for point in path.points:
        best = min(c, c * point.value**2 / (1 + c)) if point.value >= 1 else None
        if best is not None:
            assert point.solution.cost == pytest.approx(best, rel=1e-8)


@pytest.mark.costly
def test_a_fold_is_stepped_round() -> None:
    """Stationary points of u⁴/4 - u²/2 - theta u are theta = u³ - u, with folds at u² = 1/3."""
    problem = between_walls(lambda u, t: u**4 / 4 - u**2 / 2 - t * u, lambda x, _: 0 * x, walls=100.0)
    path = follow(problem, -1.0, 1.0, 10)
    assert path.break_reason is None
    at = 2 / (3 * np.sqrt(3))
    assert [event.kind for event in path.events] == ["fold", "fold"]
    assert [event.value for event in path.events] == pytest.approx([at, -at], abs=2e-6)
    u = np.array([point.solution.data["u"].values.item() for point in path.points])
    theta = np.array([point.value for point in path.points])
    np.testing.assert_allclose(u**3 - u, theta, atol=1e-8)
    assert theta[-1] == 1.0
    assert np.all(np.diff(u) > 0), "no point of the curve is missed, the saddles between the folds"
    assert (np.abs(u) < 1 / np.sqrt(3)).sum() > 3
