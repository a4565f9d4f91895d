"""Bodies on a table: the ellipsoidal limit surface, pressure, and pushed motions."""

from __future__ import annotations

import math

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import dblquad

from dynamics.batch import StepFunction
from dynamics.contact import Exact
from dynamics.systems import ContactSystem, ParameterTable
from dynamics.systems.shapes.areas import mean_distance
from ocp.errors import InputError
from ocp.problem.evaluation import Evaluation
from ocp.problem.problem import Problem, Scaling
from ocp.search.near_steps import NearSteps
from problems.scenes import Body, Box, Capsule, Disc, Pusher, Scene, Union

F, REACH, H = 0.4 * 2.0 * 9.81, 0.08, 0.05


def number(value: ca.SX) -> float:
    return float(ca.DM(ca.evalf(value)))


def test_mean_distances_are_those_of_closed_forms() -> None:
    """A disc has 2 R / 3 and a square a (sqrt 2 + ln(1 + sqrt 2)) / 6; other shapes have limits or integrals."""
    assert number(mean_distance(Disc(0.3, (1.0, 2.0)))) == pytest.approx(0.2, abs=1e-12)
    square = (math.sqrt(2) + math.log(1 + math.sqrt(2))) / 6
    assert number(mean_distance(Box((0.5, 0.5)))) == pytest.approx(square, abs=1e-9)

    def edge(x: float) -> float:
        return 0.5 if x < 0.3 else 0.3 + math.sqrt(0.04 - (x - 0.3) ** 2)

    inside, size = (dblquad(f, 0, 0.5, 0, edge, epsabs=1e-7)[0] for f in (math.hypot, lambda y, x: 1.0))
    rounded = number(mean_distance(Box((0.5, 0.5), 0.2)))
    assert rounded == pytest.approx(inside / size, abs=1e-5)
    long = number(mean_distance(Capsule((-50.0, 0.0), (50.0, 0.0), 1e-3)))
    assert long == pytest.approx(25.0, rel=1e-4), "a rod has a quarter of its length"
    apart = number(mean_distance(Union([Disc(1e-3, (-1.0, 0.0)), Disc(1e-3, (1.0, 0.0))])))
    assert apart == pytest.approx(1.0, rel=1e-5)


def pushed(
    rail: tuple[float, float] = (1.0, 0.0),
    at: tuple[float, float] = (-0.2, 0.0),
    inertial: bool = False,
    stiffness: float = 1e3,
    friction: float = 0.0,
    turns: bool = True,
) -> ContactSystem:
    """Return the system of a box of 0.3 m on a table, beside a finger on a rail."""
    inertia = 0.03 if turns else None
    box = Body("box", Box((0.15, 0.15)), (0, 0), mass=2.0, inertia=inertia, table=0.4, reach=REACH)
    finger = Pusher("finger", Disc(0.05), at=at, stiffness=stiffness, axis=rail)
    scene = Scene([finger, box], friction=friction)
    return scene.quasi_dynamic("pushed", ParameterTable(()), h=H, inertial=inertial)


def step(system: ContactSystem, x: list[float], u: float) -> tuple[np.ndarray, np.ndarray]:
    found = Exact().close(system).solve(np.array(x), np.array([u]), np.zeros(0))
    assert float(np.max(found[3])) <= 1e-7
    return np.array(found[0]).ravel(), np.array(found[1]).ravel()


@pytest.mark.parametrize("turns", [True, False])
def test_a_push_within_the_limit_surface_moves_nothing(turns: bool) -> None:
    """With a spring of 1000 N/m the box sticks up to about 7.8 mm, and then moves by the excess."""
    system, start = pushed(turns=turns), [0.0] * (4 if turns else 3)
    held = F / 1e3
    little, _ = step(system, start, 0.99 * held)
    assert np.abs(little).max() < 1e-9
    much, lam = step(system, start, 0.05)
    assert lam[0] / H == pytest.approx(F, rel=1e-6)
    k = 3 if turns else 2
    assert much[0] == pytest.approx(0.05 - held, abs=1e-7)
    assert np.abs(much[1:k]).max() < 1e-9, "through the middle it goes straight"


