"""The complementarity pairs of contacts with Coulomb friction, and of the limits of joints."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import casadi as ca

from dynamics.systems.contacts.contact import (
    EDGES,
    LINEARISED,
    SECOND_ORDER,
    ConeForm,
    Row,
    Rubbing,
)
from dynamics.systems.pairs import COULOMB, TRUE_GAPS, ContactForces, Pair, Sharp
from dynamics.systems.parameters import Signal
from dynamics.systems.system import ContactSystem, check_shape

Cone = Literal["linearised", "second-order", "edges"]
FORMS: dict[str, ConeForm] = {
    "linearised": LINEARISED,
    "second-order": SECOND_ORDER,
    "edges": EDGES,
}


@dataclass(frozen=True, eq=False)
class Space:
    """What contacts in space need besides: ``sliding`` gives 2 nc rows, of both tangents.

    ``velocities`` nv of the rows, which multiply v where that is not dq/dt: ``pressing`` maps q to
    J_n (nc, nv), ``tangent`` to ``dq/dt`` by v (nq, nv). Friction's cone is a pyramid with 4 or 8
    ``edges``; with 2, of a machine that moves in a plane, there are nc rows of one tangent.
    """

    velocities: int
    pressing: Callable[[ca.SX], ca.SX]
    tangent: Callable[[ca.SX], ca.SX]
    edges: int

    def directions(self, rows: list[ca.SX]) -> list[ca.SX]:
        """Rows along half of the edges, the others being their negatives, from the tangents'."""
        if self.edges < 8:
            return rows
        first, second = rows
        return [first, second, *((first + sign * second) / math.sqrt(2) for sign in (1, -1))]

    def components(self, along: list[ca.SX]) -> ca.SX:
        """Impulses along the tangents, one after the other, from those along all directions."""
        if self.edges < 8:
            return ca.vertcat(*along)
        first, second, rise, fall = along
        both = ((rise + sign * fall) / math.sqrt(2) for sign in (1, -1))
        return ca.vertcat(*map(ca.plus, (first, second), both))


@dataclass(frozen=True, eq=False)
class Touching:
    """Contacts of a mechanism, nc of them, and the limits of its joints, nl.

    As the arguments of :func:`~dynamics.systems.timestepping.time_stepping` of these names.
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
    def rough(self) -> tuple[list[int], ca.SX]:
        """Contacts whose friction is not the number zero, and Coulomb's coefficients (nc, 1)."""
        nc = len(self.contacts)
        f = ca.SX.zeros(nc) if self.friction is None else ca.SX.ones(nc) * self.friction
        return [i for i in range(nc) if not f[i].is_zero()], f

    def sharp(self, curved: bool, build: Callable[[Touching], ContactSystem]) -> Sharp:
        """How the system that ``build`` makes of these contacts leads to its sharpest sibling."""
        notes = [TRUE_GAPS] if self.linearised and curved else []
        true = replace(self, linearised=False)
        if self.cone == "edges" and self.friction is not None and self.sliding is not None:
            notes.append(COULOMB)
            true = replace(true, cone="linearised")
        return Sharp(", ".join(notes), lambda: build(true)) if notes else Sharp()


@dataclass(frozen=True, eq=False)
class ContactRows:
    """The pairs of one step: ``lam`` (nlam, 1), ``gap`` (nlam, 1), and ``push`` (nq, 1) their
    generalised impulse [N s]; ``signals`` and ``pairs`` describe each, ``forces`` what they add
    up to, None where there is no friction. ``phi`` are the distances at q of contacts and limits,
    ``curved``: one of these is not affine in q.
    """

    lam: ca.SX
    gap: ca.SX
    push: ca.SX
    signals: tuple[Signal, ...]
    pairs: tuple[Pair, ...]
    forces: ContactForces | None
    phi: ca.SX | None = None
    curved: bool = False


