"""Closed forms of the gradient scenes agree with event-driven integration, worlds with the closed forms."""

from __future__ import annotations

import sys
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from ocp.errors import InputError
from problems.gradient_scenes import SCENES, Mechanics, Scene
from problems.gradient_scenes.cases import gradient_case
from problems.gradient_scenes.scene import GRAVITY
from problems.gradient_scenes.scenes import HEIGHT_M
from problems.gradient_scenes.worlds import WORLDS, scene_world

TIGHT = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-13, "max_step": 0.02}


class EventDriven:
    """Rigid motion of a scene by integration between events: impacts, the end of sliding, the end of contact."""

    def __init__(self, scene: Scene, theta: float) -> None:
        m: Mechanics = scene.mechanics
        self.scene, self.m, self.M = scene, m, m.table[3]
        q, v = ca.SX.sym("q", len(self.M)), ca.SX.sym("v", len(self.M))
        distance = m.distance(q)
        sliding = ca.SX(0, len(self.M)) if m.sliding is None else m.sliding(q)
        self.f = ca.Function("f", [q, v], [m.force(q), distance, ca.jacobian(distance, q), sliding])
        self.push = np.zeros(len(self.M)) if m.is_speed else theta * m.table[2]
        speed = theta * m.table[2] if m.is_speed else 0.0
        self.x = np.concatenate([m.table[0], m.table[1] + speed])

    def parts(self, x):
        n = len(self.M)
        force, distance, J, T = (np.array(part) for part in self.f(x[:n], x[n:]))
        return force.ravel() + self.push, float(distance[0, 0]), J, T

    def acceleration(self, x, touching, direction):
        """Return dv/dt and the normal force; in contact J dv/dt = 0, friction is against ``direction``, 0 in stick."""
        force, _, J, T = self.parts(x)
        if not touching:
            return force / self.M, 0.0
        rows = [J[0]] + ([T[0]] if len(T) and direction == 0 else [])
        along = [J[0] - self.m.friction * direction * T[0] if len(T) and direction else J[0]]
        along += [T[0]] if len(rows) == 2 else []
        A = np.array(rows) @ (np.array(along) / self.M).T
        normal = np.linalg.solve(A, -np.array(rows) @ (force / self.M))
        if len(rows) == 2 and abs(normal[1]) > self.m.friction * normal[0]:
            return self.acceleration(x, True, float(np.sign(T[0] @ (force / self.M))))
        return (force + normal @ np.array(along)) / self.M, normal[0]

    def impact(self):
        """Apply Newton's normal impulse and Coulomb's tangential one."""
        n = len(self.M)
        _, _, J, T = self.parts(self.x)
        v = self.x[n:]
        p = -(1 + self.m.restitution) * (J[0] @ v) / (J[0] @ (J[0] / self.M))
        v += J[0] / self.M * p
        if len(T):
            stop = (T[0] @ v) / (T[0] @ (T[0] / self.M))
            v -= T[0] / self.M * np.clip(stop, -self.m.friction * p, self.m.friction * p)

    def output(self) -> float:
        n, t = len(self.M), 0.0
        touching = self.parts(self.x)[1] <= 0 and self.acceleration(self.x, True, 0.0)[1] > 0
        for _ in range(20):
            slip = self.parts(self.x)[3] @ self.x[n:]
            direction = float(np.sign(slip[0])) if len(slip) and abs(slip[0]) > 1e-9 else 0.0

            def motion(_, x, touching=touching, direction=direction):
                return np.concatenate([x[n:], self.acceleration(x, touching, direction)[0]])

            def hit(_, x, touching=touching):
                return 1.0 if touching else self.parts(x)[1] - 1e-14

            def stop(_, x, direction=direction):
                return float((self.parts(x)[3] @ x[n:])[0]) * direction if direction and len(self.parts(x)[3]) else 1.0

            def leave(_, x, touching=touching, direction=direction):
                return self.acceleration(x, touching, direction)[1] if touching else 1.0

            for event in (hit, stop, leave):
                event.terminal, event.direction = True, -1
            solved = solve_ivp(motion, (t, self.scene.duration), self.x, events=(hit, stop, leave), **TIGHT)
            self.x, t = solved.y[:, -1].copy(), solved.t[-1]
            if solved.status == 0:
                return float(self.x[self.scene.output_index])
            if len(solved.t_events[0]):
                self.impact()
                touching = self.m.restitution == 0 and self.acceleration(self.x, True, 0.0)[1] > -1e-9
                # No force presses the balls in line together; they stay together without it.
            elif len(solved.t_events[2]):
                touching = False
        raise AssertionError("too many events")


