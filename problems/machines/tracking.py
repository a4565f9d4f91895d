"""Changes to a machine's system for tracking: torques in N m, and a nominal value that varies with time."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca

from dynamics.systems import ContactSystem, Signal


def with_nominal(system: ContactSystem, rate: ca.SX, nominal: Signal) -> ContactSystem:
    """Return the system with an additional last state ``nominal``, which grows by ``rate`` per second.

    Since ``nominal`` is a state, its value continues from one plan of a closed loop to the next, at any step size.
    """
    current, following = ca.SX.sym(nominal.name), ca.SX.sym(f"{nominal.name}_next")
    return replace(
        system,
        x=ca.vertcat(system.x, current),
        x_next=ca.vertcat(system.x_next, following),
        residual=ca.vertcat(system.residual, following - current - system.h * rate),
        states=(*system.states, nominal),
    )


def in_torques(system: ContactSystem) -> ContactSystem:
    """Return the system of a machine whose gears are 1 N m, with inputs labelled as torques in N m."""
    torques = tuple(Signal(signal.name, "N m", "torque") for signal in system.inputs)
    return replace(system, inputs=torques)
