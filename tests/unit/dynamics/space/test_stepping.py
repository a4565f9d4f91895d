"""Steps in space agree with closed forms: rest, sliding, rolling, spinning, servos, limits."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from dynamics.contact import Barrier, ContactLaw, Exact
from dynamics.systems import ContactSystem, Parameter, ParameterTable
from dynamics.systems.space import Body, Box, Plane, SpatialMachine, SpatialPart, Sphere

_G, _H = 9.81, 0.01


def _on_plane(shape, inertia: float, normal=(0.0, 0.0, 1.0), mass: float = 2.0) -> SpatialMachine:
    return SpatialMachine(
        (Body("body", None, mass, (inertia,) * 3, joint="free"),),
        (SpatialPart("body", "body", shape), SpatialPart("floor", "world", Plane(normal=normal))),
        (("body", "floor"),),
    )


def _system(machine: SpatialMachine, friction: float = 0.5, h: float = _H, **given) -> ContactSystem:
    p = ParameterTable([Parameter("h", h, "s"), Parameter("friction", friction, "1")])
    return machine.system("test", p, h=p["h"], friction=p["friction"], **given)


def _rolled(
    system: ContactSystem, x: np.ndarray, steps: int, law: ContactLaw | None = None, u=()
) -> tuple[np.ndarray, np.ndarray]:
    """Return states (steps + 1, nx) and impulses (steps, nlam) of a motion from x."""
    step = (law or Exact()).close(system)
    states, impulses = [x], []
    for _ in range(steps):
        x, lam, _, error = (np.array(v).ravel() for v in step.solve(x, u, step.p.values))
        assert error.max() < 1e-9
        states.append(x)
        impulses.append(lam)
    return np.array(states), np.array(impulses)


def _at(z: float, v=(0.0, 0.0, 0.0), w=(0.0, 0.0, 0.0)) -> np.ndarray:
    return np.array([0, 0, z, 1, 0, 0, 0, *v, *w], dtype=float)


@pytest.mark.costly
def test_a_box_at_rest_stands_on_four_corners_alike() -> None:
    system = _system(_on_plane(Box((0.1, 0.1, 0.1)), 0.01))
    x, lam = _rolled(system, _at(0.1), 3)
    # The exact law ends its path at gaps of 3e-11 m, and speeds of that over h.
    assert np.allclose(x, x[0], atol=1e-8)
    lower = [i for i, one in enumerate(system.contacts) if one.name in {f"body on floor {k}" for k in (1, 3, 5, 7)}]
    assert np.allclose(lam[-1, lower], 2.0 * _G * _H / 4, rtol=1e-9)


@pytest.mark.parametrize("edges", [4, 8])
def test_a_point_slides_with_the_deceleration_of_coulomb_along_an_edge(edges: int) -> None:
    """``v+ = v - f g h`` if the motion is along an edge of the pyramid, until the point rests."""
    system = _system(_on_plane(Sphere(0.0), 10.0), friction=0.2, edges=edges)
    x, _ = _rolled(system, _at(0.0, v=(0.1, 0.0, 0.0)), 10)
    expected = np.maximum(0.0, 0.1 - 0.2 * _G * _H * np.arange(11))
    assert np.allclose(x[:, 7], expected, atol=1e-8)
    assert np.allclose(x[:, [1, 4, 5, 6]], 0, atol=1e-8)


@pytest.mark.parametrize(("edges", "least"), [(4, np.sqrt(0.5)), (8, np.cos(np.pi / 8))])
def test_between_edges_the_pyramid_is_weaker_by_its_own_share(edges: int, least: float) -> None:
    """The inscribed pyramid holds ``cos(pi / edges)`` of Coulomb's cone at worst."""
    angle = np.pi / edges
    way = np.array([np.cos(angle), np.sin(angle), 0.0])
    system = _system(_on_plane(Sphere(0.0), 10.0), friction=0.2, edges=edges)
    x, _ = _rolled(system, _at(0.0, v=tuple(map(float, way))), 1)
    assert (1 - x[1, 7:9] @ way[:2]) / (0.2 * _G * _H) == pytest.approx(least, rel=1e-9)


@pytest.mark.parametrize(("friction", "holds"), [(0.74, False), (0.76, True)])
def test_a_slope_of_three_to_four_holds_from_its_own_coefficient_on(friction: float, holds: bool) -> None:
    """A slope that falls along an edge of the pyramid holds a point mass iff f > tan = 0.75."""
    machine = _on_plane(Sphere(0.0), 1.0, normal=(0.6, 0.0, 0.8))
    x, _ = _rolled(_system(machine, friction), _at(0.0), 20)
    moved = np.linalg.norm(x[-1, :3])
    assert moved < 1e-9 if holds else moved > 1e-3


def test_a_ball_rolls_off_with_five_sevenths_of_its_speed() -> None:
    r, m = 0.1, 2.0
    system = _system(_on_plane(Sphere(r), 2 / 5 * m * r * r), friction=0.5)
    x, _ = _rolled(system, _at(r, v=(1.0, 0.0, 0.0)), 30)
    assert x[-1, 7] == pytest.approx(5 / 7, rel=1e-8)
    assert x[-1, 11] == pytest.approx(5 / 7 / r, rel=1e-8)


