"""Energy and momentum of a scene with velocities."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import casadi as ca

from dynamics.systems import EnergyBook
from dynamics.systems.contacts.shapes import Scalar
from problems.scenes.things import Body, Pusher, Thing

if TYPE_CHECKING:
    from problems.scenes.scene import Scene

Book = Callable[[ca.SX, ca.SX, ca.SX, ca.SX, ca.SX, ca.SX], EnergyBook]


def energy_book(scene: Scene, masses: ca.SX, weight: ca.SX, h: Scalar) -> Book:
    """Keep the book of a scene with ``masses`` (nq, 1) under ``weight`` (nq, 1) [N, N m].

    Energy is ``1/2 v' M v - weight' q``. What pushes at the momentum ``sum m v`` from outside are
    weight, motors, obstacles and rails: of what acts on a pusher only the part along its rail
    moves it.
    """

    def keep(
        q: ca.SX, v: ca.SX, u: ca.SX, v_next: ca.SX, normal: ca.SX, along: ca.SX
    ) -> EnergyBook:
        momentum, external = ca.SX.zeros(2), ca.SX.zeros(2)
        pushes = _pushes(scene, q, normal, along)
        forces = weight + ca.vertcat(ca.SX.zeros(weight.numel() - u.numel()), u)
        for thing in scene.moving:
            ways, mine = _ways(thing), scene.of(thing.name, v)[: _ways(thing).shape[1]]
            mass = scene.of(thing.name, masses)[0]
            force = scene.of(thing.name, forces)[: ways.shape[1]]
            momentum = momentum + mass * ways @ mine
            push = pushes.get(thing.name, ca.SX.zeros(2))
            external = external + ways @ (h * force + ways.T @ push)
        energy = ca.dot(masses, v**2) / 2 - ca.dot(weight, q)
        work = h * ca.dot(u, v_next[v_next.numel() - u.numel() :])
        return EnergyBook(energy, work, momentum, external)

    return keep


def _ways(thing: Thing) -> ca.SX:
    """Unit vectors along which the thing's places move it, as columns."""
    return thing.directions if isinstance(thing, Pusher) else ca.SX.eye(2)


def _pushes(scene: Scene, q: ca.SX, normal: ca.SX, along: ca.SX) -> dict[str, ca.SX]:
    """The impulse (2, 1) of all its contacts on everything that moves, by name."""
    found: dict[str, ca.SX] = {}
    for i, (touch, contact) in enumerate(zip(scene.touches, scene.contacts(q), strict=True)):
        push = normal[i] * contact.normal + along[i] * contact.tangent
        for thing, impulse in ((touch.one, push), (touch.other, -push)):
            if isinstance(thing, Body | Pusher):
                found[thing.name] = found.get(thing.name, ca.SX.zeros(2)) + impulse
    return found
