"""The referee: costs of plans under the most exact contact model, and reasons why plans do not survive."""

from __future__ import annotations

import functools
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from dynamics.contact import Barrier, Exact
from dynamics.systems import ContactSystem
from ocp import Direct, Problem, Solution, roll_out, solve
from ocp.judge.constraints import broken_constraints
from ocp.judge.findings import Finding
from ocp.judge.measures import measure
from ocp.judge.referee import Referee, RefereeReport, referee_plan, referee_replay, survival_findings
from ocp.judge.step_solutions import Nonuniqueness, differing_contacts, find_nonuniqueness
from ocp.problem.evaluation import Evaluation
from ocp.problem.rollout import Rollout
from problems import get
from tests.unit.ocp.user_problems import (
    at_defaults,
    defaults,
    physical,
    ring,
    rough_slope,
    round_a_post,
    trajectories,
    two_grippers,
)


def plan_of(found: Solution) -> Rollout:
    x, u, lam, gap = (found.data[name].values for name in ("x", "u", "lam", "gap"))
    return Rollout(x, u, lam, gap, lam, np.array([found.cost]))


def measured(problem: Problem, report: Referee):
    return measure(at_defaults(problem), problem.referee_step, report.replay)


@functools.cache
def solved(problem_of, law=None) -> tuple[Solution, RefereeReport, Referee]:
    """Return the usual route's solution, which samples would replace where its replay parts from the plan."""
    problem, law = problem_of(), law or Exact()
    found = solve(problem, law, Direct(), n_starts=3, effort="quick")
    assert found.success
    return found, *referee_plan(Evaluation(problem, found.values), law.close(problem.system), plan_of(found))


# --- problems of users -----------------------------------------------------------------------


@pytest.mark.costly
def test_a_disc_pulled_round_a_post_survives_its_model_but_not_the_referee() -> None:
    found, report, sharp = solved(round_a_post)
    assert found.audit.exact_cost == pytest.approx(found.cost, rel=1e-4)
    assert sharp.note == "true gaps"
    assert sharp.cost > 20 * found.cost
    assert report.reasons
    assert "costs-more" in [finding.code for finding in report.findings]
    far, near = report.force_distance, measured(found.problem, sharp).force_distance
    assert far is not None
    assert near is not None
    assert far.amount > 0.05, "the model's contacts act at a distance"
    x, k = found.data["x"].values[0], far.step + 1
    names = {"push": (x[k, :2] - x[k, 2:], 0.3), "post": (x[k, :2], 0.5)}
    between, radii = names[far.contact]
    assert far.amount == pytest.approx(np.linalg.norm(between) - radii, rel=1e-9)
    assert near.amount < 1e-6


def test_with_true_gaps_the_same_problem_is_its_own_referee() -> None:
    problem = round_a_post(linearised=False)
    assert problem.system.most_exact is problem.system
    assert problem.referee_step is problem.exact_step
    inputs = np.random.default_rng(0).normal(scale=0.3, size=(1, problem.N, 2))
    judged = referee_replay(at_defaults(problem), inputs, problem.initial_states(physical(problem)))
    by_model = referee_replay(at_defaults(round_a_post()), inputs, judged.replay.x[:, 0])
    np.testing.assert_allclose(judged.replay.x, by_model.replay.x, atol=1e-9)


def off_the_slopes_laws(problem: Problem, v: float, v_next: float, u: float) -> float:
    """Return the violation of Coulomb's laws by cart and block, 1 kg each, that move together.

    ``2 (v+ - v) = h (u - 2 g sin) - T`` gives the friction T of the slope, ``P = v+ - v + h g sin + T``
    the push of the face, whose friction carries the weight that the slope's normal force N does not.
    """
    p = defaults(problem)
    h, f, face = p["h"], p["friction"], p["face"]
    along, across = (9.81 * trig(p["slope"]) for trig in (np.sin, np.cos))
    rub = h * (u - 2 * along) - 2 * (v_next - v)
    push = v_next - v + h * along + rub
    # Sliding determines N; for a block at rest N is the value that suits the face best.
    normal = rub / f if v_next > 1e-6 else max(abs(rub) / f, h * across - face * push)
    return max(0.0, -normal, -push, abs(rub) - f * normal, abs(h * across - normal) - face * push)


def contacts_of(problem: Problem, lam: np.ndarray, found: Nonuniqueness) -> tuple[str, ...]:
    return differing_contacts(problem, lam[found.scenario, found.step], found.lam[0])