@pytest.mark.parametrize("h", [0.01, 0.1])
def test_a_spinning_body_never_gains_energy_and_keeps_its_length(h: float) -> None:
    inertia = np.array([0.1, 0.2, 0.25])
    body = Body("body", None, 1.0, tuple(map(float, inertia)), joint="free")
    p = ParameterTable([Parameter("h", h, "s")])
    machine = SpatialMachine((body,), gravity=(0.0, 0.0, 0.0))
    system = machine.system("spin", p, h=p["h"], friction=None)
    step = ca.Function("step", [system.x, p.vector], [system.x_next_expr])
    x = np.array(step.mapaccum(500)(_at(0.0, w=(3.0, 20.0, 1.0)), ca.repmat(h, 1, 500)))
    energies = (inertia[:, None] * x[10:] ** 2).sum(axis=0) / 2
    start = (inertia * np.array([3.0, 20.0, 1.0]) ** 2).sum() / 2
    assert np.all(np.diff(energies, prepend=start) <= 1e-12)
    assert np.abs(np.linalg.norm(x[3:7], axis=0) - 1).max() < 1e-14


def test_the_precession_of_a_symmetric_body_is_that_of_euler_as_h_falls() -> None:
    """In free motion ``omega`` turns about the symmetry axis at the rate ``(I_z - I_x) / I_x omega_z``."""
    off = []
    for h in (0.004, 0.002):
        body = Body("body", None, 1.0, (0.2, 0.2, 0.3), joint="free")
        p = ParameterTable([Parameter("h", h, "s")])
        system = SpatialMachine((body,), gravity=(0.0, 0.0, 0.0)).system("spin", p, h=p["h"], friction=None)
        step = ca.Function("step", [system.x, p.vector], [system.x_next_expr])
        n = round(0.4 / h)
        x = np.array(step.mapaccum(n)(_at(0.0, w=(1.0, 0.0, 4.0)), ca.repmat(h, 1, n)))[:, -1]
        angle = 0.5 * 4.0 * 0.4
        off.append(np.hypot(x[10] - np.cos(angle), x[11] - np.sin(angle)))
    assert off[0] < 0.02 and off[1] / off[0] == pytest.approx(0.5, abs=0.05)


def test_the_barrier_tends_to_the_exact_step_with_mu() -> None:
    system = _system(_on_plane(Sphere(0.1), 0.008))
    start = _at(0.12, v=(1.0, 0.5, -2.0), w=(0.0, 3.0, 1.0))
    exact = _rolled(system, start, 4)[0][-1]
    off = [np.abs(_rolled(system, start, 4, Barrier(mu=mu))[0][-1] - exact).max() for mu in (1e-4, 1e-6, 1e-8)]
    assert off[0] > off[1] > off[2] and off[2] < 1e-4


def test_momentum_and_energy_are_on_the_books() -> None:
    system = _system(_on_plane(Sphere(0.1), 0.008))
    book, forces = system.energy_balance, system.forces
    assert book is not None and forces is not None
    symbols = [system.x, system.u, system.x_next, system.lam, system.parameters.vector]
    after = [ca.substitute(one, system.x, system.x_next) for one in (book.momentum, book.energy)]
    kept = ca.Function("kept", symbols, [after[0] - book.momentum - book.external, after[1] - book.energy - book.work])
    start = _at(0.1, v=(1.0, 0.5, 0.0))
    x, lam = _rolled(system, start, 1)
    off, gained = (np.array(v).ravel() for v in kept(*x[:1], [], x[1], lam[0], [_H, 0.5]))
    assert np.allclose(off, 0, atol=1e-12)
    assert gained[0] < 0


def test_a_servo_pushes_as_far_as_it_is_told_and_forgets_speed() -> None:
    """In the quasi-dynamic model a servo pushes a slider with the balance ``K (u - p) = f m g``."""
    stiffness, m, f = 50.0, 2.0, 0.3
    machine = SpatialMachine(
        (
            Body("cube", None, m, (1e6,) * 3, joint="free"),
            Body("tip", None, 0.0, joint="slide", axis=(1.0, 0.0, 0.0), position=(-0.3, 0.0, 0.0), servo=stiffness),
        ),
        (
            SpatialPart("cube", "cube", Box((0.1, 0.1, 0.1))),
            SpatialPart("foot", "cube", Sphere(0.0)),
            SpatialPart("tip", "tip", Sphere(0.05)),
            SpatialPart("floor", "world", Plane()),
        ),
        (("foot", "floor"), ("tip", "cube")),
    )
    system = _system(machine, f, h=0.2, inertial=False)
    x = np.zeros(system.nx)
    x[3] = 1.0
    x, _ = _rolled(system, x, 40, u=[0.4])
    cube, tip = x[-1, 0], x[-1, 7]
    assert tip - 0.3 + 0.05 == pytest.approx(cube - 0.1, abs=1e-9)
    # It sticks as soon as the push is below friction.
    assert stiffness * (0.4 - tip) == pytest.approx(f * m * _G, rel=1e-4)


def test_joint_limits_stop() -> None:
    machine = SpatialMachine((Body("arm", None, 1.0, (0.1, 0.1, 0.1), com=(0.5, 0.0, 0.0), limits=(-1.0, 0.5)),))
    system = _system(machine)
    x, lam = _rolled(system, np.array([0.49, 3.0]), 60)
    assert x[:, 0].max() <= 0.5 + 1e-12
    held = dict(zip((c.name for c in system.contacts), lam[-1], strict=True))
    # Gravity turns it downward, about +y: the upper limit carries the weight's moment.
    assert held["arm high"] == pytest.approx(_G * 0.5 * np.cos(0.5) * _H, rel=1e-9)


@pytest.mark.parametrize(
    ("given", "sentence"),
    [({"edges": 6}, "edges must be 4 or 8"), ({"cone": "round"}, "cone must be one of")],
)
def test_wrong_steps_are_told(given, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        _system(_on_plane(Sphere(0.1), 0.008), **given)
