"""Elements of a compiled file that have no effect here, such as springs of ball joints."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from problems.robots.bodies import actuator_of
from problems.robots.couplings import coupled_tendons
from problems.robots.elements import listed


def unsupported_features(model: Any, geoms: Iterable[int]) -> list[str]:
    """Return sentences on the features of the file that are ignored, and what is assumed instead.

    ``geoms`` are the numbers of the geoms that may touch.
    """
    sentences = list[str]()
    for prefix, kind, which, instead in _unsupported_elements(model):
        names = [getattr(model, kind)(k).name for k in which]
        kind = "equality constraint" if kind == "eq" else kind
        sentences += [f"{prefix}{listed(kind, names)}: {instead}"] if names else []
    if any(model.geom_condim[g] > 3 for g in geoms):
        sentences.append("torsional and rolling friction (condim above 3): contacts only slide")
    return sentences


def _unsupported_elements(model: Any) -> Iterator[tuple[str, str, list[int], str]]:
    """Yield, for each ignored feature, its name, kind and numbers of its elements, and what is assumed instead."""
    single = np.flatnonzero(model.jnt_type < 2).tolist()
    for feature, has in (
        ("armature", model.dof_armature[model.jnt_dofadr]),
        ("spring", model.jnt_stiffness),
        ("limit", model.jnt_limited),
    ):
        joints = [j for j in single if has[j]]
        yield f"{feature} of ", "joint", joints, "only hinges and slides have one"
    ties = [k for k in range(model.ntendon) if k not in coupled_tendons(model)]
    yield "", "tendon", ties, "only joints connect bodies"
    yield "", "eq", [k for k in range(model.neq) if not model.eq_active0[k]], "it is inactive"
    keys = [k for k in range(model.nkey) if model.key(k).name != "home"]
    yield "", "key", keys, "only the keyframe named home is used"
    actuators = [actuator_of(model, k) for k in range(model.nu)]
    unsupported = [k for k, actuator in enumerate(actuators) if actuator is None]
    yield "", "actuator", unsupported, "only motors and position servos of hinges and slides are read"
    strong = [
        k
        for k, actuator in enumerate(actuators)
        if actuator
        and actuator.servo
        and (model.actuator_forcelimited[k] or model.jnt_actfrclimited[model.actuator_trnid[k][0]])
    ]
    yield "force range of ", "actuator", strong, "the force of a servo is not limited"
    mocap = np.flatnonzero(model.body_mocapid >= 0).tolist()
    yield "mocap of ", "body", mocap, "it never moves"
