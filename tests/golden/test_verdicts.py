"""Verdicts on problems as users write them: texts, numbers, and grades."""

from __future__ import annotations

import functools
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from dynamics.contact import Barrier, ContactLaw, Exact
from dynamics.systems import ParameterTable, lcs, signals, time_stepping
from ocp import Direct, MultipleShooting, Problem, SingleShooting, Solution, solve
from ocp.errors import InputError
from ocp.problem.problem import Scaling
from ocp.problem.rollout import roll_out
from ocp.programs.solver import Status
from ocp.solve.solve import new_session
from ocp.solve.starts import solve_session
from ocp.transcription import Method
from problems import get
from tests.findings import codes, numbers
from tests.unit.ocp.user_problems import (
    physical,
    ring,
    rough_slope,
    round_a_post,
    two_grippers,
)

ONE = [[1.0]]
LINE = lcs("line", A=ONE, B=ONE, C=ONE, D=ONE, E=ONE, F=ONE)
TWO_ENDED = lcs("two-ended", A=ONE, B=ONE, C=ONE, D=ONE, E=ONE, F=[[-1.0]])
"""System ``x+ = z + lam`` with ``0 <= lam ⟂ z - lam >= 0``, in which lam is 0 or z, and x+ is z or 2 z."""


def to_a_goal(system, goal: float) -> Problem:
    """Return a problem of six steps of a scalar system from 0.5 to ``goal``, with cheap inputs."""
    return Problem(
        system.name,
        system,
        6,
        0.1 * ca.sumsqr(system.u),
        10 * (system.x[0] - goal) ** 2,
        ca.SX([0.5]),
        ParameterTable([]),
        scaling=Scaling(1.0, 1.0, 1.0, 1.0),
    )


@functools.cache
def solved(problem_of, law: ContactLaw | None = None, method: Method | None = None) -> Solution:
    return solve(problem_of(), law or Exact(), method or Direct(), effort="quick")


# --- true geometry ---------------------------------------------------------------------------


@pytest.mark.costly
def test_a_disc_pulled_round_a_post_is_certified_and_does_not_survive() -> None:
    found = solved(round_a_post)
    assert (found.status, found.grade) == (Status.SOLVED, "certified")
    assert found.certificate.stationarity == "B"
    assert found.referee.survives is False
    assert found.referee.cost > 20 * found.cost
    assert found.audit.exact_cost == pytest.approx(found.cost, rel=1e-4), "its own model is content"
    assert found.headline == (
        f"Solved: cost {found.cost:.6g}, exact law {found.audit.exact_cost:.6g},"
        f" referee {found.referee.cost:.6g}; does not survive."
    )
    assert numbers(found, "gaps") == {"gaps": "linearised"} and numbers(found, "referee") == {"note": "true gaps"}
    told = codes(found)
    assert told[told.index("does-not-survive") + 1] == "costs-more"
    far = found.referee.force_distance
    assert far is not None and far.amount > 0.05
    # The penetration follows from the positions of the two discs at the end of that step.
    x = found.data["x"].values[0, far.step + 1]
    by_hand = {"push": np.hypot(*(x[:2] - x[2:])) - 0.3, "post": np.hypot(*x[:2]) - 0.5}
    assert far.amount == pytest.approx(by_hand[far.contact], rel=1e-9)
    where = {"contact": far.contact, "amount": far.amount, "step": far.step}
    assert numbers(found, "acts-at-a-distance") == where


@pytest.mark.costly
def test_a_plan_that_passes_through_a_body_between_nodes_is_told() -> None:
    """The pusher jumps to the far side of a box of 5 cm, which it touches at no node; samples would avoid that."""
    problem = get(
        "planar-push",
        gap="true",
        side=0.05,
        r=0.02,
        reach=3,
        K=1e5,
        w_du=0,
        N=4,
        oy0=0.5,
        goal_x=0,
        goal_y=-1.2,
        goal_angle=0,
    )
    found = solve(problem, Exact(), effort="quick")
    assert found.audit.penetration < 1e-6
    through = found.referee.between
    assert through is not None and through.amount > 0.02
    assert found.grade == "certified" and found.headline.endswith("; does not survive.")
    where = {"contact": through.contact, "amount": through.amount, "step": through.step}
    assert numbers(found, "plan-penetrates") == where


