"""Scenes under our contact laws, and with penalty springs: rollouts and exact gradients by the batch engine."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from dynamics.contact import Adaptive, Barrier, ContactLaw, Exact, Randomized
from dynamics.systems import ContactSystem, Parameter, ParameterTable, Signal, time_stepping
from ocp.gradients.worlds.plans import along, law_plan
from ocp.gradients.worlds.world import World
from ocp.problem.problem import Problem
from problems.gradient_scenes.scene import Mechanics, Scene

STEP_S = 0.01
"""Step size of time stepping [s]."""
PENALTY_STIFFNESS = 1e4
"""Stiffness of penalty contacts per mass [1/s^2]."""
PENALTY_STEP_S = 1e-3
"""Step size of penalty contacts, a tenth of their shortest period or less [s]."""
PENALTY_SLIP = 0.01
"""Slip velocity at which the friction of penalty contacts reaches Coulomb's limit [m/s]."""
ADAPTIVE_SIGMA_M, RANDOMIZED_SIGMA = 0.001, 0.1
"""Widths of the noise: of the adaptive law [m], and of the randomized law on the input."""
LAWS: dict[str, ContactLaw] = {
    "exact": Exact(),
    "barrier": Barrier(mu=1e-5),
    "adaptive": Adaptive(sigma=ADAPTIVE_SIGMA_M),
    "randomized": Randomized(sigma=RANDOMIZED_SIGMA),
}
"""Mapping from the name of a world to the contact law that closes its scenes."""
_FAR_GAP_M = 1.0
"""Gap of a contact with restitution that is not reached in the next step [m]."""


def law_world(scene: Scene, name: str) -> World:
    """Return the simulator of a scene under the contact law called ``name``, by implicit time stepping."""
    return _world(scene, name, LAWS[name], {"h": STEP_S})


def penalty_world(scene: Scene) -> World:
    """Return the simulator of a scene with spring-damper contacts and regularised friction, by semi-implicit steps.

    ``f = max(-k d - c d', 0)`` for d < 0, with c of the scene's :attr:`~Mechanics.damping_ratio`. The tangential
    force is ``-friction f clip(v/0.01, -1, 1)``.
    """
    return _world(scene, "penalty", Exact(), {"h": PENALTY_STEP_S, "stiffness": PENALTY_STIFFNESS})


def _world(scene: Scene, name: str, law: ContactLaw, values: dict[str, float]) -> World:
    """Return the simulator of a scene under a law; its settings are ``values`` and the parameters of the law."""
    system, mechanics = _system(scene, values), scene.mechanics
    start, output = ca.SX(mechanics.table[:2].ravel()), system.x[scene.output_index]

    @lru_cache
    def rollouts(h: float) -> World:
        profile = np.ones((1, max(1, round(scene.duration / h))))
        if mechanics.is_speed:
            profile = np.eye(1, profile.size) / h
        problem = Problem(scene.name, system, profile.size, ca.SX(0), output, start, system.parameters)
        return along(law_plan(problem, law, values, values), np.zeros(profile.size), profile)

    return replace(
        rollouts(values["h"]),
        name=name,
        simulate=lambda theta, **named: rollouts(named["h"]).at(named).rollout(theta),
        differentiate=lambda theta, **named: rollouts(named["h"]).at(named).gradient(theta),
    )


