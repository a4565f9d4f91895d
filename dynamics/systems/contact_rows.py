"""Complementarity pairs of contacts with Coulomb friction, and of joint limits."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import casadi as ca

from dynamics.systems.pairs import COULOMB, TRUE_GAPS, ContactForces, Pair, RefereeModel
from dynamics.systems.parameters import Signal
from dynamics.systems.shapes.contact import EDGES, LINEARISED, SECOND_ORDER, ConeForm, FrictionSpec, Row
from dynamics.systems.system import ContactSystem, check_shape

Cone = Literal["linearised", "second-order", "edges"]
# Mapping from names to formulations of the friction cone.
FORMS: dict[str, ConeForm] = {
    "linearised": LINEARISED,
    "second-order": SECOND_ORDER,
    "edges": EDGES,
}


def check_cone(name: str, cone: str) -> None:
    """Raise ``ValueError`` for an unknown formulation of the friction cone."""
    if cone not in FORMS:
        kinds = ", ".join(map(repr, FORMS))
        raise ValueError(f"system {name!r}: cone must be one of {kinds}, got {cone!r}")


def limit_distances(limits: Sequence[tuple[int, Any, Any]], q: ca.SX) -> ca.SX:
    """Return the distances of entries of q from their lower, then their upper limits (entry, lower, upper)."""
    return ca.vertcat(*(q[i] - low for i, low, _ in limits), *(high - q[i] for i, _, high in limits))


@dataclass(frozen=True, eq=False)
class Space:
    """Maps of contacts in space that contacts in the plane do not need; ``sliding`` gives 2 nc rows, for two tangents.

    Rows multiply the velocities v, of which there are ``velocities`` (nv) and which need not be
    dq/dt: ``pressing`` maps q to J_n (nc, nv), ``tangent`` maps q to the derivative of dq/dt with
    respect to v (nq, nv). The friction cone is a pyramid with 4 or 8 ``edges``. For a machine that moves
    in a plane, ``edges`` is 2 and ``sliding`` gives nc rows, for one tangent.
    """

    velocities: int
    pressing: Callable[[ca.SX], ca.SX]
    tangent: Callable[[ca.SX], ca.SX]
    edges: int

    def directions(self, rows: list[ca.SX]) -> list[ca.SX]:
        """Return rows along half of the edges from rows along the tangents; the other half are their negatives."""
        if self.edges < 8:
            return rows
        first, second = rows
        return [first, second, *((first + sign * second) / math.sqrt(2) for sign in (1, -1))]

    def components(self, impulses: list[ca.SX]) -> ca.SX:
        """Return impulses along the tangents, stacked, from impulses along :meth:`directions`."""
        if self.edges < 8:
            return ca.vertcat(*impulses)
        first, second, rise, fall = impulses
        diagonal_parts = ((rise + sign * fall) / math.sqrt(2) for sign in (1, -1))
        return ca.vertcat(*map(ca.plus, (first, second), diagonal_parts))


@dataclass(frozen=True, eq=False)
class ContactSpec:
    """The nc contacts of a mechanism, and the nl limits of its joints; ``space`` is None in the plane.

    The other fields are arguments of the same names of :func:`~dynamics.systems.timestepping.time_stepping`.
    """

    contacts: tuple[Signal, ...]
    distance: Callable[[ca.SX], ca.SX]
    sliding: Callable[[ca.SX], ca.SX] | None
    friction: ca.SX | float | None
    cone: Cone
    linearised: bool
    limits: Callable[[ca.SX], ca.SX] | None = None
    limit_names: tuple[str, ...] = ()
    space: Space | None = None

    @property
    def frictional_contacts(self) -> tuple[list[int], ca.SX]:
        """Indices of contacts whose friction is not the number zero, and all friction coefficients (nc, 1)."""
        nc = len(self.contacts)
        f = ca.SX.zeros(nc) if self.friction is None else ca.SX.ones(nc) * self.friction
        return [i for i in range(nc) if not f[i].is_zero()], f

    def referee_model(self, curved: bool, build: Callable[[ContactSpec], ContactSystem]) -> RefereeModel:
        """Return the most exact model, made by ``build``; ``curved`` says that some distances are not affine in q."""
        notes = [TRUE_GAPS] if self.linearised and curved else []
        true = replace(self, linearised=False)
        if self.cone == "edges" and self.friction is not None and self.sliding is not None:
            notes.append(COULOMB)
            true = replace(true, cone="linearised")
        return RefereeModel(", ".join(notes), lambda: build(true)) if notes else RefereeModel()


@dataclass(frozen=True, eq=False)
class ContactRows:
    """The pairs of one step: ``lam`` (nlam, 1), ``gap`` (nlam, 1) and their ``generalised_impulse`` (nq, 1) [N s].

    ``signals`` and ``pairs`` describe each pair, ``forces`` are total impulses, None without friction.
    ``phi`` are the distances at q of contacts and limits; ``curved`` says that one of them is not affine in q.
    """

    lam: ca.SX
    gap: ca.SX
    generalised_impulse: ca.SX
    signals: tuple[Signal, ...]
    pairs: tuple[Pair, ...]
    forces: ContactForces | None
    phi: ca.SX | None = None
    curved: bool = False


def contact_rows(
    name: str,
    spec: ContactSpec,
    q: ca.SX,
    q_next: ca.SX,
    step_along: Callable[[ca.SX], ca.SX],
    h: ca.SX | float,
) -> ContactRows:
    """Return the pairs of ``spec`` for a step of h from q to q_next.

    ``step_along(J)`` is the displacement of the step along the rows J. The pairs are in this order: normal
    pairs, pairs of limits, pairs of the friction cone. A contact whose friction is the number zero has only its
    normal pair. If friction is a parameter whose value is zero, the contact has all pairs, but its friction
    pairs ignore the slip and exert no impulse.

    Raises ``ValueError`` if a dimension does not fit.
    """
    nc, nl, space = len(spec.contacts), len(spec.limit_names), spec.space
    nv = q.numel() if space is None else space.velocities

    def distance_rows(argument: str, distance: Callable[[ca.SX], ca.SX], count: int) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Return the distance at q, its Jacobian there, and the gap."""
        distance_now = distance(q)
        check_shape(name, argument, distance_now, (count, 1))
        if space is None:
            slope = ca.jacobian(distance_now, q)
            gap = distance_now + slope @ (q_next - q) if spec.linearised else distance(q_next)
            return distance_now, slope, gap
        if distance is spec.distance:
            slope = space.pressing(q)
        else:
            slope = ca.jacobian(distance_now, q) @ space.tangent(q)
        return distance_now, slope, distance_now + step_along(slope) if spec.linearised else distance(q_next)

    limits, limit_phi, forces = [], ca.SX(0, 1), None
    if spec.limits is not None:
        limit_phi, slope, gap = distance_rows("limits(q)", spec.limits, nl)
        stops = [Signal(n, "N m s", "impulse of a joint limit") for n in spec.limit_names]
        limits = [Row("limit", gap, slope, stops)]
    phi, J, gap = distance_rows("distance(q)", spec.distance, nc)
    normal_row, lam = Row("normal", gap, J, list(spec.contacts)), ca.SX.sym("lam", nc + nl)
    rows, owners = [normal_row], [list(range(nc))]
    frictional, _ = spec.frictional_contacts
    if spec.sliding is not None and frictional:
        J_t, tangents = spec.sliding(q), 1 if space is None else min(2, space.edges // 2)
        check_shape(name, "sliding(q)", J_t, (tangents * nc, nv))
        tangent_rows = [J_t[nc * k : nc * (k + 1), :] for k in range(tangents)]
        lam, (contact_row, *further_rows), forces = _friction_rows(spec, normal_row, tangent_rows, step_along, h)
        rows = [_replace_entries(normal_row, contact_row, frictional), *further_rows]
        owners += [frictional] * len(further_rows)
    rows[1:1], owners[1:1] = limits, [list(range(nc, nc + nl))] * len(limits)
    return ContactRows(
        lam,
        ca.vertcat(ca.SX(0, 1), *(row.gap for row in rows)),
        ca.vertcat(ca.SX(0, nv), *(row.direction for row in rows)).T @ lam,
        tuple(signal for row in rows for signal in row.signals),
        tuple(Pair(row.kind, owner) for row, owned in zip(rows, owners, strict=True) for owner in owned),
        forces,
        ca.vertcat(phi, limit_phi),
        ca.depends_on(ca.vertcat(J, *(limit.direction for limit in limits)), q),
    )


def _friction_rows(
    spec: ContactSpec,
    normal_row: Row,
    tangent_rows: list[ca.SX],
    step_along: Callable[[ca.SX], ca.SX],
    h: ca.SX | float,
) -> tuple[ca.SX, list[Row], ContactForces]:
    """Return all multipliers, the rows of the friction cone, and the total impulses at contacts.

    The first row replaces the normal row of contacts with friction; ``tangent_rows`` has one matrix
    (nc, nv) for each tangent.
    """
    nc, nl, space, form = len(spec.contacts), len(spec.limit_names), spec.space, FORMS[spec.cone]
    frictional, f = spec.frictional_contacts
    directions = tangent_rows if space is None else space.directions(tangent_rows)
    lam = ca.SX.sym("lam", nc + nl + form.n_further(len(directions)) * len(frictional))
    slip_lengths = [step_along(row_block) for row_block in directions]
    friction_spec = FrictionSpec(
        tuple(spec.contacts[i] for i in frictional),
        normal_row.gap[frictional],
        normal_row.direction[frictional, :],
        [row_block[frictional, :] for row_block in directions],
        f[frictional],
        [row_block[frictional] for row_block in slip_lengths],
        [lam[frictional], *ca.vertsplit(lam[nc + nl :], len(frictional))],
    )
    rows, normal_impulses, tangential_impulses = form.pairs(friction_spec)
    tangents = len(tangent_rows)
    normal, tangential = lam[:nc], ca.SX.zeros(tangents * nc)
    normal[frictional] = normal_impulses
    tangential[[nc * k + i for k in range(tangents) for i in frictional]] = (
        tangential_impulses[0] if space is None else space.components(tangential_impulses)
    )
    names = tuple(contact.name for contact in spec.contacts)
    slip, edges = ca.vertcat(*slip_lengths[:tangents]) / h, 2 if space is None else space.edges
    return lam, list(rows), ContactForces(names, normal, tangential, slip, f, edges)


def _replace_entries(row: Row, replacement: Row, indices: list[int]) -> Row:
    """Return ``row`` with the entries at ``indices`` replaced by those of ``replacement``."""
    if len(indices) == len(row.signals):
        return replacement
    gap, direction, signals = ca.SX(row.gap), ca.SX(row.direction), list(row.signals)
    gap[indices], direction[indices, :] = replacement.gap, replacement.direction
    for i, signal in zip(indices, replacement.signals, strict=True):
        signals[i] = signal
    return Row(row.kind, gap, direction, signals)
