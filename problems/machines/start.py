"""Whether a machine can start where it is told to."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from dynamics.systems import Machine
from problems.machines.picture import sphere_centres

_ROUNDING = 1e-9


def check_start(machine: Machine, q: Sequence[float], spheres: Collection[str]) -> None:
    """Refuse a pose ``q`` (nq,) with one of ``spheres`` in the ground or a joint past its limit.

    Raises ``ValueError`` that names the sphere or the joint, and by how much to mend it.
    """
    depths = {
        sphere.name: sphere.radius - float(z)
        for sphere, (_, z) in zip(machine.spheres, sphere_centres(machine, q), strict=True)
        if sphere.name in spheres
    }
    deepest = max(depths, key=lambda name: depths[name])
    if depths[deepest] > _ROUNDING:
        raise ValueError(
            f"the {deepest} starts {depths[deepest]:.3g} m inside the ground; raise the start by"
            f" as much, to a height of {q[1] + depths[deepest]:.6g} m"
        )
    chain = machine.chain()
    for index, low, high in chain.limits:
        if not low - _ROUNDING <= q[index] <= high + _ROUNDING:
            raise ValueError(
                f"the joint {chain.coordinates[index].name} starts at {q[index]:.3g} rad, past its"
                f" limits of {low:.3g} to {high:.3g} rad; start it between them or leave limits out"
            )