@pytest.mark.parametrize("h", [0.0, -0.1])
def test_a_step_size_that_is_none_is_refused(h: float) -> None:
    with pytest.raises(InputError, match=f"step size must be positive, got {h:g} s"):
        solve(ring(h=h, speed=1.0))


@pytest.mark.one_case_in(2)
@pytest.mark.parametrize("law", [Exact(), Barrier(mu=1e-3)])
def test_a_start_inside_a_wall_never_survives(law: ContactLaw) -> None:
    """The law moves a body from 5 m inside the wall out in one step, which is unphysical."""
    p = ParameterTable([])
    system = time_stepping(
        "deep",
        states=signals("x [m]; v [m/s]"),
        inputs=signals("u [N]"),
        contacts=signals("wall [N s]"),
        mass=ca.SX.eye(1),
        impulse=lambda q, v, u: 0.1 * u,
        distance=lambda q: q,
        h=0.1,
        parameters=p,
    )
    end = ca.sumsqr(system.x[0] - 1)
    found = solve(Problem("deep", system, 4, ca.sumsqr(system.u), end, ca.SX([-5.0, 0]), p), law, effort="quick")
    assert found.data["x"].values[0, 1, 0] > -1e-6
    assert found.referee.survives is False and found.grade == "certified"
    assert "; does not survive." in found.headline
    where = {"contact": "wall", "amount": 5.0, "place": "node", "step": 0}
    assert numbers(found, "contact-penetrated") == where


@pytest.mark.costly
def test_the_referee_of_a_plan_is_a_rollout_with_true_gaps() -> None:
    found = solved(round_a_post)
    sharp = round_a_post(linearised=False)
    again = roll_out(sharp, found.data["u"].values, found.values, x0=found.data["x"].values[:, 0])
    assert again.cost == pytest.approx(found.referee.cost, rel=1e-9)


@pytest.mark.costly
def test_an_oiled_finger_is_no_trouble() -> None:
    found = solved(two_grippers)
    assert (found.status, found.grade) == (Status.SOLVED, "survives")
    assert found.referee.note == "Coulomb friction with maximum dissipation"
    assert found.headline.endswith("; survives.")
    assert all(np.isfinite(found.data[key].values).all() for key in ("x", "x_replay", "x_referee"))
    assert found.data["x"].values[0, -1, 1] == pytest.approx(0.3, abs=0.02)


@pytest.mark.costly
def test_a_puck_too_fast_for_its_fence_never_survives() -> None:
    for law, method in (
        (Exact(), Direct()),
        (Exact(), MultipleShooting()),
        (Barrier(mu=1e-3), Direct()),
    ):
        found = solve(ring(h=0.1, speed=20.0), law, method)
        outside = np.hypot(*found.data["x"].values[0, :, :2].T).max() - 1.0
        assert outside > 0.5, "the model lets it out"
        assert found.referee.survives is False and found.grade != "survives"
        assert "referee not replayed; does not survive." in found.headline
        assert numbers(found, "step-not-solved") == {"step": "step 0 did not converge, contact 'ring'"}


# --- contact that the model leaves open --------------------------------------------------------


@pytest.mark.costly
def test_the_rough_slopes_freedom_is_named_with_step_and_contacts() -> None:
    found = solved(rough_slope)
    assert (found.status, found.grade) == (Status.SOLVED, "certified")
    assert found.referee.cost > 2 * found.cost
    assert found.headline.endswith("; does not survive.")
    assert "are not unique (slope, face): from the same state" in found.verdict
    assert "unstable-motion" not in codes(found)
    step = int(found.referee.nonuniqueness.partition("at step ")[2].split()[0])
    x, u = found.data["x"].values[0], found.data["u"].values[0]
    problem = found.problem
    other = np.array(problem.exact_step.solve(x[step], u[step], physical(problem))[0]).ravel()
    before = (
        np.array(problem.exact_step.solve.map(step)(x[:step].T, u[:step].T, physical(problem))[0])
        if step
        else np.zeros((6, 0))
    )
    assert np.abs(other - x[step + 1]).max() > 0.005, "the step as solved goes elsewhere"
    assert np.abs(before.T - x[1 : step + 1]).max(initial=0.0) <= 0.005, "and none before it does"


