"""Standing still is no progress if nothing else was tried, and the solution if nothing is better."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from dynamics.contact import Exact
from ocp import SingleShooting, Solution, Status, solve
from ocp.solve.solve import new_session
from ocp.solve.starts import WAYS, best_of
from problems import get
from problems.library.ball_throw import Params, roll
from tests.findings import numbers

HIGH = {"goal_x": 2.5365, "goal_z": 2.619, "goal_vx": 2.5365, "goal_vz": -3.2857}
"""Parameters with a goal that a throw reaches without a bounce, so that no contact acts."""


def thrown_cost(theta: float, speed: float, **params: float) -> float:
    """Return the cost of a throw in closed form; idle inputs are zero and cost nothing."""
    p = Params(**params)
    end = roll(p, theta, speed)[-1]
    off = end[:4] - [p.goal_x, p.goal_z, p.goal_vx, p.goal_vz]
    return float(p.w_speed * speed**2 + p.w_end * (off[:2] ** 2).sum() + p.w_v * (off[2:] ** 2).sum())


def best_throw(most: float, **params: float) -> float:
    """Return the minimum cost over a grid of throws, refined by Nelder-Mead."""

    def cost(z: np.ndarray) -> float:
        return thrown_cost(*np.clip(z, [-1.5, 0], [1.5, most]), **params)

    grid = [(t, s) for t in np.linspace(-1.5, 1.5, 25) for s in np.linspace(0, most, 21)]
    first = sorted(grid, key=lambda z: cost(np.array(z)))[:3]
    ends = [minimize(cost, z, method="Nelder-Mead", options={"xatol": 1e-9}) for z in first]
    return float(min(one.fun for one in ends))


@pytest.mark.costly
def test_a_throw_without_a_bounce_is_an_answer() -> None:
    """No state is moved by contact alone, so that contacts that never act are no sign of a failure."""
    found = solve(get("ball-throw", **HIGH), Exact())
    assert found.audit.active_steps == 0
    assert found.idle_cost == pytest.approx(thrown_cost(0.0, 0.0, **HIGH), rel=1e-6)
    assert found.cost < 0.01 * found.idle_cost
    assert found.cost == pytest.approx(best_throw(10.0, **HIGH), rel=1e-5)
    assert (found.status, found.grade) == (Status.SOLVED, "survives")


@pytest.mark.slow
def test_starts_keep_the_cheapest_throw() -> None:
    """Two of six starts need no bounce, and must not be ranked behind those that bounce."""
    params = {"h": 0.008141297, "goal_vz": 0.14546146, "goal_z": 1.3566234}
    fast = {"speed_max": 16.698833}
    found = solve(get("ball-throw", **params, **fast), Exact(), n_starts=6)
    assert found.success and found.cost == pytest.approx(0.9383, rel=1e-4)
    assert found.cost == pytest.approx(best_throw(16.698833, **params, **fast), rel=1e-5)


@pytest.mark.costly
@pytest.mark.parametrize("share", [0.2, 0.8, 0.99])
def test_a_push_below_friction_moves_nothing_and_that_is_the_answer(share: float) -> None:
    """With ``u_max < friction m g`` no input moves the box, so that every plan costs at least ``w_end goal²``."""
    found = solve(get("box-slide", u_max=share * 0.5 * 9.81), Exact())
    assert found.cost == pytest.approx(100.0, rel=1e-9)
    assert (found.status, found.grade) == (Status.SOLVED, "survives")
    assert found.route.idle_attempts == len(found.route.attempts) >= WAYS
    assert numbers(found, "standing-still") == {"attempts": len(found.route.attempts)}
    json.dumps(found.record)


@pytest.mark.costly
def test_a_push_just_above_friction_moves_the_box() -> None:
    found = solve(get("box-slide", u_max=1.05 * 0.5 * 9.81), Exact())
    assert found.success and found.cost < 99.9 and not found.route.idle_attempts


TRAPS = [
    ("push-1d", {}, SingleShooting(), {"homotopy": False}),
    ("box-slide", {"u_max": 4.0}, SingleShooting(), {"homotopy": False}),
]


@pytest.mark.parametrize(("name", "params", "method", "settings"), TRAPS)
def test_a_trap_with_nothing_tried_beyond_stays_no_progress(name, params, method, settings) -> None:
    found = solve(get(name, **params), Exact(), method, settings=settings)
    assert found.certificate.stationarity == "B" and found.audit.active_steps == 0
    assert found.status is Status.NO_PROGRESS and not found.route.attempts


def test_a_hand_that_goes_home_is_no_progress_with_the_object() -> None:
    """The plan costs less than standing still, but the object, which only contact moves, does not move."""
    problem = get("push-1d")
    homely = replace(problem, stage_cost=problem.stage_cost + (problem.system.x[1] + 1) ** 2)
    found = solve(homely, Exact(), SingleShooting(), settings={"homotopy": False})
    assert found.certificate.stationarity == "B" and found.cost < found.idle_cost - 1.0
    assert found.status is Status.NO_PROGRESS


def test_standing_still_is_credited_by_what_others_found() -> None:
    """It counts if at least two starts end certified there, and no feasible one costs less."""
    session = new_session("box-slide", Exact())
    still = solve(get("box-slide"), Exact(), SingleShooting(), settings={"homotopy": False})
    assert still.status is Status.NO_PROGRESS

    def chosen(*others: Solution) -> Solution:
        return best_of(session, [still, *others])

    cheaper = replace(still, status=Status.NOT_OPTIMAL, cost=0.9 * still.cost)
    dearer = replace(still, status=Status.SOLVED, cost=2.0 * still.cost)
    lost = replace(still, status=Status.INFEASIBLE)
    assert chosen(lost).status is Status.NO_PROGRESS
    assert chosen(still, cheaper).status is Status.NOT_OPTIMAL
    found = chosen(dearer, lost)
    assert (found.cost, found.status, found.route.idle_attempts) == (still.cost, Status.SOLVED, 2)