@pytest.mark.parametrize("offset", [0.02, 0.05, 0.1])
def test_an_eccentric_push_turns_about_lynchs_centre(offset: float) -> None:
    """For a force with the lever d, omega / v = d / reach², and the scaled force lies on the ellipsoid."""
    x, lam = step(pushed(at=(-0.2, offset)), [0.0] * 4, 0.03)
    assert -x[2] / x[0] == pytest.approx(offset / REACH**2, rel=1e-6)
    assert lam[0] / H == pytest.approx(F / math.hypot(1, offset / REACH), rel=1e-6)


@pytest.mark.costly
@settings(max_examples=25, deadline=None)
@given(st.floats(-0.14, 0.14), st.floats(0.01, 0.05), st.booleans())
def test_the_table_takes_as_much_as_it_can(offset: float, way: float, inertial: bool) -> None:
    """Of all wrenches within the ellipsoid the acting one dissipates the most, F times the slip."""
    x, lam = step(pushed(at=(-0.2, offset), inertial=inertial), [0.0] * 4, way)
    q = x[:3] * [1, 1, REACH]
    J = np.array([1.0, 0.0, -offset / REACH])
    M = np.array([2.0, 2.0, 0.03 / REACH**2])
    wrench = lam[0] / H * J - inertial * M * q / H**2
    slip = float(np.linalg.norm(q))
    assert np.linalg.norm(wrench) <= F * (1 + 1e-6)
    assert wrench @ q == pytest.approx(F * slip, abs=1e-6)
    assert lam[-1] == pytest.approx(slip, abs=1e-6)


def test_inertia_only_delays() -> None:
    """With inertia the same push moves the box less, by the impulse that accelerates it."""
    still, lam = step(pushed(inertial=False, turns=False), [0.0] * 3, 0.05)
    slow, more = step(pushed(inertial=True, turns=False), [0.0] * 3, 0.05)
    assert slow[0] < still[0]
    assert more[0] - 2.0 * slow[0] / H == pytest.approx(lam[0], abs=1e-7)


@pytest.mark.costly
@pytest.mark.cheap_cases("False")
@pytest.mark.parametrize("inertial", [False, True])
def test_batches_and_the_search_step_as_one_step_does(inertial: bool) -> None:
    """For 25 random pushes the batch engine and the search's step agree with the exact step."""
    system = pushed(at=(-0.2, 0.04), inertial=inertial)
    draws = np.random.default_rng(3).uniform(0.0, 0.03, 25)
    alone = np.array([step(system, [0.0] * 4, u)[0] for u in draws])
    zeros = np.zeros((25, 4))
    for backend in ("numpy", "c"):
        found = StepFunction(Exact().close(system), backend)(zeros, draws[:, None])
        np.testing.assert_allclose(found.x_next, alone, atol=1e-9)
    problem = Problem(
        "pushed",
        system,
        N=1,
        x0=ca.SX.zeros(4),
        stage_cost=ca.SX(0),
        terminal_cost=ca.sumsqr(system.x),
        parameters=ParameterTable(()),
        scaling=Scaling(impulse=0.1, gap=0.01),
    )
    near = NearSteps(Evaluation(problem, {}), system)(zeros, draws[:, None])
    np.testing.assert_allclose(near, alone, atol=2e-6)


def test_bad_tables() -> None:
    with pytest.raises(ValueError, match="table"):
        Body("box", Box((0.1, 0.1)), (0, 0), table=-1.0)
    with pytest.raises(ValueError, match="give table as well"):
        Body("box", Box((0.1, 0.1)), (0, 0), reach=0.1)
    finger = Pusher("finger", Disc(0.05), at=(-0.5, 0), stiffness=10.0, mass=1.0)
    scene = Scene([finger, Body("box", Box((0.1, 0.1)), (0, 0))])
    with pytest.raises(InputError, match="give it a table"):
        scene.quasi_dynamic("s", ParameterTable(()), h=H, inertial=False)
    lying = Scene([finger, Body("box", Box((0.1, 0.1)), (0, 0), table=0.3)])
    with pytest.raises(InputError, match=r"only Scene.quasi_dynamic supports"):
        lying.time_stepping("s", ParameterTable(()), h=H)
