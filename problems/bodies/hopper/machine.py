"""The planar hopper: torso, thigh, leg and foot, standing upright at q = 0.

The values are from Dojo's hopper_good.urdf and its environment (Howell et al., Dojo, 2022), reduced
to the plane.
"""

from __future__ import annotations

from math import pi

from dynamics.systems import Link, Sphere
from dynamics.systems.planar.links import Number
from problems.machines.machine import PublishedMachine


def hopper(
    *, base_damping: Number = 0.0, spring: Number = 10.0, damping: Number = 1.0, limits: bool = False
) -> PublishedMachine:
    """Return the hopper of Zhang et al. (2023), sec. 7: 6 coordinates, 3 motors, 15.265 kg.

    ``spring`` [N m/rad] and ``damping`` [N m s/rad] act in the three joints; ``limits`` are the joint
    limits of the source's later version, since its first version has none. ``base_damping`` acts on x, z and angle of
    the torso [N s/m, N m s/rad]; the source's parser sets it to 50, which is not physical. One unit
    of input is 200 N m. Thigh and leg have spheres only at their upper ends.
    """
    joint = {"spring": spring, "damping": damping, "gear": 200.0}
    knee = (0.0, pi * 150 / 180) if limits else None
    ankle = (-pi / 4, pi / 4) if limits else None
    return PublishedMachine(
        links=(
            Link("torso", None, 3.53429, 0.06185, joint="free", damping=base_damping),
            Link("thigh", "torso", 3.92699, 0.08426, com=(0.0, -0.225), anchor=(0.0, -0.20), limits=knee, **joint),
            Link("leg", "thigh", 2.71433, 0.06704, com=(0.0, -0.25), anchor=(0.0, -0.45), limits=knee, **joint),
            Link("foot", "leg", 5.08938, 0.09046, com=(0.065, 0.0), anchor=(0.0, -0.50), limits=ankle, **joint),
        ),
        spheres=(
            Sphere("torso", "torso", (0.0, 0.20), 0.05),
            Sphere("thigh", "thigh", (0.0, 0.0), 0.05),
            Sphere("leg", "leg", (0.0, 0.0), 0.04),
            Sphere("toe", "foot", (0.26, 0.0), 0.06),
            Sphere("heel", "foot", (-0.13, 0.0), 0.06),
        ),
        pose=(0.0, 1.25, 0.0, 0.0, 0.0, 0.0),
        friction=1.0,
        h=0.05,
        lift=0.25,
        noise=0.005,
    )
