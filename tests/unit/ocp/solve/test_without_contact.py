"""Systems without contacts and limits: optima from linear algebra, under every law and method."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from dynamics.contact import Adaptive, Barrier, Exact, Randomized
from dynamics.systems import (
    Link,
    Machine,
    Parameter,
    ParameterTable,
    Sphere,
    signals,
    time_stepping,
)
from ocp import Direct, Feedback, MultipleShooting, SingleShooting, solve
from ocp.mpc.controller import Controller
from ocp.mpc.simulate import simulate
from ocp.problem.problem import Problem, Scaling

H, N, WEIGHT = 0.1, 20, 100.0
LAWS = [Exact(), Barrier(mu=1e-3), Adaptive(sigma=0.1), Randomized(sigma=0.1)]
METHODS = [Direct(), MultipleShooting(), SingleShooting()]


def free_mass() -> Problem:
    """Return the problem of moving 1 kg by 1 m to rest: ``min sum u² + 100 (x_N - 1)² + 100 v_N²``."""
    p = ParameterTable([Parameter("h", H, "s")])
    system = time_stepping(
        "free mass",
        states=signals("x [m]; v [m/s]"),
        inputs=signals("u [N]"),
        contacts=(),
        h=p["h"],
        mass=1.0,
        impulse=lambda q, v, u: p["h"] * u,
        distance=lambda q: ca.SX(0, 1),
        parameters=p,
    )
    end = WEIGHT * ((system.x[0] - 1) ** 2 + system.x[1] ** 2)
    return Problem("free mass", system, N, system.u**2, end, ca.SX([0, 0]), p)


def quadratic_program() -> tuple[float, np.ndarray]:
    """Return the cost ``b' (I/100 + G G')^-1 b`` and the inputs of ``min |u|² + 100 |G u - b|²``."""
    # u_k changes v by h, and x by h² in each of the N - k steps from k on.
    G = np.array([H**2 * np.arange(N, 0, -1), np.full(N, H)])
    b = np.array([1.0, 0.0])
    y = np.linalg.solve(np.eye(2) / WEIGHT + G @ G.T, b)
    return float(b @ y), G.T @ y


@pytest.mark.cheap_cases("single-shooting-adaptive")
@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)
@pytest.mark.parametrize("method", METHODS, ids=lambda method: method.name)
def test_a_free_mass_takes_the_optimum_of_its_quadratic_program(law, method) -> None:
    found = solve(free_mass(), contact=law, method=method, effort="quick")
    cost, u = quadratic_program()
    assert found.success
    assert found.cost == pytest.approx(cost, rel=1e-8)
    assert found.certificate.stationarity == "KKT"
    np.testing.assert_allclose(found.data["u"].values[0, :, 0], u, atol=1e-5)
    assert found.referee.survives
    assert "contact" not in found.verdict
    assert "gap" not in found.verdict


def test_gains_without_contact_reach_the_same_optimum() -> None:
    found = solve(free_mass(), contact=Exact(), policy=Feedback())
    assert found.success
    assert found.cost == pytest.approx(quadratic_program()[0], rel=1e-6)


def test_the_closed_loop_of_a_free_mass_follows_its_plan() -> None:
    """With the whole horizon ahead and no disturbance the first input is that of the plan."""
    loop = simulate(Controller(free_mass()), 3)
    u = loop.data["u"].values.ravel()
    assert u[0] == pytest.approx(quadratic_program()[1][0], rel=1e-4)


def test_a_machine_without_spheres_swings_like_a_pendulum() -> None:
    """One step of a rod of 1 kg at 0.5 m agrees with ``I a = -m g l sin(q)`` by hand."""
    p = ParameterTable([Parameter("h", 0.01, "s")])
    rod = Link("rod", None, mass=1.0, inertia=0.02, com=(0, -0.5), gear=1.0)
    system = Machine(links=(rod,), spheres=()).system("rod", p, h=p["h"], friction=0.0)
    step = Exact().close(system)
    x_next = np.array(step.solve([0.4, 0.0], [0.0], [0.01])[0]).ravel()
    v = -0.01 * 9.81 * 0.5 * np.sin(0.4) / (0.02 + 0.25)
    np.testing.assert_allclose(x_next, [0.4 + 0.01 * v, v], rtol=1e-9)


def fixed_gap(gap: float) -> Problem:
    p = ParameterTable([Parameter("h", H, "s")])
    system = time_stepping(
        "fixed",
        states=signals("x [m]; v [m/s]"),
        inputs=signals("u [N s]"),
        contacts=signals("wall [N s]"),
        h=p["h"],
        mass=1.0,
        impulse=lambda q, v, u: u,
        distance=lambda q: 0 * q + gap,
        parameters=p,
    )
    return Problem(
        "fixed", system, 5, system.u**2, (system.x[0] - 1) ** 2, ca.SX([0, 0]), p, scaling=Scaling(impulse=1.0, gap=0.1)
    )


@pytest.mark.cheap_cases("barrier")
@pytest.mark.parametrize("law", LAWS[:2], ids=lambda law: law.name)
def test_a_contact_that_never_closes_changes_nothing(law) -> None:
    """The minimum of ``|u|² + (G u - 1)²`` is ``1 / (1 + |G|²)``."""
    found = solve(fixed_gap(0.5), contact=law)
    G = H * np.arange(5, 0, -1)
    assert found.success
    assert found.cost == pytest.approx(1 / (1 + G @ G), rel=1e-6)
    assert found.referee.survives


@pytest.mark.parametrize("gap", [0.0, -0.1])
def test_a_contact_that_is_closed_in_every_state_is_refused(gap: float) -> None:
    with pytest.raises(ValueError, match="leave the contact out"):
        fixed_gap(gap)


def test_a_tip_straight_below_its_hinge_is_advanced() -> None:
    """In this state no impulse opens or closes the contact, whose compliance is zero."""
    p = ParameterTable([Parameter("h", 0.05, "s")])
    rod = Link("rod", None, mass=0.3, inertia=1e-3, com=(0, -0.3), anchor=(0, 0.5), gear=1.0)
    machine = Machine(links=(rod,), spheres=(Sphere("tip", "rod", (0, -0.4), 0.05),))
    step = Exact().close(machine.system("rod", p, h=p["h"], friction=0.5))
    x_next, lam, gap, error = (np.array(v).ravel() for v in step.solve([0, 0], [0], [0.05]))
    assert error.max() < 1e-9
    np.testing.assert_allclose(x_next, 0, atol=1e-12)
    assert lam[0] == 0
    assert gap[0] == pytest.approx(0.05)


@pytest.mark.cheap_cases("full")
@pytest.mark.parametrize("phase", ["qpcc", "qp", "policy", "full"])
def test_the_closed_loop_of_a_machine_without_contacts_swings_like_its_plan(phase: str) -> None:
    """The rod's inertia depends on its state, so that no step is linear in the next state."""
    p = ParameterTable([Parameter("h", 0.05, "s")])
    cart = Link("cart", None, mass=1.0, inertia=1.0, joint="slide", axis=(1, 0), gear=10.0)
    rod = Link("rod", "cart", mass=0.3, inertia=1e-3, com=(0, -0.5))
    system = Machine(links=(cart, rod), spheres=()).system("rod", p, h=p["h"], friction=None)
    x, u = system.x, system.u
    problem = Problem("rod", system, 4, u**2 + ca.sumsqr(x), ca.sumsqr(x), ca.SX([0, 0.5, 0, 0]), p)
    assert not system.is_lcp
    plan = solve(problem, effort="quick")
    loop = simulate(Controller(problem, phase=phase), 1)
    assert loop.data["u"].values.ravel() == pytest.approx(plan.data["u"].values[0, 0], abs=1e-4)
    assert loop.data["x"].values[0, 1] == pytest.approx(plan.data["x"].values[0, 1], abs=1e-5)
