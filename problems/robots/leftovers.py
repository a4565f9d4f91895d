"""What a compiled file says and no machine holds: every setting that is not MuJoCo's default."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from importlib import import_module
from typing import Any

import numpy as np

from problems.robots.bodies import drive_of
from problems.robots.source import listed

_PLAIN = (
    '<mujoco><worldbody><body><joint name="j"/><geom size=".1"/></body></worldbody>'
    '<actuator><motor joint="j"/></actuator></mujoco>'
)
_RIGID, _JOINT = "contact is rigid", "give it to the joint"
_SETTINGS = {
    "geom_solref": _RIGID, "geom_solimp": _RIGID, "geom_margin": _RIGID, "geom_gap": _RIGID,
    "geom_fluid": "there is no fluid", "geom_adhesion": "nothing sticks",
    "geom_surfacevel": "surfaces do not run",
    "jnt_solref": "limits are rigid", "jnt_solimp": "limits are rigid",
    "jnt_margin": "limits are rigid", "jnt_springyield": "springs do not yield",
    "jnt_stiffnesspoly": "springs are linear", "dof_frictionloss": "joints have no dry friction",
    "dof_dampingpoly": "damping is linear", "body_gravcomp": "gravity acts on every body",
    "actuator_armature": _JOINT, "actuator_damping": _JOINT, "actuator_dampingpoly": _JOINT,
    "actuator_delay": "motors act at once",
}  # fmt: skip
"""Settings of MuJoCo's model by name, and what holds instead."""


def leftovers(model: Any, geoms: Iterable[int]) -> list[str]:
    """Say of everything that plays no part what it is, by name, and what holds instead.

    Of geoms those count that may touch anything.
    """
    plain, told = import_module("mujoco").MjModel.from_xml_string(_PLAIN), list[str]()
    rows = {"geom": geoms, "joint": range(model.njnt), "body": range(1, model.nbody),
            "actuator": range(model.nu)}  # fmt: skip
    for name, instead in _SETTINGS.items():
        kind, _, setting = name.partition("_")
        what = {"jnt": "joint", "dof": "joint"}.get(kind, kind)
        values, usual = getattr(model, name, None), getattr(plain, name, None)
        if values is None or usual is None:
            continue
        at = model.jnt_dofadr if kind == "dof" else range(len(values))
        own = [k for k in rows[what] if np.any(values[at[k]] != usual[-1])]
        if "limits" in instead:
            own = [j for j in own if model.jnt_limited[j]]
        names = [getattr(model, what)(k).name for k in own]
        told += [f"{setting} of {listed(what, names)}: {instead}"] if names else []
    for what, kind, which, instead in _things(model):
        names = [getattr(model, kind)(k).name for k in which]
        kind = "equality constraint" if kind == "eq" else kind
        told += [f"{what}{listed(kind, names)}: {instead}"] if names else []
    if any(model.geom_condim[g] > 3 for g in geoms):
        told.append("torsional and rolling friction (condim above 3): contacts only slide")
    return told


def _things(model: Any) -> Iterator[tuple[str, str, list[int], str]]:
    """What of a kind of elements is left out, of which, and what holds instead."""
    single = np.flatnonzero(model.jnt_type < 2).tolist()
    for what, has in (("armature", model.dof_armature[model.jnt_dofadr]),
                      ("spring", model.jnt_stiffness), ("limit", model.jnt_limited)):  # fmt: skip
        own = [j for j in single if has[j]]
        yield f"{what} of ", "joint", own, "only hinges and slides have one"
    bound = "only joints bind bodies"
    yield "", "tendon", [*range(model.ntendon)], bound
    yield "", "eq", [*range(model.neq)], bound
    yield "", "sensor", [*range(model.nsensor)], "nothing is measured here"
    keys = [k for k in range(model.nkey) if model.key(k).name != "home"]
    yield "", "key", keys, "the one named home is home"
    drives = [drive_of(model, k) for k in range(model.nu)]
    odd = [k for k, drive in enumerate(drives) if drive is None]
    yield "", "actuator", odd, "only motors and position servos of hinges and slides are read"
    bounded = model.jnt_actfrclimited[model.actuator_trnid[:, 0]] | model.actuator_forcelimited
    strong = [k for k, drive in enumerate(drives) if drive and drive.servo and bounded[k]]
    yield "force range of ", "actuator", strong, "a servo pulls as hard as it must"
    mocap = np.flatnonzero(model.body_mocapid >= 0).tolist()
    yield "mocap of ", "body", mocap, "it never moves"
