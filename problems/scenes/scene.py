"""A scene: bodies, pushers and obstacles in contact, as one contact system."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import accumulate, pairwise
from typing import Any

import casadi as ca

from dynamics.systems import ContactSystem, ParameterTable, Signal, quasi_dynamic, time_stepping
from dynamics.systems.checks import require_items, require_not_negative
from dynamics.systems.contact_rows import Cone
from dynamics.systems.shapes import Contact, Pose
from dynamics.systems.shapes.planar import Point, Scalar, as_column
from ocp.errors import InputError
from problems.scenes.checks import check_names, check_numbers, required
from problems.scenes.energy import energy_balance
from problems.scenes.things import Body, Goal, Obstacle, Pusher, Thing, Touch, contact_pairs

Pair = tuple[str, str]


class Scene:
    """Bodies, pushers and obstacles in the plane, with their contacts and friction.

    ``things`` are bodies, pushers and obstacles, each with a shape, and goals, which are only drawn.
    Two things can touch if at least one of them moves, except the pairs of names in ``non_colliding``. The y
    axis points up if there is gravity; angles are anticlockwise.

    ``friction`` is Coulomb's coefficient of all contacts, or a mapping from pairs of names to coefficients; pairs that
    are not in the mapping are frictionless. All numbers may be symbols of a problem's parameters.

    Coordinates ``q`` are those of the bodies and then of the pushers, in the order of ``things``.
    Raises :class:`~ocp.errors.InputError` for invalid things and for unknown or duplicate names.
    """

    def __init__(
        self,
        things: Sequence[Thing | Goal],
        friction: Scalar | Mapping[Pair, Scalar] = 0.0,
        non_colliding: Sequence[Pair] = (),
    ) -> None:
        all_things = require_items("the things of a scene", (Body, Pusher, Obstacle, Goal), things)
        self.things = tuple(element for element in all_things if isinstance(element, Thing))
        self.goals = tuple(element for element in all_things if isinstance(element, Goal))
        self.non_colliding, self._friction = tuple(map(frozenset, non_colliding)), friction
        coefficients = friction if isinstance(friction, Mapping) else {}
        for coefficient in coefficients.values() if isinstance(friction, Mapping) else [friction]:
            require_not_negative("the friction of a scene", coefficient)
        check_names(all_things, [*coefficients, *non_colliding])
        self.bodies = tuple(element for element in self.things if isinstance(element, Body))
        self.pushers = tuple(element for element in self.things if isinstance(element, Pusher))
        self.touches = tuple(contact_pairs(self.things, self.non_colliding))
        self.moving = (*self.bodies, *self.pushers)
        self.coordinates = tuple(signal for element in self.moving for signal in element.coordinates)
        ends = [0, *accumulate(len(element.coordinates) for element in self.moving)]
        self._at = {element.name: slice(*pair) for element, pair in zip(self.moving, pairwise(ends), strict=True)}

    @cached_property
    def start(self) -> ca.SX:
        """Coordinates of all bodies and pushers at the start, (nq, 1)."""
        return ca.vertcat(ca.SX(0, 1), *(element.start for element in self.moving))

    @cached_property
    def hold(self) -> ca.SX:
        """Commanded coordinates that hold the pushers at their start, (nu, 1)."""
        return ca.vertcat(ca.SX(0, 1), *(pusher.start for pusher in self.pushers))

    def at_rest(self, system: ContactSystem) -> ca.SX:
        """Return the state in which bodies and pushers are at their start and at rest, (nx, 1)."""
        return ca.vertcat(self.start, ca.SX.zeros(system.nx - self.start.numel()))

    def coordinates_of(self, name: str, x: ca.SX) -> ca.SX:
        """Return the coordinates (n, 1) of the body or pusher called ``name`` in ``x``, a state or q."""
        return x[self._at[name]]

    def pose(self, q: ca.SX) -> Callable[[Thing], Pose]:
        """Return the function from a body, pusher, obstacle or goal to its pose at ``q``."""
        return lambda element: element.pose(q[self._at.get(element.name, slice(0, 0))])

    def contacts(self, q: ca.SX) -> list[Contact]:
        """Return the contacts at ``q``, in the order of ``touches``."""
        pose = self.pose(q)
        return [touch.contact(pose) for touch in self.touches]

    @cached_property
    def friction(self) -> ca.SX:
        """Coulomb's coefficient of every contact, (nc, 1)."""
        return ca.vertcat(ca.SX(0, 1), *map(self._coefficient, self.touches))

    def _coefficient(self, touch: Touch) -> Scalar:
        if not isinstance(self._friction, Mapping):
            return self._friction
        return {frozenset(pair): f for pair, f in self._friction.items()}.get(touch.pair, 0.0)

    def distance(self, q: ca.SX) -> ca.SX:
        """Return the signed distance of every contact at ``q``, (nc, 1) [m]."""
        return ca.vertcat(ca.SX(0, 1), *(contact.phi for contact in self.contacts(q)))

    def sliding(self, q: ca.SX) -> ca.SX:
        """Return the Jacobian (nc, nq) of the sliding velocities, along every contact's tangent at ``q``."""
        rows = (contact.jacobians(q)[1] for contact in self.contacts(q))
        return ca.vertcat(ca.SX(0, q.numel()), *rows)

    @cached_property
    def _masses(self) -> list[ca.SX]:
        """Mass [kg] or inertia [kg m²] of every coordinate of the bodies."""
        masses = []
        for body in self.bodies:
            masses += [ca.SX(body.mass)] * 2
            masses += [] if body.inertia is None else [ca.SX(body.inertia)]
        return masses

    def _contact_arguments(self, cone: Cone, linearised: bool) -> dict[str, Any]:
        return {
            "contacts": tuple(Signal(touch.name, "N s", "impulse along the normal") for touch in self.touches),
            "distance": self.distance,
            "sliding": self.sliding,
            "friction": self.friction,
            "cone": cone,
            "linearised": linearised,
        }

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
        """Return the contact system of bodies without momentum and of pushers that springs pull to their commands.

        The state is q, and the input are the commanded coordinates of the pushers [m]. Gaps are true
        distances at the next state unless ``linearised``. Every body is loaded by the force
        ``load`` [m/s²] times its mass. Bodies with a ``table`` are pressed onto it by ``gravity`` [m/s²], and slide
        quasi-statically unless ``inertial`` (:class:`~dynamics.systems.limit_surface.LimitSurface`).
        See :func:`~dynamics.systems.timestepping.quasi_dynamic`.

        Raises :class:`~ocp.errors.InputError` for numbers that are invalid at the parameters'
        values, for example if things start inside each other.
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
        system = quasi_dynamic(
            name,
            states=self.coordinates,
            inputs=self._commands("m", "commanded"),
            h=h,
            mass=ca.diag(ca.vertcat(ca.SX(0, 1), *self._masses)),
            stiffness=ca.diag(ca.vertcat(ca.SX(0, 1), *stiffness)),
            load=ca.vertcat(ca.SX(0, 1), *weights),
            tables=[
                surface
                for body in self.bodies
                if (surface := body.limit_surface(self._at[body.name].start, gravity, inertial))
            ],
            parameters=parameters,
            **self._contact_arguments(cone, linearised),
        )
        return replace(system, scene=not linearised)

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
        """Return the contact system of bodies and pushers with masses and velocities, in which forces move the pushers.

        The state is (q, v), and the input are the forces [N] on the pushers along their coordinates;
        ``gravity`` [m/s²] is a vector of the plane. See
        :func:`~dynamics.systems.timestepping.time_stepping`; raises as :meth:`quasi_dynamic` does.
        """
        masses = [
            ca.SX(required(p, p.mass, "mass", "a scene with velocities")) for p in self.pushers for _ in p.coordinates
        ]
        if lying := [body.name for body in self.bodies if body.table is not None]:
            raise InputError(
                f"{lying[0]!r} lies on a table, which only Scene.quasi_dynamic supports; leave its table out here"
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
        system = time_stepping(
            name,
            states=(*self.coordinates, *speeds),
            inputs=self._commands("N", "force on"),
            h=h,
            mass=ca.diag(M),
            impulse=lambda q, v, u: h * (M * falling + ca.vertcat(ca.SX.zeros(free), u)),
            parameters=parameters,
            energy_balance=energy_balance(self, M, M * falling, h),
            **self._contact_arguments(cone, linearised),
        )
        return replace(system, scene=not linearised)

    def _commands(self, unit: str, meaning: str) -> tuple[Signal, ...]:
        coordinates = (c for pusher in self.pushers for c in pusher.coordinates)
        return tuple(Signal(f"u_{c.name}", unit, f"{meaning} {c.name}") for c in coordinates)
