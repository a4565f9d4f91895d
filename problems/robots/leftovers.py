"""What a compiled file says and no machine holds: every setting that is not MuJoCo's default."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cache
from importlib import import_module
from typing import Any

import numpy as np

from problems.robots.source import listed
from problems.robots.tree import body_name, is_motor, joint_name

_PLAIN = (
    '<mujoco><worldbody><body><joint name="j"/><geom size=".1"/></body></worldbody>'
    '<actuator><motor joint="j"/></actuator></mujoco>'
)
_RIGID = "contact is rigid"
_SETTINGS = {
    "geom_solref": _RIGID, "geom_solimp": _RIGID, "geom_margin": _RIGID, "geom_gap": _RIGID,
    "geom_fluid": "there is no fluid", "geom_adhesion": "nothing sticks",
    "geom_surfacevel": "surfaces do not run",
    "jnt_solref": "limits are rigid", "jnt_solimp": "limits are rigid",
    "jnt_margin": "limits are rigid",
    "jnt_springyield": "springs do not yield", "jnt_stiffnesspoly": "springs are linear",
    "dof_frictionloss": "joints have no dry friction", "dof_dampingpoly": "damping is linear",
    "body_gravcomp": "gravity acts on every link",
    "actuator_armature": "give it to the joint", "actuator_damping": "give it to the joint",
    "actuator_dampingpoly": "give it to the joint", "actuator_delay": "motors act at once",
}  # fmt: skip
"""Settings of MuJoCo's model by name, and what holds instead."""


def leftovers(model: Any, geoms: Iterable[int]) -> list[str]:
    """Say of everything that plays no part what it is, by name, and what holds instead.

    Of geoms those count that may touch anything.
    """
    plain = _plain()
    rows: dict[str, tuple[Iterable[int], Callable[[int], str]]] = {
        "geom": (geoms, lambda g: model.geom(g).name or _of_body(model, model.geom_bodyid[g])),
        "joint": (range(model.njnt), lambda j: joint_name(model, j)),
        "body": (range(1, model.nbody), lambda b: body_name(model, b)),
        "actuator": (range(model.nu), lambda k: _named(model.actuator(k).name, "actuator", k)),
    }
    told = []
    for name, instead in _SETTINGS.items():
        kind, _, setting = name.partition("_")
        what = {"jnt": "joint", "dof": "joint"}.get(kind, kind)
        values, usual = getattr(model, name, None), getattr(plain, name, None)
        if values is None or usual is None:
            continue
        indices, label = rows[what]
        if kind == "dof":
            places = {k: int(model.jnt_dofadr[k]) for k in indices}
        else:
            places = {k: k for k in indices}
        own = [
            label(k) for k, at in places.items()
            if np.any(values[at] != usual[-1])
            and ("limits" not in instead or model.jnt_limited[k])
        ]  # fmt: skip
        if own:
            told.append(f"{setting} of {listed(what, own)}: {instead}")
    return [*told, *_things(model, geoms)]


def _things(model: Any, geoms: Iterable[int]) -> list[str]:
    """Whole elements of a file."""
    names = {
        "tendon": [_named(model.tendon(k).name, "tendon", k) for k in range(model.ntendon)],
        "equality constraint": [_named(model.eq(k).name, "equality", k) for k in range(model.neq)],
        "keyframe": [
            _named(model.key(k).name, "key", k) for k in range(model.nkey)
            if model.key(k).name != "home"
        ],
    }  # fmt: skip
    instead = {
        "tendon": "only joints bind links", "equality constraint": "only joints bind links",
        "keyframe": "the one named home is home",
    }  # fmt: skip
    told = [f"{listed(what, found)}: {instead[what]}" for what, found in names.items() if found]
    other = [_named(model.actuator(k).name, "actuator", k) for k in range(model.nu)
             if not is_motor(model, k)]  # fmt: skip
    if other:
        told.append(f"{listed('actuator', other)}: only motors at joints are read")
    mocap = [body_name(model, b) for b in range(model.nbody) if model.body_mocapid[b] >= 0]
    if mocap:
        told.append(f"mocap of {listed('body', mocap)}: it never moves")
    if any(model.geom_condim[g] > 3 for g in geoms):
        told.append("torsional and rolling friction (condim above 3): contacts only slide")
    return told


def _of_body(model: Any, body: int) -> str:
    return f"of {body_name(model, int(body))}"


def _named(name: str, kind: str, number: int) -> str:
    return name or f"{kind} {number + 1}"


@cache
def _plain() -> Any:
    return import_module("mujoco").MjModel.from_xml_string(_PLAIN)
