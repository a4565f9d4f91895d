"""Steps with several solutions: all that enumeration finds are found, and no other if it is unique."""

from __future__ import annotations

from itertools import product

import casadi as ca
import numpy as np
import pytest

from dynamics.contact import Exact
from dynamics.systems import Parameter, ParameterTable, lcs, signals, time_stepping
from ocp import Direct, solve
from ocp.judge.referee import referee_plan
from ocp.judge.step_solutions import Nonuniqueness, find_nonuniqueness
from ocp.problem.evaluation import Evaluation
from ocp.problem.problem import Problem, Scaling
from ocp.problem.rollout import roll_out
from problems import get
from tests.unit.ocp.user_problems import at_defaults, defaults, trajectories


def coupled(F: np.ndarray, d: np.ndarray, N: int = 1) -> Problem:
    """Return a problem with ``x+ = lam``, ``0 <= lam ⟂ F lam + d + u >= 0``, whose next states are multipliers."""
    n = len(d)
    system = lcs(
        "coupled",
        A=np.zeros((n, n)),
        B=np.zeros((n, 1)),
        C=np.eye(n),
        D=np.zeros((n, n)),
        E=np.ones((n, 1)),
        F=F,
        d=d,
    )
    return Problem(
        name="coupled",
        system=system,
        N=N,
        stage_cost=system.u**2,
        terminal_cost=ca.sumsqr(system.x),
        x0=ca.SX.zeros(n),
        parameters=ParameterTable(),
        u_lower=-1,
        u_upper=1,
        scaling=Scaling(impulse=1.0, gap=100.0, x=1.0, u=1.0),
    )


def enumerated(F: np.ndarray, d: np.ndarray) -> list[np.ndarray]:
    """Return all solutions of ``0 <= lam ⟂ F lam + d >= 0``, from its ``2^n`` systems of equations."""
    solutions = []
    for active in product([False, True], repeat=len(d)):
        rows, lam = np.flatnonzero(active), np.zeros(len(d))
        lam[rows] = np.linalg.solve(F[np.ix_(rows, rows)], -d[rows])
        if min(lam.min(), (F @ lam + d).min()) > -1e-12:
            solutions.append(lam)
    return solutions


def others_of(problem: Problem, lam: np.ndarray) -> Nonuniqueness | None:
    """Return the other solutions of the first step from zero to x = lam without input, or None."""
    x = np.stack([np.zeros_like(lam), lam])[None]
    return find_nonuniqueness(at_defaults(problem), trajectories(x, np.zeros((1, 1, 1)), lam[None, None]))


def distinct(ends: np.ndarray) -> np.ndarray:
    return np.unique(ends.round(6) + 0.0, axis=0)


def test_a_pair_of_contacts_that_lift_each_other_off_has_two_ends() -> None:
    """Solutions are lam = 0 and lam = (1, 1); F is not a P-matrix, since det F = -3."""
    F, d = np.array([[1.0, -2.0], [-2.0, 1.0]]), np.ones(2)
    found = others_of(coupled(F, d), np.zeros(2))
    assert found is not None and (found.step, found.scenario, found.steps) == (0, 0, 1)
    np.testing.assert_allclose(distinct(found.x_next), [[1.0, 1.0]], atol=1e-9)
    back = others_of(coupled(F, d), np.ones(2))
    assert back is not None
    np.testing.assert_allclose(distinct(back.x_next), [[0.0, 0.0]], atol=1e-9)


@pytest.mark.costly_cases("1.0")
@pytest.mark.parametrize("stiff", [1.0, 1e6])
def test_all_solutions_of_random_matrices_are_found(stiff: float) -> None:
    """Each matrix couples five contacts, one of which may be stiff, and has 2^5 systems of equations."""
    rng, several = np.random.default_rng(4), 0
    for _ in range(40):
        F, d = rng.normal(size=(5, 5)) + 0.5 * np.eye(5), rng.normal(size=5)
        F[0, 0] = F[0, 0] * stiff
        solutions = enumerated(F, d)
        if not solutions:
            continue
        found = others_of(coupled(F, d), solutions[0])
        expected = [lam for lam in solutions if np.abs(lam - solutions[0]).max() > 1e-2]
        ends = np.zeros((0, 5)) if found is None else found.x_next
        np.testing.assert_allclose(distinct(ends), distinct(np.reshape(expected, (-1, 5))), atol=1e-5)
        several += len(expected) > 0
    assert several > 5


