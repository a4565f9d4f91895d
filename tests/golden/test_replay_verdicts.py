"""Verdicts on replays that end early, and on replays that cost more than the plan."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from dynamics.contact import Barrier, ContactLaw, Exact
from dynamics.systems import lcs
from ocp import Direct, MultipleShooting, Problem, SingleShooting, solve
from ocp.problem.rollout import roll_out
from ocp.programs.solver import Status
from problems import get, names
from tests.findings import codes, numbers
from tests.golden.test_verdicts import to_a_goal


def test_a_replay_without_solution_is_not_replayed() -> None:
    """With ``0 <= lam ⟂ z - lam >= 0`` at both walls there is no solution outside of them."""
    both = lcs(
        "both",
        A=[[1.0]],
        B=[[1.0]],
        C=[[1.0, -1.0]],
        D=[[1.0], [-1.0]],
        E=[[1.0], [-1.0]],
        F=[[-1.0, 0.0], [0.0, -1.0]],
        d=[1.0, 1.0],
    )
    found = solve(to_a_goal(both, 0.5), Exact(), effort="quick")
    assert np.isnan(found.audit.exact_cost)
    where, contact = found.audit.replay_failed.split(" did not converge, contact ")
    assert where.startswith("step ") and contact.startswith("'contact")
    assert "exact law not replayed" in found.headline
    assert numbers(found, "not-replayed") == {"step": found.audit.replay_failed}
    assert "survives" not in found.headline


def test_a_cost_that_is_no_number_in_the_replay_does_not_survive() -> None:
    """The root in the cost is real at the end of the smoothed plan, and not at that of its replay."""
    problem = get("push-1d")
    end = problem.terminal_cost + 1e-3 * ca.sqrt(problem.system.x[0] - 0.9)

    def guess(problem: Problem, _: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        share = np.linspace(0, 1, problem.N + 1)[:, None]
        return share * [1.2, 1.0] + (1 - share) * [0, -0.5], np.linspace(-0.5, 1, problem.N)[:, None]

    found = solve(replace(problem, terminal_cost=end, guess=guess), Barrier(mu=0.1))
    assert np.isnan(found.referee.cost) and np.isfinite(found.referee.gap)
    assert found.referee.survives is False and found.grade == "certified"
    assert found.headline == (
        f"Solved: cost {found.cost:.6g}, exact law cost not finite, referee cost not finite; does not survive."
    )
    assert {"replay-cost-not-finite", "exact-cost-not-finite"} <= {*codes(found)}


@pytest.mark.cheap_cases("law1-method0")
@pytest.mark.parametrize("method", [Direct(), MultipleShooting(), SingleShooting()])
@pytest.mark.parametrize("law", [Exact(), Barrier(mu=1e-3)])
def test_a_guess_without_a_cost_is_one_sentence(law, method, capfd) -> None:
    problem = get("push-1d")
    stage = problem.stage_cost + 1e-6 * ca.log(problem.system.x[0])
    found = solve(replace(problem, stage_cost=stage), law, method)
    assert (found.status, found.grade) == (Status.DIVERGED, "failed")
    assert found.verdict.split("\n") == [
        "Not converged: cost -inf.",
        "The cost is NaN or infinite at the last iterate: give a guess with a finite cost, and"
        " bounds that keep the states where the cost is finite.",
    ]
    assert found.referee.survives is False
    assert capfd.readouterr() == ("", ""), "and no warning beside it"


HARD = ("half-cheetah", "hopper", "planar-hand", "quadruped", "ant", "push-cube", "reorient")
EASY = tuple(name for name in names() if name not in HARD)


def dearer_is_told(name: str, law: ContactLaw) -> None:
    found = solve(get(name), law)
    referee, first = found.referee, found.headline
    twice = found.cost + abs(found.cost)
    if referee.survives is not None and not referee.cost <= twice:
        assert first.endswith("; does not survive.")
    if referee.survives_at_h is False:
        assert "does-not-survive" in codes(found) and found.grade != "survives"
    if referee.survives is False:
        assert found.grade != "survives" and referee.word in first
    assert ("; survives." in first) <= (referee.survives is True)
    assert (found.grade == "survives") == (found.success and referee.survives is True)
    assert found.success == (first.startswith("Solved"))
    # The referee's cost is that of the inputs, simulated here again.
    again = roll_out(
        found.problem, found.data["u"].values, found.values, found.problem.referee_step, found.data["x"].values[:, 0]
    )
    assert referee.survives is None or again.cost == pytest.approx(referee.cost, rel=1e-9)


@pytest.mark.costly_cases("hopper-1d-exact")
@pytest.mark.one_case_in(16)
@pytest.mark.parametrize("law", [Exact(), Barrier(mu=1e-2)], ids=["exact", "barrier"])
@pytest.mark.parametrize("name", EASY)
def test_no_replay_is_dearer_without_being_told(name: str, law: ContactLaw) -> None:
    dearer_is_told(name, law)


@pytest.mark.slow
@pytest.mark.parametrize("law", [Exact(), Barrier(mu=1e-2)], ids=["exact", "barrier"])
@pytest.mark.parametrize("name", ["half-cheetah", "hopper", "planar-hand"])
def test_no_long_replay_is_dearer_without_being_told(name: str, law: ContactLaw) -> None:
    dearer_is_told(name, law)
