"""What the tasks of the running machines share: unknown weights, the reset, what is told."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from dynamics.systems import ContactSystem, ParameterTable, Signal
from ocp.task import Measure
from problems.machines.machine import PublishedMachine
from problems.parameters import quantity


def mass(machine: PublishedMachine, link: str) -> Any:
    """Declare the parameter ``mass_<link>``, as in the table."""
    return quantity(_weights(machine, link)[0], "kg", f"mass of the {link}", above=0)


def inertia(machine: PublishedMachine, link: str) -> Any:
    """Declare the parameter ``inertia_<link>``, about its centre of mass, as in the table."""
    return quantity(_weights(machine, link)[1], "kg m^2", f"inertia of the {link}", above=0)


def _weights(machine: PublishedMachine, name: str) -> tuple[float, float]:
    link = next(link for link in machine.links if link.name == name)
    return float(link.mass), float(link.inertia)


def weighed(machine: PublishedMachine, p: ParameterTable) -> PublishedMachine:
    """The machine with ``mass_<link>`` [kg] and ``inertia_<link>`` [kg m²] of ``p`` as its own."""
    links = (
        replace(link, mass=p[f"mass_{link.name}"], inertia=p[f"inertia_{link.name}"])
        for link in machine.links
    )
    return replace(machine, links=tuple(links))


def start(machine: PublishedMachine) -> tuple[ca.SX, ca.SX]:
    """State (q, v) of :meth:`PublishedMachine.reset` and its chance, one for each component."""
    pose = np.concatenate([machine.pose, np.zeros(len(machine.pose))])
    pose[1] += machine.lift
    chance = ca.SX.sym("chance", len(pose))
    return ca.DM(pose) + machine.noise * chance, chance


def measures(system: ContactSystem, h: ca.SX) -> tuple[Measure, ...]:
    """Forward speed over a step and height of the torso."""
    x, x_next = system.x, system.x_next
    return (
        Measure(Signal("speed", "m/s", "forward speed"), (x_next[0] - x[0]) / h),
        Measure(Signal("height", "m", "height of the torso"), x_next[1]),
    )


def tame(x: ca.SX, bound: float) -> ca.SX:
    """1 where every entry of ``x`` is below ``bound`` in size, else 0; no entry that is no number.

    A comparison with what is no number is false, so what is still well is compared.
    """
    fine = ca.SX(1)
    for i in range(x.numel()):
        fine = ca.logic_and(fine, ca.fabs(x[i]) < bound)
    return fine