def contact_rows(
    name: str,
    touching: Touching,
    q: ca.SX,
    q_next: ca.SX,
    way: Callable[[ca.SX], ca.SX],
    h: ca.SX | float,
) -> ContactRows:
    """Write the pairs of ``touching`` for a step of h from q to q_next.

    ``way(J)`` is how far a step goes along the rows J. The pairs are the normal ones, those of the
    limits, and what else friction's cone needs, in this order. A contact whose friction is the
    number zero has its normal pair alone; where a parameter is zero at present it has all its
    pairs, but they neither see its slip nor push.

    Raises ``ValueError`` where a dimension does not fit.
    """
    nc, nl, space = len(touching.contacts), len(touching.limit_names), touching.space
    nv = q.numel() if space is None else space.velocities

    def approached(what: str, distance: Callable[[ca.SX], ca.SX], count: int) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Distance at q, its slope there, and the gap."""
        here = distance(q)
        check_shape(name, what, here, (count, 1))
        if space is None:
            slope = ca.jacobian(here, q)
            gap = here + slope @ (q_next - q) if touching.linearised else distance(q_next)
            return here, slope, gap
        if distance is touching.distance:
            slope = space.pressing(q)
        else:
            slope = ca.jacobian(here, q) @ space.tangent(q)
        return here, slope, here + way(slope) if touching.linearised else distance(q_next)

    limits, left, forces = [], ca.SX(0, 1), None
    if touching.limits is not None:
        left, slope, gap = approached("limits(q)", touching.limits, nl)
        stops = [Signal(n, "N m s", "impulse of a joint limit") for n in touching.limit_names]
        limits = [Row("limit", gap, slope, stops)]
    phi, J, gap = approached("distance(q)", touching.distance, nc)
    plain, lam = Row("normal", gap, J, list(touching.contacts)), ca.SX.sym("lam", nc + nl)
    rows, owners = [plain], [list(range(nc))]
    rough, f = touching.rough
    if touching.sliding is not None and rough:
        J_t, tangents = touching.sliding(q), 1 if space is None else min(2, space.edges // 2)
        check_shape(name, "sliding(q)", J_t, (tangents * nc, nv))
        form, ways = FORMS[touching.cone], [J_t[nc * k : nc * (k + 1), :] for k in range(tangents)]
        directions = ways if space is None else space.directions(ways)
        lam = ca.SX.sym("lam", nc + nl + form.more(len(directions)) * len(rough))
        own = [lam[rough], *ca.vertsplit(lam[nc + nl :], len(rough))]
        some = tuple(touching.contacts[i] for i in rough)
        slid = [way(one) for one in directions]
        at = Rubbing(
            some,
            gap[rough],
            J[rough, :],
            [one[rough, :] for one in directions],
            f[rough],
            [one[rough] for one in slid],
            own,
        )
        (first, *more), pressed, rubbed = form.pairs(at)
        rows, owners = [_replaced(plain, first, rough), *more], [*owners, *[rough] * len(more)]
        normal, along = lam[:nc], ca.SX.zeros(tangents * nc)
        where = [nc * k + i for k in range(tangents) for i in rough]
        normal[rough] = pressed
        along[where] = rubbed[0] if space is None else space.components(rubbed)
        names = tuple(contact.name for contact in touching.contacts)
        forces = ContactForces(
            names, normal, along, ca.vertcat(*slid[:tangents]) / h, f, 2 if space is None else space.edges
        )
    rows[1:1], owners[1:1] = limits, [list(range(nc, nc + nl))] * len(limits)
    return ContactRows(
        lam,
        ca.vertcat(ca.SX(0, 1), *(row.gap for row in rows)),
        ca.vertcat(ca.SX(0, nv), *(row.direction for row in rows)).T @ lam,
        tuple(signal for row in rows for signal in row.signals),
        tuple(Pair(row.kind, owner) for row, owned in zip(rows, owners, strict=True) for owner in owned),
        forces,
        ca.vertcat(phi, left),
        ca.depends_on(ca.vertcat(J, *(limit.direction for limit in limits)), q),
    )


def _replaced(row: Row, part: Row, where: list[int]) -> Row:
    """``row`` with ``part`` at the places ``where``."""
    if len(where) == len(row.signals):
        return part
    gap, direction, signals = ca.SX(row.gap), ca.SX(row.direction), list(row.signals)
    gap[where], direction[where, :] = part.gap, part.direction
    for i, signal in zip(where, part.signals, strict=True):
        signals[i] = signal
    return Row(row.kind, gap, direction, signals)
