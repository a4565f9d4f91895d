"""planar-push and planar-hand: stated optima, and laws that move an object which is not touched at the start."""

from __future__ import annotations

import pytest

import problems
from dynamics.contact import Adaptive, Barrier, Exact, Randomized
from ocp import Direct, Feedback, MultipleShooting, SingleShooting, Status, solve
from ocp.problem.rollout import initial_guesses
from ocp.solve.judging import judge_outcome
from ocp.solve.solve import new_session
from problems.studies.start_without_contact.data import object_costs, plan_problem
from tests.golden.known import LAWS, better

NAMES = ("planar-push", "planar-hand")
SMOOTH = {
    "barrier": Barrier(mu=1e-3),
    "adaptive": Adaptive(sigma=0.02),
    "randomized": Randomized(sigma=0.1, samples=8),
}


def test_both_state_an_exact_and_a_barrier_optimum() -> None:
    for name in NAMES:
        assert list(problems.spec(name).golden) == list(LAWS)


@pytest.mark.costly
@pytest.mark.parametrize("name", NAMES)
def test_the_exact_law_does_not_move_what_it_does_not_touch(name: str) -> None:
    """As in Suh et al. 2023, fig. 2, the exact gradient is zero from a start without contact."""
    found = plan_problem(problems.get(name), Exact())
    rest, planned, replay = object_costs(name, found)
    assert found.status is Status.NO_PROGRESS
    assert planned == pytest.approx(rest, rel=1e-12)
    assert replay == pytest.approx(rest, rel=1e-12)
    assert found.audit.active_steps == 0


@pytest.mark.costly
@pytest.mark.parametrize("law", SMOOTH)
@pytest.mark.parametrize(
    ("name", "method"),
    [
        pytest.param("planar-push", SingleShooting(), marks=pytest.mark.slow),
        ("planar-push", Direct()),
        pytest.param("planar-hand", Direct(), marks=pytest.mark.slow),
        pytest.param("planar-hand", SingleShooting(), marks=pytest.mark.slow),
    ],
)
def test_smoothed_laws_move_it_and_the_replay_keeps_half(name: str, method, law: str) -> None:
    found = solve(problems.get(name), SMOOTH[law], method)
    assert found.success
    rest, planned, replay = object_costs(name, found)
    assert planned <= 0.2 * rest
    assert rest - replay >= 0.5 * (rest - planned)


@pytest.mark.costly
def test_methods_agree_under_the_average_of_exact_steps() -> None:
    """Shooting alone does not converge at its kinks, so that its result is the plan by direct transcription."""
    problem, law = problems.get("planar-push", N=6), Randomized(sigma=0.1, samples=4)
    costs = [solve(problem, law, method) for method in (Direct(), MultipleShooting())]
    costs.append(solve(problem, law, SingleShooting()))
    assert all(found.success for found in costs)
    assert [found.cost for found in costs] == pytest.approx([costs[0].cost] * 3, rel=1e-7)
    assert costs[0].record["strategy"] == "scholtes-adaptive"


@pytest.mark.costly
def test_feedback_over_scenarios_is_worth_its_gains() -> None:
    """Common gains for all starts cost no more than common inputs."""
    problem = problems.get("planar-push", N=10, scenarios=3)
    blind = solve(problem, Exact(), Direct())
    seeing = solve(problem, Exact(), Direct(), policy=Feedback())
    assert blind.success
    assert seeing.success
    assert seeing.cost < blind.cost
    assert seeing.audit.exact_cost == pytest.approx(seeing.cost, rel=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_the_exact_law_is_solved_from_every_perturbed_guess(name: str) -> None:
    session = new_session(problems.get(name), Exact(), Direct())
    found = [judge_outcome(session, session.solve(guess=g), 0) for g in initial_guesses(session.evaluation, 21, 0)]
    assert sum(one.success for one in found) >= 20
    golden = problems.spec(name).golden["exact"]
    assert [one.cost for one in found if better(golden, one)] == []
