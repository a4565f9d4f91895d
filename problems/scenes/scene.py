"""A scene: bodies, pushers and obstacles that touch, as one contact system, and its drawing."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache, cached_property
from itertools import accumulate, pairwise
from typing import Any

import casadi as ca
import numpy as np

from dynamics.systems import (
    ContactSystem,
    EnergyBalance,
    ParameterTable,
    Signal,
    quasi_dynamic,
    time_stepping,
)
from dynamics.systems.checks import require_items, require_not_negative
from dynamics.systems.contact_rows import Cone
from dynamics.systems.shapes import Contact, Pose
from dynamics.systems.shapes.planar import Point, Scalar, as_column
from dynamics.systems.shapes.polygon import convex_parts
from ocp.errors import InputError
from problems.drawing import ContactFrame, Disc, Segment, Shape, solid
from problems.scenes.checks import check_names, check_numbers, required
from problems.scenes.things import Body, Goal, Obstacle, Pusher, Thing, Touch, touches

Pair = tuple[str, str]


class Scene:
    """What stands in the plane, and how rough it is where two things touch.

    ``things`` are bodies, pushers and obstacles, each a shape, and goals, which are only drawn. Any
    two touch of which one moves, but the pairs of names in ``apart``. Of the plane's axes y points
    up where there is gravity, and angles count anticlockwise.

    ``friction`` is Coulomb's coefficient, one for all contacts, or one for each pair of names; a
    pair that is not named is frictionless. All numbers may be symbols of a problem's parameters.

    Coordinates ``q`` are those of the bodies and then of the pushers, in the order of ``things``.
    Raises :class:`~ocp.errors.InputError` for things that make no sense or names that are unknown.
    """

    def __init__(
        self,
        things: Sequence[Thing | Goal],
        friction: Scalar | Mapping[Pair, Scalar] = 0.0,
        apart: Sequence[Pair] = (),
    ) -> None:
        given = require_items("the things of a scene", (Body, Pusher, Obstacle, Goal), things)
        self.things = tuple(thing for thing in given if isinstance(thing, Thing))
        self.goals = tuple(thing for thing in given if isinstance(thing, Goal))
        self.apart, self._given = tuple(map(frozenset, apart)), friction
        rough = [*friction] if isinstance(friction, Mapping) else []
        for value in friction.values() if isinstance(friction, Mapping) else [friction]:
            require_not_negative("the friction of a scene", value)
        check_names(given, [*rough, *apart])
        self.bodies = tuple(thing for thing in self.things if isinstance(thing, Body))
        self.pushers = tuple(thing for thing in self.things if isinstance(thing, Pusher))
        self.touches = tuple(touches(self.things, self.apart))
        self.moving = (*self.bodies, *self.pushers)
        self.coordinates = tuple(signal for thing in self.moving for signal in thing.coordinates)
        ends = [0, *accumulate(len(thing.coordinates) for thing in self.moving)]
        self._at = {thing.name: slice(*both) for thing, both in zip(self.moving, pairwise(ends), strict=True)}

    @cached_property
    def start(self) -> ca.SX:
        """Start of all that moves, (nq, 1)."""
        return ca.vertcat(ca.SX(0, 1), *(thing.start for thing in self.moving))

    @cached_property
    def hold(self) -> ca.SX:
        """The commanded places that hold the pushers where they start, (nu, 1)."""
        return ca.vertcat(ca.SX(0, 1), *(pusher.start for pusher in self.pushers))

    def at_rest(self, system: ContactSystem) -> ca.SX:
        """The state in which everything stands where it starts, (nx, 1)."""
        return ca.vertcat(self.start, ca.SX.zeros(system.nx - self.start.numel()))

    def of(self, name: str, x: ca.SX) -> ca.SX:
        """The coordinates of one thing in a state ``x``, or in ``q``."""
        return x[self._at[name]]

    def pose(self, q: ca.SX) -> Callable[[Thing], Pose]:
        """Return a function from a thing to its pose at ``q``."""
        return lambda thing: thing.pose(q[self._at.get(thing.name, slice(0, 0))])

    def contacts(self, q: ca.SX) -> list[Contact]:
        """The contacts at ``q``, in the order of ``touches``."""
        pose = self.pose(q)
        return [touch.contact(pose) for touch in self.touches]

    @cached_property
    def friction(self) -> ca.SX:
        """Coulomb's coefficient of every contact, (nc, 1)."""
        return ca.vertcat(ca.SX(0, 1), *map(self._rough, self.touches))

    def _rough(self, touch: Touch) -> Scalar:
        if not isinstance(self._given, Mapping):
            return self._given
        return {frozenset(pair): f for pair, f in self._given.items()}.get(touch.pair, 0.0)

    def distance(self, q: ca.SX) -> ca.SX:
        """Signed distance of every contact at ``q``, (nc, 1) [m]."""
        return ca.vertcat(ca.SX(0, 1), *(contact.phi for contact in self.contacts(q)))

    def sliding(self, q: ca.SX) -> ca.SX:
        """Rows of the velocity along every contact's tangent at ``q``, (nc, nq)."""
        rows = (contact.jacobians(q)[1] for contact in self.contacts(q))
        return ca.vertcat(ca.SX(0, q.numel()), *rows)

    @cached_property
    def _masses(self) -> list[ca.SX]:
        """Mass or inertia of every coordinate of the bodies."""
        found = []
        for body in self.bodies:
            found += [ca.SX(body.mass)] * 2
            found += [] if body.inertia is None else [ca.SX(body.inertia)]
        return found

    def _signals(self) -> tuple[Signal, ...]:
        return tuple(Signal(t.name, "N s", "impulse along the normal") for t in self.touches)

    def quasi_dynamic(
        self,
        name: str,
        parameters: ParameterTable,
        *,
        h: Scalar,
        cone: Cone = "linearised",
        linearised: bool = False,
        load: Point | None = None,
        gravity: Scalar = 9.81,
        inertial: bool = True,
    ) -> ContactSystem:
        """Bodies without momentum, and pushers that springs draw to where they are told to be.

        The state is q, the input the commanded coordinates of the pushers [m]; gaps are the true
        ones at the next state unless ``linearised``. ``load`` [m/s²] pulls at every body's mass.
        Bodies with a ``table`` are pressed to it by ``gravity`` [m/s²], and slide quasi-statically
        unless ``inertial`` (:class:`~dynamics.systems.limit_surface.LimitSurface`). See
        :func:`~dynamics.systems.timestepping.quasi_dynamic`.

        Raises :class:`~ocp.errors.InputError` for numbers that make no sense at the parameters'
        values, such as things that start inside each other.
        """
        stiffness = [
            ca.SX(required(p, p.stiffness, "stiffness", "a quasi-dynamic scene"))
            for p in self.pushers
            for _ in p.coordinates
        ]
        check_numbers(self, parameters)
        if not inertial and (free := [b.name for b in self.bodies if b.table is None]):
            raise InputError(
                f"{free[0]!r} glides without friction or inertia, so nothing holds it; give it a"
                " table, or leave inertial=True"
            )
        pull = ca.SX.zeros(2) if load is None else as_column(load)
        weights = [ca.vertcat(b.mass * pull, *[0] * b.turns) for b in self.bodies]
        made = quasi_dynamic(
            name,
            states=self.coordinates,
            inputs=self._commands("m", "commanded"),
            contacts=self._signals(),
            h=h,
            mass=ca.diag(ca.vertcat(ca.SX(0, 1), *self._masses)),
            stiffness=ca.diag(ca.vertcat(ca.SX(0, 1), *stiffness)),
            distance=self.distance,
            sliding=self.sliding,
            friction=self.friction,
            cone=cone,
            linearised=linearised,
            load=ca.vertcat(ca.SX(0, 1), *weights),
            tables=[
                surface
                for body in self.bodies
                if (surface := body.limit_surface(self._at[body.name].start, gravity, inertial))
            ],
            parameters=parameters,
        )
        return replace(made, scene=not linearised)

    def time_stepping(
        self,
        name: str,
        parameters: ParameterTable,
        *,
        h: Scalar,
        gravity: Point = (0.0, 0.0),
        cone: Cone = "linearised",
        linearised: bool = False,
    ) -> ContactSystem:
        """Bodies and pushers with masses and velocities, the pushers under forces.

        The state is (q, v), the input the forces [N] on the pushers along their coordinates;
        ``gravity`` [m/s²] is a vector of the plane. See
        :func:`~dynamics.systems.timestepping.time_stepping`; raises as :meth:`quasi_dynamic` does.
        """
        masses = [
            ca.SX(required(p, p.mass, "mass", "a scene with velocities")) for p in self.pushers for _ in p.coordinates
        ]
        if lying := [body.name for body in self.bodies if body.table is not None]:
            raise InputError(
                f"{lying[0]!r} lies on a table, which only Scene.quasi_dynamic knows; leave its table out here"
            )
        check_numbers(self, parameters)
        pull, M = as_column(gravity), ca.vertcat(ca.SX(0, 1), *self._masses, *masses)
        falling = ca.vertcat(
            ca.SX(0, 1),
            *(ca.vertcat(pull, *[0] * body.turns) for body in self.bodies),
            *(pusher.directions.T @ pull for pusher in self.pushers),
        )
        free = M.numel() - len(masses)
        speeds = (Signal(f"v_{c.name}", f"{c.unit}/s", f"speed of {c.name}") for c in self.coordinates)
        made = time_stepping(
            name,
            states=(*self.coordinates, *speeds),
            inputs=self._commands("N", "force on"),
            contacts=self._signals(),
            h=h,
            mass=ca.diag(M),
            impulse=lambda q, v, u: h * (M * falling + ca.vertcat(ca.SX.zeros(free), u)),
            distance=self.distance,
            sliding=self.sliding,
            friction=self.friction,
            cone=cone,
            linearised=linearised,
            parameters=parameters,
            energy_balance=energy_book(self, M, M * falling, h),
        )
        return replace(made, scene=not linearised)

    def _commands(self, unit: str, what: str) -> tuple[Signal, ...]:
        coordinates = (c for pusher in self.pushers for c in pusher.coordinates)
        return tuple(Signal(f"u_{c.name}", unit, f"{what} {c.name}") for c in coordinates)


