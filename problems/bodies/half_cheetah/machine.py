"""The half-cheetah: a torso on a hind leg and a fore leg of three links each.

The values are from Dojo's halfcheetah.urdf and its environment (Howell et al., Dojo, 2022), reduced
to the plane.
"""

from __future__ import annotations

from dynamics.systems import Link, Sphere
from dynamics.systems.planar.links import Number
from problems.machines.machine import PublishedMachine

SPHERE_RADIUS = 0.046
"""Radius of all spheres [m]."""

# Columns: name, parent, mass, inertia, centre of mass and tip (z relative to the joint), anchor,
# offset, limits, spring, gear.
_LEGS = (
    ("bthigh", "torso", 1.5352, 0.01525, -0.145, -0.290, (-0.5, 0.0), -0.658, (-0.52, 1.05), 240.0, 120.0),
    ("bshin", "bthigh", 1.5809, 0.01660, -0.145, -0.290, (0.0, -0.290), 1.7, (-0.785, 0.785), 180.0, 90.0),
    ("bfoot", "bshin", 1.069, 0.005444, -0.094, -0.188, (0.0, -0.290), -1.5, (-0.4, 0.785), 120.0, 60.0),
    ("fthigh", "torso", 1.42558, 0.01231, -0.133, -0.266, (0.5, 0.0), 0.52, (-1.0, 0.7), 180.0, 120.0),
    ("fshin", "fthigh", 1.17885, 0.00716, -0.106, -0.212, (0.0, -0.266), -1.11159, (-1.2, 0.87), 120.0, 60.0),
    ("ffoot", "fshin", 0.84986, 0.002899, -0.070, -0.140, (0.0, -0.212), -0.1, (-0.5, 0.5), 60.0, 30.0),
)


def half_cheetah(
    *, base_damping: Number = 0.0, spring_scale: Number = 1.0, damping: Number = 1.0, limits: bool = True
) -> PublishedMachine:
    """Return the half-cheetah of Zhang et al. (2023), sec. 7: 9 coordinates, 6 motors, 14.000 kg.

    ``spring_scale`` multiplies the stiffnesses of the six joints (60 to 240 N m/rad), ``damping`` [N m s/rad] acts in
    each joint. ``base_damping`` acts on x, z and angle of the torso [N s/m, N m s/rad]; the source has no such
    damping. One unit of input is 30 to 120 N m; the intended range of inputs is [-1, 1], which the source does not
    enforce. At ``pose`` both feet touch the ground.
    """
    torso = Link("torso", None, 6.36031, 0.8835, joint="free", damping=base_damping)
    legs = tuple(
        Link(
            name,
            parent,
            mass,
            inertia,
            com=(0.0, com),
            anchor=anchor,
            offset=offset,
            spring=spring_scale * stiffness,
            damping=damping,
            gear=gear,
            limits=bounds if limits else None,
        )
        for name, parent, mass, inertia, com, _, anchor, offset, bounds, stiffness, gear in _LEGS
    )
    return PublishedMachine(
        links=(torso, *legs),
        spheres=(
            Sphere("fore end", "torso", (0.5, 0.0), SPHERE_RADIUS),
            Sphere("hind end", "torso", (-0.5, 0.0), SPHERE_RADIUS),
            Sphere("head", "torso", (0.714, 0.1935), SPHERE_RADIUS),
            *(Sphere(name, name, (0.0, tip), SPHERE_RADIUS) for name, _, _, _, _, tip, *_ in _LEGS),
        ),
        pose=(0.0, 0.576509, 0.02792, *[0.0] * len(_LEGS)),
        friction=0.4,
        h=0.05,
        lift=0.25,
        noise=0.1,
    )