@pytest.mark.one_case_in(9)
@pytest.mark.parametrize("name", SCENES)
def test_closed_forms_are_the_event_driven_motion(name: str) -> None:
    scene = SCENES[name]
    theta = scene.theta * np.array([0.9, 1.0, 1.07])
    exact = scene.truth.rollout(theta[:, None])[:, 0]
    motion = [EventDriven(scene, value).output() for value in theta]
    np.testing.assert_allclose(motion, exact, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize("name", SCENES)
def test_slopes_are_derivatives_of_the_closed_forms(name: str) -> None:
    """Richardson's extrapolation of central differences, on both sides of thresholds, away from them."""
    scene = SCENES[name]
    theta, a = scene.theta * np.array([0.8, 1.0, 1.09]), 1e-4 * abs(scene.theta)
    outcome = [scene.truth.rollout((theta + b)[:, None])[:, 0] for b in (a, -a, a / 2, -a / 2)]
    slope = (4 * (outcome[2] - outcome[3]) / a - (outcome[0] - outcome[1]) / (2 * a)) / 3
    np.testing.assert_allclose(scene.truth.gradient(theta[:, None])[:, 0, 0], slope, rtol=1e-8, atol=1e-9)


def test_names_are_checked() -> None:
    assert set(WORLDS) > {"exact", "barrier", "adaptive", "randomized", "penalty", "mujoco"}
    for arguments, message in (
        (("two-ball",), "did you mean 'two-balls'"),
        (("two-balls", ["exakt"]), "did you mean 'exact'"),
        (("two-balls", ["exact"], {"stiffness": 1.0}), "no simulator has a setting 'stiffness'"),
        (("two-balls", ["exact"], {"h": 0.0}), "h must be > 6e-06 and <= 0.6"),
        (("two-balls", ["barrier"], {"mu": -1.0}), "mu must be > 0, got -1"),
        (("two-balls", ["exact", "exact"]), "named twice"),
        (("two-balls", (), {}, 1), "choose entries of a file, and two-balls is none"),
    ):
        with pytest.raises(InputError, match=message):
            gradient_case(*arguments)


@pytest.mark.parametrize("world", ["mjx", "mjx-reverse"])
def test_a_world_that_is_not_installed_says_what_to_install(monkeypatch: pytest.MonkeyPatch, world: str) -> None:
    monkeypatch.setitem(sys.modules, "mujoco.mjx", None)
    with pytest.raises(InputError, match=r"needs the package mujoco-mjx; install 'centralpath\[mjx\]'"):
        scene_world(SCENES["two-balls"], world)


def test_mujoco_falls_as_the_closed_form_and_differentiates_free_flight() -> None:
    """Before the impact MuJoCo's output and derivative are those of semi-implicit steps, z = v T - g T (T + h)/2."""
    pytest.importorskip("mujoco")
    scene = replace(SCENES["bounce"], duration=0.1)
    world, v = scene_world(scene, "mujoco"), np.array([[-1.0], [0.5]])
    expected = HEIGHT_M + v * 0.1 - GRAVITY * 0.1 * (0.1 + world.settings["h"]) / 2
    np.testing.assert_allclose(world.rollout(v), expected, rtol=1e-9)
    np.testing.assert_allclose(world.gradient(v)[:, 0, 0], 0.1, rtol=1e-6)


def test_mujoco_differentiates_a_constant_force() -> None:
    """A force F on a free ball of mass m moves it by F T (T + h)/(2 m)."""
    pytest.importorskip("mujoco")
    scene = replace(SCENES["push-from-afar"], output_index=0)
    world = scene_world(scene, "mujoco")
    slope = scene.duration * (scene.duration + world.settings["h"]) / (2 * scene.mechanics.coordinates[0].mass)
    np.testing.assert_allclose(world.rollout(np.array([[1.0]])), slope, rtol=1e-9)
    np.testing.assert_allclose(world.gradient(np.array([[1.0]]))[0, 0, 0], slope, rtol=1e-6)