Book = Callable[[ca.SX, ca.SX, ca.SX, ca.SX, ca.SX, ca.SX], EnergyBalance]


def energy_book(scene: Scene, masses: ca.SX, weight: ca.SX, h: Scalar) -> Book:
    """Keep the book of a scene with ``masses`` (nq, 1) under ``weight`` (nq, 1) [N, N m].

    Energy is ``1/2 v' M v - weight' q``. What pushes at the momentum ``sum m v`` from outside are
    weight, motors, obstacles and rails: of what acts on a pusher only the part along its rail
    moves it.
    """

    def keep(q: ca.SX, v: ca.SX, u: ca.SX, v_next: ca.SX, normal: ca.SX, along: ca.SX) -> EnergyBalance:
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
        return EnergyBalance(energy, work, momentum, external)

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


Draw = Callable[[Any, np.ndarray], list[Shape]]
Frames = Callable[[Any, np.ndarray], list[ContactFrame]]
Place = tuple[float, float, float]
"""x, y [m], and the angle [rad], clockwise."""


def pictured(scene: Callable[[Any], Scene]) -> tuple[Draw, Frames]:
    """Return the ``draw`` and ``frames`` of a problem whose scene is ``scene(p)``.

    ``scene`` reads every parameter as ``p["name"]``, so that it serves the symbols of ``build`` and
    the numbers of a drawing alike.
    """

    @cache
    def made(params: Any) -> tuple[Scene, ca.Function]:
        found = scene(params.model_dump())
        return found, _places(found)

    def draw(params: Any, state: np.ndarray) -> list[Shape]:
        there, places = made(params)
        poses = np.array(places(state[: places.numel_in(0)])[0]).T.tolist()
        return _drawn(there, [(x, y, angle) for x, y, angle in poses])

    def frames(params: Any, state: np.ndarray) -> list[ContactFrame]:
        places = made(params)[1]
        _, found, friction = (np.array(v).T for v in places(state[: places.numel_in(0)]))
        rows = np.column_stack([found, friction.ravel()]).tolist()
        return [ContactFrame(x, y, nx, ny, f) for x, y, nx, ny, f in rows]

    return draw, frames