@pytest.mark.costly
def test_a_push_up_a_rough_slope_is_not_determined_and_the_step_is_named() -> None:
    found, report, sharp = solved(rough_slope)
    plan = plan_of(found)
    nonuniqueness = find_nonuniqueness(Evaluation(found.problem, found.values), plan)
    assert nonuniqueness is not None and "not unique" in report.nonuniqueness
    assert nonuniqueness.replayed and f"at step {nonuniqueness.step} " in report.nonuniqueness
    assert set(contacts_of(found.problem, plan.lam, nonuniqueness)) <= {"slope", "face"}
    distance = plan.x[0, nonuniqueness.step + 1, 4] - nonuniqueness.x_next[0, 4]
    assert distance > 0.01
    assert report.branch_cost == pytest.approx(sharp.cost, rel=1e-2)
    assert sharp.note == "the model itself"
    assert sharp.cost > 2 * found.cost
    assert report.reasons
    # The model allows both ends: neither violates the laws of slope and face.
    problem, k = found.problem, nonuniqueness.step
    x, u = found.data["x"].values[0], float(found.data["u"].values[0, k, 0])
    solved_step = np.array(problem.exact_step.solve(x[k], u, physical(problem))[0]).ravel()
    ends = x[k + 1], solved_step
    for end in ends:
        assert end[3] == pytest.approx(end[4], abs=1e-6)
        assert off_the_slopes_laws(problem, x[k, 4], end[4], u) < 1e-5
    assert ends[0][4] - ends[1][4] == pytest.approx(distance, rel=1e-6)
    assert off_the_slopes_laws(problem, x[k, 4], x[k + 1, 4] + 1.0, u) > 1e-2


@pytest.mark.costly
def test_a_determined_plan_does_not_part() -> None:
    for name in ("push-1d", "planar-push", "hopper-1d"):
        found = solve(get(name), Exact(), Direct())
        plan = plan_of(found)
        assert find_nonuniqueness(Evaluation(found.problem, found.values), plan) is None


@pytest.mark.costly
def test_a_smoothed_plan_is_no_second_solution() -> None:
    """It follows its own law, so that its difference from the exact step does not make the model ambiguous."""
    found = solve(rough_slope(), Barrier(mu=1e-2), Direct())
    plan = plan_of(found)
    assert find_nonuniqueness(Evaluation(found.problem, found.values), plan) is None


def test_a_plan_that_hops_through_a_disc_is_one_of_two_ends_of_its_step() -> None:
    """With true gaps a step of the pusher has two solutions: on the far side of the disc, or pushing it."""
    problem = round_a_post(N=1, linearised=False)
    x = np.array([[[0.7, 0.1, 0.7, -0.3], [0.7, 0.1, 0.7, 0.5]]])
    u, lam = x[:, 1:, 2:], np.zeros((1, 1, 3))
    nonuniqueness = find_nonuniqueness(at_defaults(problem), trajectories(x, u, lam))
    assert nonuniqueness is not None
    assert (nonuniqueness.step, nonuniqueness.scenario, nonuniqueness.replayed) == (0, 0, True)
    assert contacts_of(problem, lam, nonuniqueness) == ("push",)
    found = measure(at_defaults(problem), problem.exact_step, trajectories(x, u, lam))
    assert found.penetration is not None
    assert found.between is not None
    assert found.penetration.amount == 0.0
    assert found.between.amount == pytest.approx(0.3, rel=1e-6)
    assert (found.between.contact, found.between.step) == ("push", 0)


def test_a_puck_too_fast_for_its_fence_is_not_replayed() -> None:
    """At speed 20 no impulse along the normal at the start of the step leads back inside."""
    problem = ring(h=0.1, speed=20.0)
    values, x0 = defaults(problem), problem.initial_states(physical(problem))
    plan = roll_out(problem, np.zeros((1, problem.N, 2)), values)
    report, sharp = referee_plan(Evaluation(problem, values), problem.exact_step, plan)
    assert report.penetration is not None
    radius = np.linalg.norm(plan.x[0, :, :2], axis=1).max()
    assert report.penetration.amount == pytest.approx(radius - 1.0, rel=1e-12)
    assert radius > 2.0
    assert sharp.failed is not None
    assert report.reasons[0] == "step 0 did not converge, contact 'ring'"
    slow = ring(h=0.01, speed=2.0)
    judged = referee_replay(at_defaults(slow), np.zeros((1, slow.N, 2)), x0 * [1, 1, 1, 0.1])
    assert judged.failed is None
    assert np.linalg.norm(judged.replay.x[0, :, :2], axis=1).max() < 1 + 1e-9


