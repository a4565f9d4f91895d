"""Gravity in any direction, and fixed parts: both descriptions of a slope give the same motion."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from dynamics.contact import Exact
from dynamics.systems import WORLD, ContactSystem, Link, Machine, ParameterTable, Part, Sphere
from dynamics.systems.shapes import Box, HalfPlane
from problems import drawing
from problems.machines.machine import machine_shapes

H, G, TILT = 0.01, 9.81, 0.4
BALL = Link("ball", None, mass=2.0, inertia=0.05, joint="free")
SPHERE = Sphere("rim", "ball", (0.0, 0.0), 0.2)
DOWN, UP = (np.sin(TILT), -np.cos(TILT)), (np.sin(TILT), np.cos(TILT))


def system(machine: Machine, spheres: tuple[str, ...] = ("rim",)) -> ContactSystem:
    return machine.system("ball", ParameterTable(), h=H, friction=0.2, spheres=spheres)


def rolled(of: ContactSystem, x: np.ndarray, steps: int = 40) -> np.ndarray:
    step, found = Exact().close(of), [x]
    for _ in range(steps):
        found.append(np.array(step.solve(found[-1], [], step.p.values)[0]).ravel())
    return np.array(found)


def test_gravity_is_an_acceleration_of_any_direction() -> None:
    """Without contact every step adds h g to the velocity."""
    falls = rolled(system(Machine((BALL,), (SPHERE,), gravity=(1.0, -2.0))), np.eye(6)[1] * 9.0, 5)
    np.testing.assert_allclose(falls[5, 3:], [5 * H, -10 * H, 0.0], atol=1e-13)


def test_a_slope_of_the_world_is_the_ground_under_tilted_gravity() -> None:
    """A ball falls on the slope, slides and begins to roll, equally in the slope's axes under tilted gravity."""
    tilted = Machine((BALL,), (SPHERE,), gravity=(G * DOWN[0], G * DOWN[1]))
    slope = Machine(
        (BALL,),
        (SPHERE,),
        parts=(Part("slope", WORLD, HalfPlane(normal=UP)),),
        collision_pairs=(("slope", "rim"),),
    )
    turn = np.array([[UP[1], UP[0]], [-UP[0], UP[1]]])
    start = np.array([0.0, 0.23, 0.0, 0.1, 0.0, 0.0])
    turned = np.array([*turn @ start[:2], 0.0, *turn @ start[3:5], 0.0])
    flat, steep = rolled(system(tilted), start), rolled(system(slope, ()), turned)
    np.testing.assert_allclose(steep[:, :2], flat[:, :2] @ turn.T, atol=1e-9)
    np.testing.assert_allclose(steep[:, 5], flat[:, 5], atol=1e-8)
    assert flat[-1, 5] > 0.1, "it turns"


def test_the_book_counts_the_world_as_outside() -> None:
    """Momentum changes by the impulses of weight and wall."""
    wall = Part("wall", WORLD, Box((0.1, 1.0)))
    machine = Machine((BALL,), (SPHERE,), parts=(wall,), collision_pairs=(("rim", "wall"),))
    built = system(machine, ())
    step, book = Exact().close(built), built.energy_balance
    assert book is not None
    values = ca.Function("book", [built.x, built.u, built.x_next, built.lam], [book.momentum, book.external])
    x = np.array([0.31, 0.5, 0.0, -2.0, 0.0, 3.0])
    x_next, lam, *_ = (np.array(v).ravel() for v in step.solve(x, [], step.p.values))
    assert lam[0] > 1.0
    before, external = (np.array(v).ravel() for v in values(x, [], x_next, lam))
    np.testing.assert_allclose(np.array(values(x_next, [], x_next, lam)[0]).ravel() - before, external, atol=1e-11)


def test_what_has_no_shape_is_drawn_as_the_rod_of_its_inertia() -> None:
    """A rod of length L has the inertia m L²/12, here with L = 0.6 m and its middle at 0.3 m."""
    rod = Link("rod", None, mass=2.0, inertia=2.0 * 0.6**2 / 12, com=(0.3, 0.0))
    machine = Machine((rod,), (), parts=(Part("step", WORLD, Box((0.2, 0.1))),))
    shapes = machine_shapes(machine, np.zeros(2))
    (bar,) = (shape for shape in shapes if isinstance(shape, drawing.Stadium))
    assert (bar.x1, bar.x2) == pytest.approx((0.0, 0.6), abs=1e-12)
    assert drawing.Rectangle(0.0, 0.0, 0.4, 0.2, 0.0, "environment") in shapes


def test_a_link_is_not_the_world() -> None:
    with pytest.raises(ValueError, match="which never moves"):
        Machine((Link(WORLD, None, 1.0, 0.1),), ())
    with pytest.raises(ValueError, match="gravity must be two numbers"):
        Machine((BALL,), (), gravity=(1.0, 2.0, 3.0))  # pyright: ignore