def _places(scene: Scene) -> ca.Function:
    """Map q to the poses (3, things), to places and normals (4, contacts), and their friction."""
    q = ca.SX.sym("q", len(scene.coordinates))
    pose, poses = scene.pose(q), ca.SX(3, 0)
    for thing in scene.things:
        at = pose(thing)
        poses = ca.horzcat(poses, ca.vertcat(at.position, at.angle))
    frames = ca.SX(4, 0)
    for contact in scene.contacts(q):
        frames = ca.horzcat(frames, ca.vertcat(contact.point, contact.normal))
    outputs = [poses, frames, scene.friction]
    return ca.Function("places", [q], [ca.densify(out) for out in outputs])


def _drawn(scene: Scene, poses: list[Place]) -> list[Shape]:
    """Obstacles, then goals, then what moves."""
    there = {thing.name: thing for thing in scene.things}
    placed = list(zip(scene.things, poses, strict=True))
    still = [(thing, at) for thing, at in placed if isinstance(thing, Obstacle)]
    moving = [(thing, at) for thing, at in placed if not isinstance(thing, Obstacle)]
    found = [solid(part, *at, "environment") for thing, at in still for part in convex_parts(thing.shape)]
    for goal in scene.goals:
        pose = float(goal.at[0]), float(goal.at[1]), -float(goal.angle)
        found += _marked(there[goal.body], pose, "goal")
    for thing, at in moving:
        found += _marked(thing, at, "object" if isinstance(thing, Body) else "actuator")
    return found


def _marked(thing: Thing, at: Place, role: str) -> list[Shape]:
    """The thing, and on a disc that turns the radius that is upright at angle zero."""
    drawn = [solid(part, *at, role) for part in convex_parts(thing.shape)]
    if not (thing.turns and isinstance(disc := drawn[0], Disc)):
        return drawn
    x, y, angle = disc.x, disc.y, at[2]
    end = x + disc.radius * math.sin(angle), y + disc.radius * math.cos(angle)
    return [*drawn, Segment(x, y, *end, role)]
