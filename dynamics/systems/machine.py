"""Machines: trees of links whose round parts touch the ground, as one contact system."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import casadi as ca

from dynamics.systems.chain import Chain
from dynamics.systems.contact_rows import Cone
from dynamics.systems.geometry import ContactGeometry, Pose, disc_half_plane
from dynamics.systems.pairs import EnergyBook
from dynamics.systems.parameters import ParameterTable, Signal
from dynamics.systems.planar import Link, Number
from dynamics.systems.system import ContactSystem
from dynamics.systems.timestepping import time_stepping


@dataclass(frozen=True)
class Sphere:
    """A round part that may touch the ground: ``centre`` in its link's frame [m], ``radius`` [m].

    In the plane it is a disc.
    """

    name: str
    link: str
    centre: tuple[float, float]
    radius: float


@dataclass(frozen=True, eq=False)
class Machine:
    """A tree of links, and the spheres on them that may touch the ground z = 0."""

    links: tuple[Link, ...]
    spheres: tuple[Sphere, ...]

    def chain(self, gravity: Number = 9.81) -> Chain:
        """Build the equations of motion under ``gravity`` [m/s²]."""
        return Chain(self.links, gravity)

    def ground_contacts(self, chain: Chain, q: ca.SX) -> dict[str, ContactGeometry]:
        """Contact of each sphere with the ground z = 0 at the pose ``q`` (nq, 1)."""
        return {
            sphere.name: disc_half_plane(
                chain.position(q, sphere.link, sphere.centre), sphere.radius, (0.0, 0.0), (0.0, 1.0)
            )
            for sphere in self.spheres
        }

    def system(
        self,
        name: str,
        parameters: ParameterTable,
        *,
        h: ca.SX | float,
        friction: ca.SX | float | None,
        spheres: Collection[str] | None = None,
        scale: float = 1.0,
        cone: Cone = "linearised",
        linearised: bool = False,
        free_step: bool = False,
    ) -> ContactSystem:
        """One step of the machine over the ground z = 0, with friction and joint limits.

        ``spheres`` are the parts that may touch, by default all; ``friction`` None is frictionless;
        one unit of input is ``scale`` times the gear [N m]; ``cone`` is how friction's is written.
        With ``free_step`` h is a symbol and one state more. Names of contacts are those of the
        spheres, of limits ``<joint> low`` and ``<joint> high``.
        """
        chain = self.chain()
        kept = [s for s in self.spheres if spheres is None or s.name in spheres]
        more = (Signal("h", "s", "step size"),) if free_step else ()
        v = ca.SX.sym("v", chain.nq)
        damping = -ca.jacobian(chain.damping(v), v)
        motors, mass, g = scale * chain.B, chain.total_mass, chain.gravity
        base, limits = ca.diag(damping)[:2], chain.limits
        joints = [chain.coordinates[i].name for i, _, _ in limits]

        def book(
            q: ca.SX, v: ca.SX, u: ca.SX, v_next: ca.SX, normal: ca.SX, tangential: ca.SX
        ) -> EnergyBook:
            contact = ca.vertcat(ca.sum1(tangential), ca.sum1(normal))
            external = contact - h * ca.vertcat(0, mass * g) - h * base * v_next[:2]
            work = h * ca.dot(v_next, motors @ u - damping @ v_next)
            return EnergyBook(chain.energy(q, v), work, chain.momentum(q, v), external)

        def sliding(q: ca.SX) -> ca.SX:
            contacts = self.ground_contacts(chain, q)
            rows = [
                contacts[s.name].jacobians(chain.pose(q, s.link), Pose.fixed(), q)[1] for s in kept
            ]
            return ca.vertcat(*rows)

        def left(q: ca.SX) -> ca.SX:
            low = [q[i] - lowest for i, lowest, _ in limits]
            return ca.vertcat(*low, *(highest - q[i] for i, _, highest in limits))

        return time_stepping(
            name,
            states=(*chain.coordinates, *chain.velocities, *more),
            inputs=tuple(Signal(f"u_{joint}", "1", "motor") for joint in chain.actuated),
            contacts=tuple(Signal(sphere.name, "N s", "normal impulse") for sphere in kept),
            h=h,
            mass=chain.mass,
            impulse=lambda q, v, u: h * (motors @ u - chain.bias(q, v)),
            parameters=parameters,
            distance=lambda q: ca.vertcat(
                *(self.ground_contacts(chain, q)[sphere.name].phi for sphere in kept)
            ),
            sliding=sliding,
            friction=friction,
            cone=cone,
            limits=left if limits else None,
            limit_names=tuple(f"{joint} {end}" for end in ("low", "high") for joint in joints),
            damping=damping,
            stiffness=-ca.jacobian(chain.spring(v), v),
            linearised=linearised,
            book=book,
        )