@pytest.mark.costly
def test_an_oiled_finger_grips_nothing() -> None:
    found, report, sharp = solved(two_grippers)
    assert report.reasons == []
    assert sharp.note == "Coulomb friction with maximum dissipation"
    assert found.data["x"].values[0, -1, 1] == pytest.approx(0.3, abs=0.02)
    forces = found.problem.system.most_exact.forces
    assert forces is not None
    replay = sharp.replay
    of = ca.Function(
        "t",
        [found.problem.system.most_exact.lam],
        [ca.substitute(forces.tangential, found.problem.parameters.vector, ca.SX(physical(found.problem)))],
    )
    along = np.array(of.map(replay.lam.shape[1])(replay.lam[0].T))
    assert np.abs(along[1]).max() == 0.0
    assert np.abs(along[0]).max() > 0.01


# --- forces at a distance ------------------------------------------------------------------------


@pytest.mark.costly
def test_the_distance_of_a_barriers_force_is_its_own() -> None:
    """With mu the impulse at the gap d is mu / d; it counts if it exceeds a share of the characteristic impulse."""
    _, report, _ = solved(lambda: get("push-1d"), Barrier(mu=1e-3))
    far = report.force_distance
    assert far is not None
    assert 1e-2 < far.amount <= 1e-3 / (1e-3 * 0.5)


@pytest.mark.costly
def test_convex_friction_acts_at_a_distance_and_the_referee_does_not() -> None:
    found, report, sharp = solved(lambda: get("planar-push"))
    replayed = measured(found.problem, sharp)
    assert report.force_distance is not None
    assert replayed.force_distance is not None
    assert report.force_distance.amount > 0.05
    assert replayed.force_distance.amount < 1e-9
    assert replayed.penetration is not None
    assert replayed.penetration.amount < 1e-9


# --- survival --------------------------------------------------------------------------------


@pytest.mark.costly
def test_what_survives_is_within_its_shares() -> None:
    """For a plan that survives, each measure moved across its bound alone gives one reason."""
    found, report, sharp = solved(lambda: get("push-disc"))
    problem, plan = found.problem, plan_of(found)
    assert report.reasons == []
    replayed = measured(problem, sharp)
    clean = replace(sharp, replay=plan, cost=found.cost)

    def verdict(judged: Referee, broken=()) -> list[Finding]:
        return survival_findings(at_defaults(problem), plan, judged, replayed, broken)

    assert verdict(clean) == []
    assert verdict(replace(clean, cost=1.09 * found.cost)) == []
    assert [finding.code for finding in verdict(replace(clean, cost=1.11 * found.cost))] == ["costs-more"]
    assert verdict(replace(clean, cost=0.5 * found.cost)) == []
    for off, count in ((0.04, 0), (0.06, 1)):
        x = plan.x.copy()
        x[0, 3, 1] += off
        reasons = verdict(replace(clean, replay=replace(plan, x=x)))
        assert len(reasons) == count
        assert [(reason.code, reason.numbers["state"], reason.numbers["node"]) for reason in reasons] == count * [
            ("state-differs", "oy", 3)
        ]
    for off, count in ((0.004, 0), (0.03, 1)):
        u = plan.u.copy()
        u[0, 2, 0] = 3.0 + off
        broken = broken_constraints(at_defaults(problem), replace(plan, u=u))
        assert len(broken) == 1
        reasons = verdict(clean, broken)
        assert len(reasons) == count
        assert [reason.sentence for reason in reasons] == count * ["its bound on ux is violated by 0.03 at step 2"]


@pytest.mark.costly
def test_bodies_in_one_another_do_not_survive() -> None:
    """The scheme of ball-throw lets one node lie below the floor, which is reported."""
    found, report, sharp = solved(lambda: get("ball-throw"))
    assert sharp.cost == pytest.approx(found.cost, rel=1e-9)
    assert report.reasons == ["floor is penetrated by 0.051 at node 34"]


def test_a_system_without_geometry_says_so() -> None:
    problem = get("box-slide")
    unknown: ContactSystem = replace(problem.system, referee_model=None)
    assert unknown.referee_note is None
    inputs = np.zeros((1, problem.N, 1))
    x0 = problem.initial_states(physical(problem))
    report = referee_replay(at_defaults(replace(problem, system=unknown)), inputs, x0)
    assert report.note is None
    assert report.cost == referee_replay(at_defaults(problem), inputs, x0).cost
    assert measured(problem, report).between is None
