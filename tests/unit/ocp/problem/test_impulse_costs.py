"""Costs and constraints on contact impulses: closed forms, and agreement of laws and methods."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from dynamics.contact import Adaptive, Barrier, ContactLaw, Exact, Randomized
from dynamics.learned.laws import Ewda
from ocp import (
    Constraint,
    Direct,
    InputError,
    MultipleShooting,
    Problem,
    SingleShooting,
    roll_out,
    solve,
)
from ocp.gradients.rollouts import RolloutObjective
from ocp.judge.constraints import broken_constraints
from ocp.problem.rollout import problem_impulses, roll_on
from problems import get
from tests.unit.dynamics.learned.wavy import Wavy
from tests.unit.ocp.user_problems import at_defaults, defaults, physical

N, H, FORCE = 4, 0.1, 5.0
METHODS = (Direct(), MultipleShooting(), SingleShooting())


def pressing(**more: object) -> Problem:
    """Return the problem of pressing a mass at rest against the wall of ``wall-1d`` with 5 N."""
    plain = get("wall-1d", N=N, x0=0.0, u_max=10.0)
    cost = (plain.system.lam / H - FORCE) ** 2 + 1e-3 * plain.system.u**2
    given = {"stage_cost": cost, "terminal_cost": 0} | more
    return replace(plain, **given)  # pyright: ignore[reportArgumentType]


def held() -> Problem:
    """Return the problem of pressing the mass with at least 5 N by the smallest input."""
    plain = get("wall-1d", N=N, x0=0.0, u_max=10.0)
    limit = Constraint("press", plain.system.lam / H, FORCE, np.inf)
    return replace(plain, stage_cost=plain.system.u**2, terminal_cost=0, path=[limit])


@pytest.mark.cheap_cases("single-shooting")
@pytest.mark.parametrize("method", METHODS, ids=lambda one: one.name)
def test_it_presses_with_the_force_that_is_asked_for(method: Direct) -> None:
    """At rest lam = -u = s, and ``min (s/h - F)² + w s²`` is at ``s = F/h / (1/h² + w)``."""
    found = solve(pressing(), Exact(), method)
    pressed = FORCE / H / (1 / H**2 + 1e-3)
    assert found.data["lam"].values == pytest.approx(pressed, rel=1e-6)
    assert found.data["u"].values == pytest.approx(-pressed, rel=1e-6)
    best = N * ((pressed / H - FORCE) ** 2 + 1e-3 * pressed**2)
    assert found.cost == pytest.approx(best, rel=1e-6)
    assert found.audit.exact_cost == pytest.approx(best, rel=1e-6)
    assert found.referee.cost == pytest.approx(best, rel=1e-6)
    assert found.certificate.stationarity == "B"


@pytest.mark.costly
@pytest.mark.parametrize("law", [Barrier(mu=1e-3), Adaptive(), Randomized(samples=4)], ids=lambda law: law.name)
def test_methods_agree_under_every_law(law: ContactLaw) -> None:
    costs = [solve(pressing(), law, method).cost for method in METHODS]
    assert costs == pytest.approx([costs[0]] * 3, rel=1e-5)


def test_a_force_limit_is_kept_and_priced() -> None:
    """With ``lam >= F h`` and the smallest input, the force is F in every step, and its input is the cost."""
    found = solve(held(), Exact())
    assert found.data["lam"].values == pytest.approx(FORCE * H, rel=1e-6)
    assert found.cost == pytest.approx(N * (FORCE * H) ** 2, rel=1e-6)
    assert found.certificate.stationarity == "B"


def test_a_replay_that_presses_too_little_breaks_its_constraint() -> None:
    problem = held()
    weak = roll_out(problem, np.full((1, N, 1), -0.8 * FORCE * H), defaults(problem))
    (broken,) = broken_constraints(at_defaults(problem), weak)
    assert broken.violation.component == "press"
    assert broken.violation.amount == pytest.approx(0.2 * FORCE)


def test_the_impulse_of_an_interval_is_the_sum_over_its_smaller_steps() -> None:
    problem, pushed = pressing(), np.full((1, N, 1), -0.25)
    rolled, _ = roll_on(at_defaults(problem), pushed, substeps=4)
    assert rolled.impulses == pytest.approx(1.0)
    assert rolled.cost == pytest.approx(N * ((1.0 / H - FORCE) ** 2 + 1e-3 / 16))


@pytest.mark.cheap_cases("barrier")
@pytest.mark.parametrize("law", [Exact(), Barrier(mu=0.02), Randomized(samples=4)], ids=lambda law: law.name)
def test_the_gradient_of_rollouts_is_that_of_central_differences(law: ContactLaw) -> None:
    u = -0.5 + 0.1 * np.random.default_rng(2).standard_normal(N)
    objective = RolloutObjective(pressing(), law, theta=u)
    cost, gradient = objective.cost_and_gradient(u)
    values = defaults(objective.problem)
    assert cost == pytest.approx(roll_out(objective.problem, u[None, :, None], values, law).cost)
    for k, step in enumerate(1e-6 * np.eye(N)):
        around = objective.cost_and_gradient(u + step)[0] - objective.cost_and_gradient(u - step)[0]
        assert gradient[k] == pytest.approx(around / 2e-6, rel=1e-5, abs=1e-6)


def test_edges_of_a_cone_are_matched_to_friction_by_what_they_exert() -> None:
    problem = get("planar-push")
    problem = replace(problem, stage_cost=problem.stage_cost + ca.sumsqr(problem.system.lam))
    p, step = physical(problem), problem.referee_step
    noise = np.random.default_rng(0)
    x, u = noise.uniform(-1, 1, (1, 3, 5)), noise.uniform(-1, 1, (1, 2, 2))
    sharp = noise.uniform(0, 1, (1, 2, step.n))
    own = problem_impulses(at_defaults(problem), step, x, u, sharp)
    for k in range(2):
        exerted = []
        for system, lam in ((problem.system, own), (step.system, sharp)):
            assert system.forces is not None
            both = ca.vertcat(system.forces.normal, system.forces.tangential)
            given = [system.x, system.u, system.lam, problem.parameters.vector]
            of = ca.Function("of", given, [both])
            exerted.append(np.array(of(x[0, k], u[0, k], lam[0, k], p)).ravel())
        np.testing.assert_allclose(exerted[0], exerted[1], rtol=1e-10)


def test_a_learned_law_has_no_impulses_to_weigh() -> None:
    problem = pressing()
    with pytest.raises(InputError, match="depends on contact impulses, which a learned law"):
        solve(problem, Ewda(Wavy(problem.system)))
