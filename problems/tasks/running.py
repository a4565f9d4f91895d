"""Parts shared by tasks of running machines: parameters for masses and inertias, the start, and measures."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
from pydantic import create_model

from dynamics.systems import ContactSystem, Signal
from ocp.problem.task import Measure
from problems.machines.machine import PublishedMachine
from problems.parameters import Parameters, friction_of, quantity, table


def with_weights(base: type[Parameters], machine: PublishedMachine) -> type[Parameters]:
    """Return ``base`` with parameters ``mass_<link>`` and ``inertia_<link>``; defaults are the links' values."""
    kinds = {"mass": "kg", "inertia": "kg m^2"}
    weights: dict[str, Any] = {
        f"{kind}_{link.name}": (float, quantity(getattr(link, kind), unit, f"{kind} of the {link.name}", above=0))
        for kind, unit in kinds.items()
        for link in machine.links
    }
    return create_model("Weights", __base__=base, **weights)


def machine_task_fields(
    name: str, params: Any, machine_of: Callable[..., PublishedMachine], spring: str, spheres: Collection[str] | None
) -> tuple[ContactSystem, dict[str, Any]]:
    """Return the machine's contact system at ``params``, and the fields of its :class:`~ocp.problem.task.Task`.

    The links have the masses ``mass_<link>`` [kg] and inertias ``inertia_<link>`` [kg m²]; ``spring``
    is the name of the parameter for the joints' springs. The start is that of :meth:`PublishedMachine.reset`, inputs
    are in [-1, 1], and the measures are speed and height of the torso.
    """
    p, friction = friction_of(table(params))
    stiffness = {spring: p[spring]}
    machine = machine_of(base_damping=p["base_damping"], damping=p["damping"], limits=bool(params.limits), **stiffness)
    links = (replace(link, mass=p[f"mass_{link.name}"], inertia=p[f"inertia_{link.name}"]) for link in machine.links)
    system = replace(machine, links=tuple(links)).system(
        name, p, h=p["h"], friction=friction, spheres=spheres, cone=params.cone
    )
    pose = np.concatenate([machine.pose, np.zeros(len(machine.pose))])
    pose[1] += machine.lift
    chance = ca.SX.sym("chance", len(pose))
    x, x_next = system.x, system.x_next
    return system, {
        "name": name,
        "system": system,
        "parameters": p,
        "horizon": params.horizon,
        "start": ca.DM(pose) + machine.noise * chance,
        "chance": chance,
        "observations": system.states[1:],
        "lower": -np.ones(system.nu),
        "upper": np.ones(system.nu),
        "measures": (
            Measure(Signal("speed", "m/s", "forward speed"), (x_next[0] - x[0]) / p["h"]),
            Measure(Signal("height", "m", "height of the torso"), x_next[1]),
        ),
    }


def all_below(x: ca.SX, bound: float) -> ca.SX:
    """Return 1 if the absolute value of every entry of ``x`` is below ``bound``, else 0; for NaN, 0.

    Comparisons with NaN are false; therefore entries are tested for being within the bound.
    """
    fine = ca.SX(1)
    for i in range(x.numel()):
        fine = ca.logic_and(fine, ca.fabs(x[i]) < bound)
    return fine
