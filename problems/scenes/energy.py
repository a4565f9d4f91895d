"""Energy and momentum of a scene over one step."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import casadi as ca

from dynamics.systems import EnergyBalance
from dynamics.systems.shapes.planar import Scalar
from problems.scenes.things import Body, Pusher

if TYPE_CHECKING:
    from problems.scenes.scene import Scene

Balance = Callable[[ca.SX, ca.SX, ca.SX, ca.SX, ca.SX, ca.SX], EnergyBalance]
"""Function from (q, v, u, v_next, normal impulses, friction impulses) to the balance of the step."""


def energy_balance(scene: Scene, masses: ca.SX, weight: ca.SX, h: Scalar) -> Balance:
    """Return the function that computes energy and momentum of a scene, as a builder of systems expects it.

    ``masses`` (nq, 1) are masses and inertias, ``weight`` (nq, 1) [N, N m] is the force of gravity.

    Energy is ``1/2 v' M v - weight' q``. The momentum ``sum m v`` changes by weight, motors,
    obstacles and rails; for a pusher on a rail only forces along the rail are included.
    """

    def balance(q: ca.SX, v: ca.SX, u: ca.SX, v_next: ca.SX, normal: ca.SX, friction: ca.SX) -> EnergyBalance:
        momentum, external = ca.SX.zeros(2), ca.SX.zeros(2)
        impulses = _contact_impulses(scene, q, normal, friction)
        forces = weight + ca.vertcat(ca.SX.zeros(weight.numel() - u.numel()), u)
        for element in scene.moving:
            directions = element.directions if isinstance(element, Pusher) else ca.SX.eye(2)
            n = directions.shape[1]
            mass = scene.coordinates_of(element.name, masses)[0]
            momentum = momentum + mass * directions @ scene.coordinates_of(element.name, v)[:n]
            impulse = directions.T @ impulses.get(element.name, ca.SX.zeros(2))
            external = external + directions @ (h * scene.coordinates_of(element.name, forces)[:n] + impulse)
        energy = ca.dot(masses, v**2) / 2 - ca.dot(weight, q)
        work = h * ca.dot(u, v_next[v_next.numel() - u.numel() :])
        return EnergyBalance(energy, work, momentum, external)

    return balance


def _contact_impulses(scene: Scene, q: ca.SX, normal: ca.SX, friction: ca.SX) -> dict[str, ca.SX]:
    """Return a mapping from the name of each body and pusher to the impulse (2, 1) [N s] of all its contacts."""
    impulses: dict[str, ca.SX] = {}
    for i, (touch, contact) in enumerate(zip(scene.touches, scene.contacts(q), strict=True)):
        push = normal[i] * contact.normal + friction[i] * contact.tangent
        for element, impulse in ((touch.one, push), (touch.other, -push)):
            if isinstance(element, Body | Pusher):
                impulses[element.name] = impulses.get(element.name, ca.SX.zeros(2)) + impulse
    return impulses
