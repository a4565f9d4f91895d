"""What a machine's table holds."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from dynamics.systems.chain import Chain
from dynamics.systems.geometry import ContactGeometry, disc_half_plane
from dynamics.systems.planar import Link, Number


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
    """Links, contact spheres and the constants of the environment that they come from.

    ``pose`` is the pose the table is checked at, one value for each coordinate [m, rad];
    ``friction`` Coulomb's coefficient with the ground; ``h`` the environment's time step [s].
    """

    links: tuple[Link, ...]
    spheres: tuple[Sphere, ...]
    pose: tuple[float, ...]
    friction: float
    h: float

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