def test_a_step_with_one_solution_has_no_other() -> None:
    """The step is unique if F is a P-matrix, symmetric or not, or if only the forces are ambiguous."""
    rng = np.random.default_rng(5)
    for _ in range(30):
        L, skew = rng.normal(size=(2, 4, 4))
        F, d = L @ L.T + 0.1 * np.eye(4) + skew - skew.T, rng.normal(size=4)
        (lam,) = enumerated(F, d)
        assert others_of(coupled(F, d), lam) is None
    # Two contacts push in the same direction: their shares are ambiguous, but the next state is unique.
    system = lcs(
        "twins",
        A=[[0.0]],
        B=[[0.0]],
        C=[[1.0, 1.0]],
        D=[[0.0], [0.0]],
        E=[[0.0], [0.0]],
        F=np.ones((2, 2)),
        d=-np.ones(2),
    )
    twins = Problem(
        name="twins",
        system=system,
        N=1,
        stage_cost=system.u**2,
        terminal_cost=ca.SX(0),
        x0=ca.SX(0),
        parameters=ParameterTable(),
        scaling=Scaling(1.0, 1.0),
    )
    x, lam = np.array([[[0.0], [1.0]]]), np.array([[[0.3, 0.7]]])
    assert find_nonuniqueness(at_defaults(twins), trajectories(x, np.zeros((1, 1, 1)), lam)) is None


def rod(friction: float, slip: float, rise: float, h: float = 0.01) -> Problem:
    """Return a problem of a rod of 2 m and 1 kg at 60 degrees that slides on its tip: Painlevé's paradox.

    ``slip`` and ``rise`` [m/s] are the velocities of the tip along and across the floor.
    """
    p = ParameterTable([Parameter("h", h, "s"), Parameter("friction", friction)])
    system = time_stepping(
        "rod",
        states=signals("x [m]; y [m]; a [rad]; vx [m/s]; vy [m/s]; w [rad/s]"),
        inputs=signals("u [N]"),
        contacts=signals("tip [N s]"),
        h=p["h"],
        mass=ca.diag(ca.SX([1.0, 1.0, 1 / 3])),
        impulse=lambda q, v, u: ca.vertcat(0 * u, 0, 0),
        distance=lambda q: q[1] - ca.sin(q[2]),
        linearised=True,
        sliding=lambda q: ca.horzcat(1, 0, ca.sin(q[2])),
        friction=p["friction"],
        parameters=p,
    )
    x0 = [0.0, np.sin(np.pi / 3), np.pi / 3, slip, rise, 0.0]
    return Problem(
        name="rod",
        system=system,
        N=2,
        stage_cost=system.u**2,
        terminal_cost=system.x[0] ** 2,
        x0=ca.SX(x0),
        parameters=p,
        scaling=Scaling(impulse=1.0, gap=0.1, x=1.0, u=1.0),
    )


def test_painleves_rod_lifts_off_slides_or_jams() -> None:
    """For ``A = 1 + 3 c² - 3 f s c < 0`` a rising tip may lift off, keep sliding, or stop at once."""
    f, slip, rise, c, s = 2.0, -5.0, 0.1, 0.5, np.sqrt(0.75)
    nn, nt, tt = 1 + 3 * c * c, -3 * s * c, 1 + 3 * s * s
    slides = -rise / (nn + f * nt)
    jams = np.linalg.solve([[nn, nt], [nt, tt]], [-rise, -slip])
    assert slides > 0 and slip + (nt + f * tt) * slides < 0 and abs(jams[1]) < f * jams[0]
    impulses = np.array([[0.0, 0.0], [slides, f * slides], jams])  # normal, tangential
    v = [slip, rise, 0] + impulses @ np.array([[0, 1, -3 * c], [1, 0, 3 * s]])
    problem = rod(f, slip, rise)
    x0 = problem.initial_states(problem.parameters.values)[0]
    ends = np.column_stack([x0[:3] + 0.01 * v, v])
    lam = np.zeros((1, 1, 4))
    lam[0, 0, 3] = -0.01 * slip
    x = np.stack([x0, ends[0]])[None]
    found = find_nonuniqueness(at_defaults(problem), trajectories(x, np.zeros((1, 1, 1)), lam))
    assert found is not None
    expected = ends[1:][ends[1:, 3].argsort()]
    order = distinct(found.x_next)
    np.testing.assert_allclose(order[order[:, 3].argsort()], expected, atol=1e-5)


