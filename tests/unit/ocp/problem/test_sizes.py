"""Each rule by which characteristic sizes are derived, on a problem where it alone applies."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from dynamics.systems import ParameterTable, signals, time_stepping
from ocp import Constraint, Problem
from ocp.problem.problem import Scaling
from ocp.problem.sizes import derive_sizes, doubtful_sizes, gap_changes, residual_changes

H = 0.1
N = 20
T = N * H
"""Duration [s] of the horizon."""
X0 = np.array([1.0, 0.0, 0.4, 0.0, 0.0, 0.0])


def resting(gap=lambda q: q[0] - 3 * q[1], **changes) -> Problem:
    """Return a problem of a mass x, driven by a force, an angle a, and an amount b without actuator, all at rest.

    The guess moves nothing, so that sizes come from goals, gaps and bounds.
    """
    system = time_stepping(
        "resting",
        states=signals("x [m]; a [rad]; b [kg]; vx [m/s]; va [rad/s]; vb [kg/s]"),
        inputs=signals("F [N]"),
        contacts=signals("wall [N s]"),
        h=H,
        mass=ca.diag(ca.SX([2.0, 1.0, 1.0])),
        impulse=lambda q, v, u: H * ca.vertcat(u, 0, 0),
        distance=gap,
        parameters=ParameterTable(),
    )
    problem = Problem("resting", system, N, ca.SX(0), ca.SX(0), ca.SX(X0), ParameterTable())
    return replace(problem, **changes)


def goal_of(problem: Problem, bounds: tuple[float, float]) -> Problem:
    """Return the problem with ``bounds`` on twice the last x as its goal."""
    return replace(problem, terminal=[Constraint("end", 2 * problem.system.x[0], *bounds)])


@pytest.mark.parametrize("bounds", [(5.0, np.inf), (-np.inf, -1.0), (5.0, 5.0), (-1.0, -1.0)])
def test_a_goal_is_as_far_away_as_one_newton_step(bounds: tuple[float, float]) -> None:
    """Twice x is 2; it is to be 5 or more, or -1 or less, which x = 2.5 and x = -0.5 reach, 1.5 m away."""
    sizes = derive_sizes(goal_of(resting(), bounds))
    assert sizes.x[0] == pytest.approx(1.5)
    assert sizes.x[3] == pytest.approx(1.5 / T), "the velocity that covers it in the horizon"


def test_a_constraint_that_is_met_and_a_cost_without_curvature_are_no_goals() -> None:
    problem = goal_of(resting(), (1.0, 3.0))
    problem = replace(problem, terminal_cost=problem.system.x[0])
    assert derive_sizes(problem).x[0] == pytest.approx(1.0), "the distance of x0 from zero"


def test_the_goal_of_a_cost_is_its_minimum() -> None:
    problem = resting()
    x = problem.system.x[0]
    near, far = ((x - 1.3) ** 2, 50 * (x + 6) ** 2)
    for stage, terminal in ((near, far), (far, near)):
        sizes = derive_sizes(replace(problem, stage_cost=stage, terminal_cost=terminal))
        assert sizes.x[0] == pytest.approx(7.0), "the larger of the distances 0.3 and 7"


def test_a_state_without_goal_moves_a_gap_as_much_as_the_others() -> None:
    """x moves the gap x - 3 a by 1.5; so do 0.5 rad."""
    problem = goal_of(resting(), (5.0, np.inf))
    sizes = derive_sizes(problem)
    assert sizes.x[1] == pytest.approx(0.5)
    assert sizes.x[4] == pytest.approx(0.5 / T)
    assert sizes.gap == pytest.approx(0.1 * 1.5)
    np.testing.assert_allclose(gap_changes(problem, sizes.x), [1.5])


@pytest.mark.parametrize("ends", [(-0.2, 0.7), (-0.2, np.inf), (-np.inf, 0.7)])
def test_a_state_without_goal_and_gap_spans_its_bounds(ends: tuple[float, float]) -> None:
    """The amount b starts at 0.4; its farther finite bound is 0.6 or 0.3 away. Without bounds it is 0.4 from zero."""
    lower, upper = np.full(6, -np.inf), np.full(6, np.inf)
    lower[2], upper[2] = ends
    problem = goal_of(resting(), (5.0, np.inf))
    bounded = replace(problem, x_lower=ca.SX(lower), x_upper=ca.SX(upper))
    assert derive_sizes(bounded).x[2] == pytest.approx(max(abs(e - 0.4) for e in ends if np.isfinite(e)))
    assert derive_sizes(problem).x[2] == pytest.approx(0.4)
    assert derive_sizes(replace(problem, x0=ca.SX([1, 0, 0, 0, 0, 0]))).x[2] == 1.0, "nothing gives a size"


def test_an_input_moves_its_state_by_its_size_within_the_horizon() -> None:
    """A constant force F moves the mass of 2 kg by ``F h² N (N + 1) / 4`` and speeds it up by ``F T / 2``."""
    sizes = derive_sizes(goal_of(resting(), (5.0, np.inf)))
    moved, sped = H**2 * N * (N + 1) / 4, T / 2
    assert sizes.u[0] == pytest.approx(1 / max(moved / sizes.x[0], sped / sizes.x[3]))
    bounded = resting(u_lower=-3.0, u_upper=5.0)
    assert derive_sizes(bounded).u[0] == pytest.approx(4.0), "half the width of its bounds"


def test_an_impulse_changes_velocities_by_their_sizes_or_positions_by_a_share() -> None:
    """The impulse p changes vx by p / 2, x by h p / 2, va by 3 p, a by 3 h p; the least is the size."""
    sizes = derive_sizes(goal_of(resting(), (5.0, np.inf)))
    effects = np.array([H / 2, 3 * H, 0, 1 / 2, 3, 0])
    shares = effects / np.where(np.arange(6) < 3, sizes.x / N, sizes.x)
    assert sizes.impulse == pytest.approx(1 / shares.max())


def test_rows_of_the_residual_change_as_its_states_do() -> None:
    """The row of x is ``x+ - x - h vx+``, that of vx ``2 (vx+ - vx) - h F - p``."""
    problem, sizes = resting(), np.array([0.3, 0.1, 0.2, 5.0, 0.2, 0.1])
    changes = residual_changes(problem, sizes)
    np.testing.assert_allclose(np.sort(changes), np.sort([0.5, 0.1, 0.2, 10.0, 0.2, 0.1]))


@pytest.mark.parametrize("factor", [1.0, 500.0, 1e5, 1e-5])
def test_stated_sizes_are_doubtful_far_from_those_of_the_data(factor: float) -> None:
    problem = goal_of(resting(), (5.0, np.inf))
    u = float(derive_sizes(problem).u[0])
    doubts = doubtful_sizes(replace(problem, scaling=Scaling(u=factor * u)))
    assert bool(doubts) == (factor in (1e5, 1e-5))
    assert all(doubt.startswith(f"u is {factor:.2g} times") for doubt in doubts)
