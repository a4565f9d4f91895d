"""Constraints that hold in a plan and fail in its replay are reported, and the plan does not survive."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from dynamics.contact import Barrier
from dynamics.systems import ParameterTable, lcs
from ocp import Constraint, Problem, Solution, solve
from ocp.programs.solver import Status
from problems import get
from tests.findings import numbers

ONE = [[1.0]]
LINE = lcs("line", A=ONE, B=ONE, C=ONE, D=ONE, E=ONE, F=ONE)


def headline(found: Solution) -> str:
    return found.verdict.partition("\n")[0]


@pytest.mark.costly
@pytest.mark.parametrize("moved", [True, False])
def test_a_hard_end_that_only_smoothing_meets_is_named(moved: bool) -> None:
    """At mu = 0.1 a force at a distance moves the object to 0.3; the exact replay ends elsewhere."""
    problem = get("push-1d")
    end = Constraint("at", problem.system.x[0], 0.3, 0.3)
    problem = replace(problem, terminal=(end,))
    if not moved:
        assert problem.du is not None
        problem = replace(problem, stage_cost=0.1 * ca.sumsqr(problem.du), terminal_cost=ca.SX(0))
    found = solve(problem, Barrier(mu=0.1))
    assert (found.status, found.grade) == (Status.SOLVED, "certified")
    assert found.data["x"].values[0, -1, 0] == pytest.approx(0.3, abs=1e-6)
    broken = abs(found.data["x_referee"].values[0, -1, 0] - 0.3)
    assert broken > 0.1
    assert found.headline.endswith("; does not survive.")
    told = numbers(found, "constraint-violated")
    assert (told["constraint"], told["step"]) == ("terminal constraint at", 20)
    assert told["amount"] == pytest.approx(broken)
    replay = found.replay()
    (off,) = replay.broken
    assert (off.name, off.component, off.step) == ("terminal", "at", 20)
    assert off.amount == pytest.approx(abs(replay.data["x"].values[0, -1, 0] - 0.3), rel=1e-9)
    assert repr(replay).endswith(f"terminal constraint at is violated by {off.amount:.2g} at step 20>")
    sharp = solve(problem, Barrier(mu=1e-3))
    assert sharp.grade == "survives" and sharp.replay().broken == []


def test_a_hard_end_of_a_system_without_geometry_is_named_too() -> None:
    """In ``x+ = x + lam, 0 <= lam ⟂ lam - u >= 0`` the exact lam is max(u, 0), and the smoothed one is larger.

    With minimum effort all six inputs are the same u, so that ``6 lam = 0.3`` and ``lam (lam - u) = mu``.
    """
    ramp = lcs("ramp", A=ONE, B=[[0.0]], C=ONE, D=[[0.0]], E=[[-1.0]], F=ONE)
    problem = Problem(
        "ramp",
        ramp,
        6,
        0.1 * ca.sumsqr(ramp.u),
        ca.SX(0),
        ca.SX([0.0]),
        ParameterTable([]),
        terminal=[Constraint("end", ramp.x[0], 0.3, 0.3)],
        guess=lambda problem, _: (np.zeros((7, 1)), np.full((6, 1), 0.05)),
    )
    found = solve(problem, Barrier(mu=1e-3))
    u = 0.05 - 1e-3 / 0.05
    np.testing.assert_allclose(found.data["u"], u, atol=1e-6)
    assert (found.status, found.referee.survives) == (Status.SOLVED, None)
    (off,) = found.audit.replay_broken
    assert (off.component, off.step) == ("end", 6)
    assert off.amount == pytest.approx(0.3 - 6 * u, abs=1e-5)
    assert (
        f"Replayed under the exact law, its terminal constraint end is violated by {off.amount:.2g} at step 6."
    ) in found.verdict


@pytest.mark.costly
def test_planar_push_leaves_its_reach_bound_in_the_replay() -> None:
    found = solve(get("planar-push"), Barrier(mu=1e-2))
    assert found.grade == "certified" and found.headline.endswith("; does not survive.")
    reach = next(v for v in found.referee.broken if v.component == "reach[0]")
    assert reach.amount > 0.01
    told = {"constraint": "constraint reach[0]", "amount": reach.amount, "step": reach.step}
    assert any(finding.numbers == told for finding in found.findings)
    assert found.audit.constraint_violation < 1e-6, "the plan keeps it"


@pytest.mark.slow
def test_the_smoothed_gait_is_not_periodic_in_the_replay() -> None:
    found = solve(get("half-cheetah"), Barrier(mu=1e-3))
    assert found.grade == "certified" and found.headline.endswith("; does not survive.")
    worst = max((v for v in found.referee.broken if v.name == "periodic"), key=lambda v: v.amount)
    assert worst.amount > 0.5
    assert numbers(found, "constraint-violated")["constraint"] == f"periodicity of {worst.component}"