@pytest.mark.cheap_cases("1.0--5.0-0.1")
@pytest.mark.parametrize(("friction", "slip", "rise"), [(1.0, -5.0, 0.1), (2.0, 5.0, 0.1)])
def test_a_rod_without_the_paradox_goes_on_in_one_way(friction: float, slip: float, rise: float) -> None:
    """For A > 0, by less friction or sliding in the other direction, the tip can only lift off."""
    problem = rod(friction, slip, rise)
    plan = roll_out(problem, np.zeros((1, 2, 1)), defaults(problem))
    report, _ = referee_plan(at_defaults(problem), problem.exact_step, plan)
    assert report.nonuniqueness == "" and np.isnan(report.branch_cost)
    paradox = rod(2.0, -5.0, rise)
    plan = roll_out(paradox, np.zeros((1, 2, 1)), defaults(paradox))
    report, _ = referee_plan(at_defaults(paradox), paradox.exact_step, plan)
    assert report.nonuniqueness.startswith("the contact forces at step 0 are not unique (tip)")
    assert abs(report.branch_cost - plan.cost) > 1e-5


@pytest.mark.costly
def test_finger_discs_second_end_is_named_with_its_cost() -> None:
    """The tip may leave the disc at step 1; the same torques then cost 27.5."""
    found = solve(get("finger-disc"), Exact(), Direct())
    report = found.referee
    assert report.nonuniqueness.startswith(
        "the contact forces at step 1 are not unique (tip on disc): from the same state and input"
    )
    assert report.branch_cost == pytest.approx(27.5151, rel=1e-4)
    x, u, p = found.data["x"].values, found.data["u"].values, found.problem
    lam = found.data["lam"].values
    other = find_nonuniqueness(Evaluation(p, found.values), trajectories(x, u, lam))
    assert other is not None and not other.replayed
    # Both solutions satisfy the relation: zero residual, nonnegative and complementary lam and gap.
    for end, forces in ((other.x_next[0], other.lam[0]), (x[0, 2], lam[0, 1])):
        residual, gap, _ = p.exact_step.relation(x[0, 1], u[0, 1], end, forces, p.parameters.values)
        assert np.abs(np.array(residual)).max() < 1e-8
        assert min(np.array(gap).min(), forces.min()) > -1e-8
        assert np.abs(np.array(gap).ravel() * forces).max() < 1e-8
    step = p.exact_step.solve.mapaccum(p.N - 2)
    ahead = np.array(step(other.x_next[0], u[0, 2:].T, p.parameters.values)[0]).T
    states = np.vstack([x[0, :2], other.x_next[:1], ahead])
    stage = sum(float(p.cost_terms(states[k], u[0, k], 0, 0, p.parameters.values)[0]) for k in range(p.N))
    end = float(p.cost_terms(states[-1], 0, 0, 0, p.parameters.values)[1])
    assert report.branch_cost == pytest.approx(stage + end, rel=1e-9)


@pytest.mark.parametrize("name", ["box-slide", "cart-transport"])
def test_a_slip_whose_friction_stands_in_its_own_pair_is_searched_too(name: str) -> None:
    """These contacts have no friction pairs in addition to their slip pair."""
    found = solve(get(name, N=1), method="single-shooting")
    assert found.success
    assert not found.route.failures
