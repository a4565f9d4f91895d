"""Costs of sliding contacts, and of bodies that move close above the ground, for any machine."""

from __future__ import annotations

import casadi as ca

from dynamics.systems import ContactForces, ContactSystem, ParameterTable
from ocp.errors import InputError
from problems.parameters import Parameters, quantity, structure


class FootfallParams(Parameters):
    """Weights of the costs of feet, all zero."""

    w_slip: float = quantity(0.0, "1/J", "weight of the energy that sliding feet dissipate", least=0)
    w_clear: float = quantity(0.0, "s/m^2", "weight of motion along the ground below the clearance", least=0)
    clearance: float = structure(0.03, "height at which feet may move along the ground", unit="m")


def footfall_cost(params: FootfallParams, p: ParameterTable, system: ContactSystem) -> ca.SX:
    """Return ``w_slip`` times :func:`slip_cost` and ``h w_clear`` times :func:`clearance_cost`, for a step.

    ``p`` are the symbols of ``params``. A cost whose weight is zero is left out: learned laws and MuJoCo have no
    multipliers of slip.
    """
    cost = ca.SX(0)
    if params.w_slip:
        cost += p["w_slip"] * slip_cost(system)
    if params.w_clear:
        cost += system.h * p["w_clear"] * clearance_cost(system, params.clearance)
    return cost


def slip_cost(system: ContactSystem) -> ca.SX:
    """Return ``sum_i f_i gamma_i psi_i / h`` [J]: the energy that friction dissipates in a step where contacts slide.

    ``f_i gamma_i`` is the largest tangential impulse [N s] of contact i, and ``psi_i`` the multiplier of its slip
    pair, the distance that it slides in the step [m]. Both are multipliers of the step, so that the cost is zero
    exactly where contacts stick, and grows with the distance, not with its square: contacts stick or slide rather
    than all slide a little.

    Raises :class:`~ocp.errors.InputError` for a system without friction, or with another cone than the linearised.
    """
    forces, slips = _forces(system), dict[int, ca.SX]()
    for pair, multiplier in zip(system.pairs, ca.vertsplit(system.lam), strict=True):
        if pair.kind == "slip":
            slips[pair.contact] = multiplier
    sides = [pair.contact for pair in system.pairs if pair.kind == "friction"]
    if not slips or any(sides.count(contact) < 2 for contact in slips):
        raise InputError(f"{system.name}: the cost of slip needs a linearised friction cone; leave cone out")
    return sum((forces.friction[i] * forces.normal[i] * psi / system.h for i, psi in slips.items()), ca.SX(0))


def clearance_cost(system: ContactSystem, clearance: ca.SX | float) -> ca.SX:
    """Return ``sum_i max(0, 1 - phi_i/clearance)^2 |J_t,i v|^2`` [m²/s²] of motion below ``clearance`` [m].

    ``phi_i`` is the distance of contact i at the state x and ``J_t,i v`` its tangential velocity there. Bodies that
    move along the ground at a height of ``clearance`` or more cost nothing, so that feet are lifted in swing.

    Raises :class:`~ocp.errors.InputError` for a system without friction, or without distances.
    """
    forces, phi = _forces(system), system.phi
    if phi is None:
        raise InputError(f"{system.name}: the cost of low motion needs the distances of contacts; leave it out")
    count = len(forces.names)
    # In time stepping the slip is that of the next velocity along rows of the pose now.
    slip = ca.substitute(forces.slip, system.x_next, system.x)
    speeds = ca.reshape(slip, count, slip.numel() // max(1, count))
    return ca.dot(ca.fmax(0, 1 - phi[:count] / clearance) ** 2, ca.sum2(speeds**2))


def _forces(system: ContactSystem) -> ContactForces:
    """Return the contact forces of a system; raises :class:`~ocp.errors.InputError` for one without friction."""
    if system.forces is None:
        raise InputError(
            f"{system.name}: costs of sliding need contacts with friction; give the machine friction, or leave the"
            " costs out"
        )
    return system.forces
