"""MJCF of scenes: small balls on slide joints, with contacts that are almost as rigid as the time step allows."""

from __future__ import annotations

import re

import numpy as np

RADIUS_M = 0.001
"""Radius of the balls in MuJoCo, which are points in the other worlds [m]."""
FLOOR = '<geom name="floor" type="plane" size="0 0 1"/>'
"""Floor through the origin."""
_AXES = {"x": "1 0 0", "z": "0 0 1"}
"""Mapping from the name of a coordinate to the axis of its joint."""


def ball(name: str, mass: float, axes: str, place: str = "") -> str:
    """Return a small ball that slides along the ``axes``, with its centre at ``place`` (default: a radius up)."""
    joints = "".join(f'<joint name="{name}.{axis}" type="slide" axis="{_AXES[axis]}"/>' for axis in axes.split())
    geom = f'<geom name="{name}" type="sphere" size="{RADIUS_M}" mass="{mass}"/>'
    return f'<body name="{name}" pos="{place or f"0 0 {RADIUS_M}"}">{joints}{geom}</body>'


def model(world: str, friction: float = 0.0, restitution: float = 0.0, gravity: float = -9.81) -> str:
    """Return the MJCF of a scene with its bodies and geoms, and a motor on every joint.

    Contacts are critically damped, or have a restitution.

    For a damped spring ``e = exp(-pi zeta / sqrt(1 - zeta^2))``; its stiffness, here 1, is set with the time step.
    """
    solref = "0.004 1"
    if restitution > 0:
        log = -np.log(restitution)
        zeta = log / np.hypot(np.pi, log)
        solref = f"-1 {-2 * zeta:.9g}"
    dimensions = 3 if friction > 0 else 1
    joints = re.findall('joint name="([^"]+)"', world)
    motors = "".join(f'<motor joint="{name}"/>' for name in joints)
    return f"""
<mujoco>
  <option timestep="0.002" gravity="0 0 {gravity}" cone="elliptic" impratio="10"/>
  <default>
    <geom solref="{solref}" solimp="0.95 0.99 0.001" friction="{max(friction, 1e-5)} 0 0" condim="{dimensions}"/>
  </default>
  <worldbody>{world}</worldbody>
  <actuator>{motors}</actuator>
</mujoco>
"""
