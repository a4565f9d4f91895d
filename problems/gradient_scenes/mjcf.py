"""MJCF of scenes: small balls on slide joints, with contacts that are almost as rigid as the time step allows."""

from __future__ import annotations

import re
from collections.abc import Sequence

from problems.gradient_scenes.scene import Coordinate, Scene

RADIUS_M = 0.001
"""Radius of the balls in MuJoCo, which are points in the other worlds [m]."""
_AXES = {"x": "1 0 0", "z": "0 0 1"}
"""Mapping from the name of a coordinate to the axis of its joint."""


def ball(name: str, coordinates: Sequence[Coordinate], position: str) -> str:
    """Return a small ball that slides along the axes of ``coordinates``, with its centre at ``position``."""
    joints = "".join(
        f'<joint name="{name}.{each.axis}" type="slide" axis="{_AXES[each.axis]}" stiffness="{each.spring}"/>'
        for each in coordinates
    )
    geom = f'<geom name="{name}" type="sphere" size="{RADIUS_M}" mass="{coordinates[0].mass}"/>'
    return f'<body name="{name}" pos="{position}">{joints}{geom}</body>'


def _ball_on_plane(coordinates: Sequence[Coordinate]) -> str:
    """Return a ball that starts above the plane through the origin whose normal is the axis of the last coordinate."""
    normal = _AXES[coordinates[-1].axis]
    plane = f'<geom name="floor" type="plane" size="0 0 1" zaxis="{normal}"/>'
    return ball("ball", coordinates, normal.replace("1", str(RADIUS_M))) + plane


def scene_mjcf(scene: Scene, cone: str = "elliptic") -> str:
    """Return the MJCF of a scene with its bodies and geoms, and a motor on every joint; ``cone`` is that of friction.

    Contacts are critically damped, or have a restitution; their stiffness, here 1, is then set with the time step.
    """
    mechanics = scene.mechanics
    solref = f"-1 {-2 * mechanics.damping_ratio:.9g}" if mechanics.restitution > 0 else "0.004 1"
    bodies = scene.bodies or _ball_on_plane(mechanics.coordinates)
    friction, dimensions = (1e-5, 1) if mechanics.friction is None else (mechanics.friction, 3)
    motors = "".join(f'<motor joint="{name}"/>' for name in re.findall('joint name="([^"]+)"', bodies))
    return f"""
<mujoco>
  <option timestep="0.002" gravity="0 0 {-mechanics.gravity}" cone="{cone}" impratio="10"/>
  <default>
    <geom solref="{solref}" solimp="0.95 0.99 0.001" friction="{friction} 0 0" condim="{dimensions}"/>
  </default>
  <worldbody>{bodies}</worldbody>
  <actuator>{motors}</actuator>
</mujoco>
"""
