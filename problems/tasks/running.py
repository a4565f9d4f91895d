"""Parts that the tasks of the running machines share: unknown weights, the reset, the measures."""

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
    """Return ``base`` with parameters ``mass_<link>`` and ``inertia_<link>`` of each link, as in its table."""
    kinds = {"mass": "kg", "inertia": "kg m^2"}
    weights: dict[str, Any] = {
        f"{kind}_{link.name}": (float, quantity(getattr(link, kind), unit, f"{kind} of the {link.name}", above=0))
        for kind, unit in kinds.items()
        for link in machine.links
    }
    return create_model("Weights", __base__=base, **weights)


def built(
    name: str, params: Any, machine_of: Callable[..., PublishedMachine], spring: str, spheres: Collection[str] | None
) -> tuple[ContactSystem, dict[str, Any]]:
    """Return the machine's system at ``params``, and the fields of :class:`~ocp.problem.task.Task` that all have.

    The links weigh ``mass_<link>`` [kg] and ``inertia_<link>`` [kg m²]; ``spring`` names the
    parameter of the joints' springs. The start is that of :meth:`PublishedMachine.reset`, one unit
    bounds each input, and speed and height of the torso are measured.
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


def tame(x: ca.SX, bound: float) -> ca.SX:
    """Return 1 where every entry of ``x`` is a number below ``bound`` in size, else 0.

    A comparison with what is no number is false, so what is still well is compared.
    """
    fine = ca.SX(1)
    for i in range(x.numel()):
        fine = ca.logic_and(fine, ca.fabs(x[i]) < bound)
    return fine
