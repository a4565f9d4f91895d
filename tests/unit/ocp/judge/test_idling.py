"""Findings on solved plans that do little: untouched bodies, unmoved states, and the cost of holding still."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from dynamics.contact import Exact
from dynamics.systems import ParameterTable
from ocp import Problem, Scaling, Solution, solve
from ocp.judge.contact_report import contact_report
from ocp.judge.idling import cost_span, idle_cost, undone_findings
from ocp.problem.evaluation import Evaluation
from ocp.problem.rollout import roll_on
from ocp.solve.solve import new_session
from problems.scenes import Body, Disc, HalfPlane, Obstacle, Pusher, Scene
from tests.findings import codes

SENTENCES = {"never-touches", "contact-never-acts", "nothing-moves", "holding-still"}


def sliding(N: int = 4, most: float = 30.0) -> Problem:
    """Return a problem of a hand on a rail that pushes a box over a floor; the cost is the box's final distance."""
    scene = Scene(
        [
            Pusher("hand", Disc(0.1), at=(-0.25, 0.1), mass=1.0, axis=(1.0, 0.0)),
            Body("box", Disc(0.1), at=(0.0, 0.1), mass=1.0),
            Obstacle("floor", HalfPlane(), at=(0.0, 0.0)),
        ],
        friction={("box", "floor"): 0.1},
        non_colliding=[("hand", "floor")],
    )
    table = ParameterTable(())
    system = scene.time_stepping("sliding", table, h=0.05, gravity=(0, -9.81))
    return Problem(
        "sliding",
        system,
        N,
        stage_cost=1e-4 * system.u**2,
        terminal_cost=100 * (scene.coordinates_of("box", system.x)[0] - 0.3) ** 2,
        x0=scene.at_rest(system),
        parameters=table,
        u_lower=-most,
        u_upper=most,
        scaling=Scaling(impulse=0.5, gap=0.1, x=0.2, u=10),
    )


@pytest.fixture(scope="module")
def unreachable() -> Solution:
    """Return a plan for a hand that is too weak to reach the box."""
    return solve(sliding(most=0.5), effort="quick")


@pytest.mark.costly
def test_the_first_line_says_what_is_untouched_and_unmoved(unreachable: Solution) -> None:
    assert unreachable.success
    assert codes(unreachable)[:2] == ["never-touches", "nothing-moves"]
    assert unreachable.findings[1].numbers == {"states": ["box_x"]}
    first = unreachable.verdict.split("\n")[1]
    assert first == "The hand never touches the box; nothing moves that the cost depends on."


@pytest.mark.costly
def test_a_push_leaves_nothing_to_say() -> None:
    pushed = solve(sliding(), effort="quick")
    assert pushed.success and pushed.cost < 0.1 * pushed.idle_cost
    assert not SENTENCES & set(codes(pushed))


def test_a_law_written_by_hand_names_its_contact() -> None:
    session = new_session("push-1d", Exact())
    evaluation, N = session.evaluation, session.problem.N
    still, _ = roll_on(evaluation, np.tile(evaluation.limits.u_before, (1, N, 1)), session.step)
    contacts = contact_report(evaluation, session.step, still).contacts
    first, second = undone_findings(evaluation, still, contacts, cost_span(evaluation, still))
    assert (first.sentence, second.code) == ("the contact push never acts", "nothing-moves")


@pytest.mark.costly
@pytest.mark.parametrize(
    ("idle", "said"), [(1.05, "5 % more"), (0.98, "2 % less"), (1.0, "as much"), (2.0, None), (np.nan, None)]
)
def test_holding_still_is_compared_where_little_is_gained(unreachable: Solution, idle: float, said: str | None) -> None:
    plan = replace(unreachable.with_route(idle_attempts=0), idle_cost=idle * unreachable.cost)
    sentences = {finding.code: finding.sentence for finding in plan.findings}
    assert sentences.get("holding-still") == (said and f"holding still costs {said}")


def test_idle_inputs_are_zero_forces_where_the_force_before_was_not() -> None:
    base = sliding()
    du = ca.SX.sym("du", 1)
    held = replace(base, du=du, u_before=ca.SX([20.0]), stage_cost=1e-4 * base.system.u**2 + 1e-9 * du**2)
    session = new_session(held)
    evaluation = Evaluation(held, session.values)
    plan, _ = roll_on(evaluation, np.full((1, held.N, 1), 20.0), session.step)
    nothing, _ = roll_on(evaluation, np.zeros((1, held.N, 1)), session.step)
    assert idle_cost(evaluation, session.step, plan) == pytest.approx(min(nothing.cost, plan.cost))
