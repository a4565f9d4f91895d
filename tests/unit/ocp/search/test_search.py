"""Pushes found without a guess: steps, complementarity problems and plans agree with independent methods."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from dynamics.systems import ParameterTable
from ocp import solve
from ocp.errors import InputError
from ocp.judge.certificate import Certificate
from ocp.judge.findings import make_finding
from ocp.judge.referee import RefereeReport
from ocp.problem.evaluation import Evaluation
from ocp.problem.problem import SWEPT, Constraint, Problem, Scaling
from ocp.problem.rollout import roll_on
from ocp.routes.branches import ACTIVE_SET
from ocp.search import near_steps
from ocp.search.near_steps import NearSteps
from ocp.search.push_search import PushSearch, penetrates_between_nodes
from ocp.search.push_tree import TouchSearch
from ocp.search.search import has_many_minima, is_poor
from ocp.solve.judging import judge_outcome
from ocp.solve.solve import new_session
from problems import get
from problems.scenes import Body, Box, Disc, Obstacle, Pusher, Scene
from tests.benchmarks.ocp.world_scenes import row_of_discs

REACH = 0.15


@cache
def behind(N: int = 20) -> Problem:
    """Return a problem in which a finger must go round a disc to push it back, past a block."""
    scene = Scene(
        [
            Pusher("finger", Disc(0.05), at=(-0.3, 0.0), stiffness=50.0),
            Body("disc", Disc(0.15), at=(0.0, 0.0), mass=1.0, inertia=0.01),
            Obstacle("block", Box((0.1, 0.05)), at=(0.0, -0.4)),
        ],
        friction=0.3,
    )
    table = ParameterTable(())
    system = scene.quasi_dynamic("behind", table, h=0.05)
    off = scene.coordinates_of("disc", system.x)[:2] - ca.vertcat(-0.3, 0)
    du = ca.SX.sym("du", 2)
    return Problem(
        "behind",
        system,
        N,
        stage_cost=0.1 * ca.sumsqr(du),
        terminal_cost=10 * ca.sumsqr(off),
        x0=scene.at_rest(system),
        parameters=table,
        du=du,
        u_before=scene.hold,
        path=[Constraint("reach", system.u - scene.coordinates_of("finger", system.x), -REACH, REACH)],
        scaling=Scaling(impulse=0.5, gap=0.1, x=0.5, u=0.5),
    )


def test_steps_with_near_contacts_are_the_exact_laws() -> None:
    problem, single = behind(), behind(1)
    values = problem.parameters.defaults
    rng = np.random.default_rng(1)
    angle = rng.uniform(0, 2 * np.pi, 12)
    x = np.zeros((12, 5))
    x[:, 3:] = 0.21 * np.column_stack([np.cos(angle), np.sin(angle)])
    u = x[:, 3:] + rng.uniform(-0.1, 0.1, (12, 2))
    near = NearSteps(Evaluation(problem, values), problem.referee_step.system)(x, u)
    for start, command, end in zip(x, u, near, strict=True):
        exact, failed = roll_on(Evaluation(single, values), command[None, None], x0=start[None])
        assert failed is None
        np.testing.assert_allclose(end, exact.x[0, 1], atol=1e-6)


@pytest.mark.costly
def test_a_plan_is_found_from_behind_and_has_the_same_bits_again() -> None:
    problem = behind()
    found = solve(problem, contact="exact", search=True)
    assert found.certificate.certified and found.referee.survives
    assert found.cost < 0.3 * found.idle_cost and not penetrates_between_nodes(found)
    assert found.problem.swept and found.route.search is not None and found.route.search.motions > 100
    seen = [
        [(node.x.tobytes(), node.cost) for node in nodes]
        for _ in range(2)
        for nodes in TouchSearch(problem, problem.parameters.defaults, 3).rounds(2)
    ]
    assert seen[:2] == seen[2:]


def test_what_is_swept_stays_apart_on_the_way_too() -> None:
    problem = behind(8)
    x, x_next = np.array([0, 0, 0, -0.3, 0.02]), np.array([0, 0, 0, 0.3, 0.02])
    swept = replace(problem, swept=True)
    (way,) = (one for one in swept.path if one.name == SWEPT)
    system = swept.system
    value = ca.Function("way", [system.x, system.x_next], [way.expression])(x, x_next)
    assert system.phi is not None
    phi = ca.Function("phi", [system.x], [system.phi])
    expected = [phi(x + share * (x_next - x)) for share in (0.25, 0.5, 0.75)]
    np.testing.assert_allclose(np.array(value), np.array(ca.vertcat(*expected)), atol=1e-12)
    lower = np.array(ca.DM(way.lower))
    assert float(ca.mmin(value)) < -0.1 < lower.min() and lower.max() < 0


def test_an_answer_that_stands_still_or_is_lost_falls_short() -> None:
    session = new_session(behind(2), "exact")
    pushes = PushSearch(session, judge_outcome)
    found = solve(behind(2), contact="exact", search=False, effort="quick")
    assert pushes.is_needed(replace(found, cost=0.95 * found.idle_cost))
    half = 0.5 * found.idle_cost
    good = replace(found, cost=half, audit=replace(found.audit, exact_cost=half), certificate=Certificate("B"))
    assert not pushes.is_needed(replace(good, referee=RefereeReport(note="exact")))
    assert pushes.is_needed(
        replace(good, referee=RefereeReport(note="exact", findings=[make_finding("states-not-finite")]))
    )
    failing = RefereeReport(note="exact", findings=[make_finding("states-not-finite")])
    assert is_poor(replace(good, referee=failing)) and not is_poor(replace(good, referee=RefereeReport(note="exact")))
    diverging = replace(good, audit=replace(good.audit, exact_cost=2.0 * found.idle_cost))
    assert is_poor(replace(diverging, referee=RefereeReport(note="exact")))
    session.search = False
    assert not pushes.is_needed(replace(found, cost=found.idle_cost))


def test_an_answer_far_below_the_first_branch_shows_many_minima() -> None:
    pushed = solve("push-box", N=10, contact="exact", search=False, effort="quick")
    branches = [stage.cost for stage in pushed.stages if stage.label == ACTIVE_SET and stage.accepted]
    assert branches[0] > pushed.cost + 1.0
    far = replace(pushed, cost=branches[0] / 2)
    assert has_many_minima(far) and not has_many_minima(replace(pushed, cost=branches[0]))


def test_search_and_warm_start_exclude_each_other() -> None:
    with pytest.raises(InputError, match="give one of them"):
        solve(get("push-disc"), search=True, warm_start=object())  # type: ignore[arg-type]


@pytest.mark.costly
def test_a_scene_that_passes_through_is_solved_as_swept_and_resumed_so() -> None:
    problem = behind(10)
    assert penetrates_between_nodes(solve(problem, contact="exact", search=False))
    found = solve(problem, contact="exact")
    assert found.route.swept and not penetrates_between_nodes(found) and found.referee.survives
    again = solve(problem, contact="exact", warm_start=found)
    assert again.route.swept and again.problem.swept
    assert again.cost == pytest.approx(found.cost, rel=1e-6)


def test_steps_of_a_system_whose_gaps_do_not_see_their_impulses() -> None:
    """Without friction no gap depends on lam directly, but the steps still equal those of the exact law."""
    problem = get("push-1d")
    values = problem.parameters.defaults
    x = np.array(problem.limits(problem.parameters.pack(values))[0]).ravel()[None]
    u = x[:, -problem.system.nu :] + 0.2
    near = NearSteps(Evaluation(problem, values), problem.system)
    single, x_exact = replace(problem, N=1), x[0]
    for _ in range(3):
        x = near(x, u)
        exact, failed = roll_on(Evaluation(single, values), u[None], x0=x_exact[None])
        assert failed is None
        x_exact = exact.x[0, 1]
        np.testing.assert_allclose(x[0], x_exact, atol=1e-6)


def test_many_discs_are_pushed_no_more_often_than_four() -> None:
    """The number of pushes from a state does not grow with the number of bodies beyond four."""
    counts = {}
    for m in (1, 4, 8):
        problem = row_of_discs(m, N=2)
        tree = TouchSearch(problem, problem.parameters.defaults)
        start = tree.first()
        counts[m] = len(tree._push_paths(start.x[-1], start.x[-1][-problem.system.nu :]))
    assert 0 < counts[1] <= 48 and max(counts[4], counts[8]) <= 192 and counts[4] > 2 * counts[1]


def test_a_step_has_the_same_solution_whatever_contacts_it_leaves_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """A finger in a row of four discs, which touches none, one, or moves them all."""
    problem = row_of_discs(4, N=2)
    steps = NearSteps(Evaluation(problem, {}), problem.system)
    x = np.zeros((3, 14))
    x[:, [0, 3, 6, 9]] = np.cumsum([[0.0, 0.25, 0.25, 0.25], [0.0, 0.25, 0.25, 0.25], [0.0, 0.2, 0.2, 0.2]], axis=1)
    x[:, 12] = -0.5, -0.15, -0.15
    u = x[:, 12:] + [[0.1, 0.02]]
    few = steps.solved(x, u)
    monkeypatch.setattr(near_steps, "_NEAR", (10,))
    every = steps.solved(x, u)
    moved = np.abs(every[0] - x)[:, [0, 3, 6, 9]].max(axis=0) > 1e-3, (every[0] - x)[:, 0] > 1e-3
    assert moved[0].all() and moved[1].tolist() == [False, True, True]
    np.testing.assert_allclose(few[0], every[0], atol=1e-7)


def test_motions_that_all_fail_leave_no_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    tree = TouchSearch(behind(4), behind(4).parameters.defaults)
    monkeypatch.setattr(tree, "_step", lambda x, u: np.full_like(x, np.nan))
    assert tree._rolled([(tree.first(), np.zeros((4, 2)))]) == []


@pytest.mark.costly
@pytest.mark.parametrize("N", [1, 2])
def test_a_horizon_of_one_step_is_searched_too(N: int) -> None:
    found = solve(behind(N), search=True, settings={"max_iter": 5})
    assert found.route.search is not None and found.route.search.motions > 0
    assert np.isfinite(found.cost)


def test_a_push_is_at_most_three_sizes_long_and_leads_into_the_body() -> None:
    """Lengths are log-uniform between 0.1 and 3 sizes; directions scatter about ``into`` by 0.35 rad."""
    size, into, own = 0.2, np.array([0.6, -0.8]), np.array([0, 1])
    search: Any = SimpleNamespace(
        problem=SimpleNamespace(scales=SimpleNamespace(x=np.array([size]))),
        rng=np.random.default_rng(0),
        limits=SimpleNamespace(u_lower=np.full(2, -np.inf), u_upper=np.full(2, np.inf)),
    )
    point = np.array([1.0, 2.0])
    pushes = np.array([TouchSearch._push_end(search, point, into, own) - point for _ in range(2000)])
    lengths = np.linalg.norm(pushes, axis=1) / size
    assert 0.1 <= lengths.min() < 0.12 and 2.7 < lengths.max() <= 3.0
    assert np.log(lengths).mean() == pytest.approx(np.log(0.3) / 2, abs=0.1)
    angles = np.arctan2(pushes @ [-into[1], into[0]], pushes @ into)
    assert np.abs(angles.mean()) < 0.06 and angles.std() == pytest.approx(0.35, abs=0.05)
    search.limits = SimpleNamespace(u_lower=np.array([0.9, 1.9]), u_upper=np.array([1.1, 2.1]))
    ends = np.array([TouchSearch._push_end(search, point, into, own) for _ in range(50)])
    assert np.abs(ends - point).max() == pytest.approx(0.1), "bounds of the inputs cut pushes"