def _system(scene: Scene, values: dict[str, float]) -> ContactSystem:
    """Return the system of a scene with the parameters ``values``; with a stiffness, contacts are penalties."""
    mechanics, nq = scene.mechanics, len(scene.mechanics.coordinates)
    p = ParameterTable(
        [Parameter(name, value, {"h": "s", "stiffness": "1/s^2"}[name]) for name, value in values.items()]
    )
    h, M, push = p["h"], ca.DM(mechanics.table[3]), ca.DM(mechanics.table[2])
    input_force = M * push if mechanics.is_speed else push
    has_penalty = "stiffness" in values
    if mechanics.restitution > 0 and not has_penalty:
        return _bouncing(scene, p, input_force)

    def impulse(q: ca.SX, v: ca.SX, u: ca.SX) -> ca.SX:
        contact = _penalty_force(mechanics, q, v, p["stiffness"]) if has_penalty else 0.0
        return h * (mechanics.force(q) + input_force * u + contact)

    states, inputs = _signals(nq)
    touching: dict[str, Any] = {"distance": lambda q: ca.SX(0, 1)}
    if not has_penalty:
        touching = {"distance": mechanics.distance, "sliding": mechanics.sliding, "friction": mechanics.friction}
    return time_stepping(
        scene.name,
        states=states,
        inputs=inputs,
        contacts=() if has_penalty else (Signal("contact", "N s"),),
        h=h,
        mass=ca.SX(ca.diag(M)),
        impulse=impulse,
        parameters=p,
        **touching,
    )


def _signals(nq: int) -> tuple[tuple[Signal, ...], tuple[Signal, ...]]:
    states = [Signal(f"{letter}{i}", unit) for letter, unit in (("q", "m"), ("v", "m/s")) for i in range(nq)]
    return tuple(states), (Signal("u", "1", "input"),)


def _penalty_force(mechanics: Mechanics, q: ca.SX, v: ca.SX, stiffness: ca.SX) -> ca.SX:
    """Return the generalised force (nq, 1) of a contact: spring, damper and regularised friction."""
    distance = mechanics.distance(q)
    J = ca.jacobian(distance, q)
    mass = 1 / (J @ ca.diag(1 / ca.DM(mechanics.table[3])) @ J.T)
    spring = mass * (-stiffness * distance - 2 * mechanics.damping_ratio * ca.sqrt(stiffness) * (J @ v))
    normal = ca.if_else(distance < 0, ca.fmax(spring, 0), 0)
    force = J.T @ normal
    if mechanics.sliding is not None and mechanics.friction is not None:
        tangent = mechanics.sliding(q)
        slip = ca.fmax(-1, ca.fmin(1, tangent @ v / PENALTY_SLIP))
        force -= tangent.T @ (mechanics.friction * normal * slip)
    return force


def _bouncing(scene: Scene, p: ParameterTable, input_force: ca.DM) -> ContactSystem:
    """Return the system of Moreau's midpoint steps with Newton's restitution, for a scene with one coordinate.

    ``q_m = q + h v/2``, ``q+ = q_m + h v+/2``; where q_m has penetrated, ``0 <= lam ⟂ h (v+ + e v) >= 0``. The
    impact takes place at a step's midpoint, so that its time is a whole number of steps.
    """
    mechanics, nq, h = scene.mechanics, len(scene.mechanics.coordinates), p["h"]
    x, x_next, u, lam = (ca.SX.sym(name, n) for name, n in (("x", 2 * nq), ("x_next", 2 * nq), ("u", 1), ("lam", 1)))
    q, v, v_next = x[:nq], x[nq:], x_next[nq:]
    middle = q + h / 2 * v
    J = ca.jacobian(mechanics.distance(q), q)
    approach = h * (J @ (v_next + mechanics.restitution * v))
    smooth_impulse = h * (mechanics.force(q) + input_force * u)
    states, inputs = _signals(nq)
    return ContactSystem(
        name=scene.name,
        x=x,
        u=u,
        x_next=x_next,
        lam=lam,
        residual=ca.vertcat(
            x_next[:nq] - middle - h / 2 * v_next,
            ca.DM(mechanics.table[3]) * (v_next - v) - smooth_impulse - J.T @ lam,
        ),
        gap=approach + ca.if_else(mechanics.distance(middle) > 0, _FAR_GAP_M, 0.0),
        states=states,
        inputs=inputs,
        contacts=(Signal("contact", "N s"),),
        h=h,
        parameters=p,
        mu_per_kappa=h,
        refinable=True,
    )