@pytest.mark.costly_cases("rough_slope-5e-06")
@pytest.mark.parametrize(
    ("problem_of", "mu"),
    [(rough_slope, 5e-6), (functools.partial(to_a_goal, TWO_ENDED, 2.0), 1e-4)],
)
def test_planning_through_the_step_is_planning_against_the_freedom(problem_of, mu: float) -> None:
    """Here, though not always, it gives a plan that the exact replay follows, and that costs less there.

    The barrier law alone does not help: for any mu, ``lam (z - lam) = mu`` has two solutions too.
    """
    free = solved(problem_of)
    assert "as the replay does, and the motion from there costs" in free.verdict
    bound = solved(problem_of, Barrier(mu=mu), MultipleShooting())
    assert bound.status is Status.SOLVED and bound.referee.nonuniqueness == ""
    assert bound.audit.exact_cost == pytest.approx(bound.cost, rel=1e-2)
    assert bound.audit.exact_cost < 0.2 * free.audit.exact_cost


@pytest.mark.costly
def test_standing_still_is_no_progress_though_a_contact_rests() -> None:
    """The block rests on the slope, which costs 100 * 0.6², and the input only holds the cart."""
    plain = {"homotopy": False}
    found = solve(rough_slope(), Exact(), SingleShooting(), settings=plain)
    assert found.audit.active_steps > 0, "the block's weight is borne throughout"
    assert found.certificate.stationarity == "B", "no small push moves the block"
    assert np.abs(found.data["x"].values[0, :, 1]).max() < 1e-6
    assert found.idle_cost == pytest.approx(36.0, abs=1e-9)
    assert (found.status, found.grade) == (Status.NO_PROGRESS, "failed")
    assert found.verdict.startswith("No-progress: cost 36.01")
    assert "survives" not in found.headline
    onward = solve(rough_slope(), Exact(), SingleShooting(), settings={"homotopy": True})
    assert codes(found)[:2] == ["status", "no-homotopy"] and onward.cost < 1.0


def test_what_forces_from_afar_move_is_no_standing_still() -> None:
    """With mu = 1e-2 the box slides without contact, and the plan is optimal under this law."""
    found = solve(get("box-slide"), Barrier(mu=1e-2))
    assert found.audit.active_steps == 0 and found.cost < 1e-3 * found.idle_cost
    assert (found.status, found.grade) == (Status.SOLVED, "certified")
    assert found.headline.endswith("; does not survive.")
    assert found.referee.cost > 100 * found.cost


@pytest.mark.costly
def test_to_hold_what_is_wanted_is_no_standing_still() -> None:
    """A cart at its goal must be held against gravity, and this effort is the solution."""
    problem = rough_slope()
    x = problem.system.x
    wanted = 100 * ca.sumsqr(x[:2]) + ca.sumsqr(x[3:])
    problem = replace(problem, stage_cost=problem.stage_cost + wanted, terminal_cost=wanted)
    found = solve(problem, Exact())
    assert found.data["u"].values.mean() == pytest.approx(9.81 * np.sin(0.4), rel=0.01)
    assert found.status is Status.SOLVED


# --- whom not to believe ---------------------------------------------------------------------


@pytest.mark.costly
@pytest.mark.parametrize("law", [Exact(), Barrier(mu=1e-3)])
def test_a_solver_told_to_be_content_solves_nothing(law) -> None:
    session = new_session(get("push-disc"), law)
    # The tolerances are set after the check of settings, which would reject them.
    session.solver.options |= {"tol": 1e10, "dual_inf_tol": 1e10, "compl_inf_tol": 1e10}
    found = solve_session(session)
    assert found.grade == "failed" and not found.verdict.startswith("Solved")
    # A route that tries contact schedules may still end without contact.
    dead_end = found.status is Status.NO_PROGRESS and found.certificate.stationarity == "B"
    assert dead_end or found.certificate.stationarity == "not"


def test_without_geometry_there_is_no_referee_and_that_is_said() -> None:
    found = solve(to_a_goal(LINE, 1.0), Exact())
    assert (found.status, found.grade) == (Status.SOLVED, "certified")
    assert found.referee.survives is None and np.isnan(found.referee.cost)
    assert found.headline.endswith(", no referee.")
    assert "no-referee" in codes(found) and not {"does-not-survive", "gaps"} & {*codes(found)}


@pytest.mark.costly
def test_every_verdict_says_which_gaps_the_model_has() -> None:
    bent = solved(round_a_post)
    true = solve(round_a_post(N=2, linearised=False), Barrier(mu=0.1))
    flat = solve(get("wall-1d"), Barrier(mu=0.1))
    assert [numbers(each, "gaps")["gaps"] for each in (bent, true, flat)] == ["linearised", "true", "true"]
