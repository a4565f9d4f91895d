"""A body that slides on a table and is pushed, without friction, on one of its sides at a time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from dynamics.systems import ContactSystem, ParameterTable, signals
from dynamics.systems.pairs import RefereeModel
from ocp.problem.problem import Constraint
from problems.drawing import ContactFrame, Segment, Shape

Corner = tuple[ca.SX | float, ca.SX | float]


@dataclass(frozen=True)
class SidePushing:
    """Quasi-static motion of a body with ``corners`` (counter-clockwise, in the body's frame) [m].

    The inputs are a force F_i >= 0 [N] for each side and a moment m [N m]. A side pushes with the
    excess of its force over the sum of all others, ``w_i = max(F_i - sum_(j != i) F_j, 0)``, stated
    as ``0 <= w_i ⟂ w_i - F_i + sum_(j != i) F_j >= 0``: at most one side pushes, at any point of its
    length, so that ``|m| <= sum_i w_i L_i / 2``. The limit surface is a sphere in (force,
    moment / ``reach``), and ``friction m g`` [N] is the maximum friction force with the table::

        (x', y') = R(theta) sum_i w_i n_i / (friction m g)
        theta' = (m + sum_i w_i (c_i x n_i)) / (reach friction m g)

    with n_i the inner normal, c_i the midpoint and L_i the length of side i. ``reach`` [m] is a
    characteristic length times a factor; the other numbers are among ``parameters``. Steps of length h use the
    explicit Euler method.
    """

    name: str
    corners: Sequence[Corner]
    reach: ca.SX
    parameters: ParameterTable

    @cached_property
    def _sides(self) -> list[tuple[ca.SX, ca.SX, ca.SX]]:
        """Midpoint, inner normal and half length of every side."""
        sides, ends = [], [ca.vertcat(*(ca.SX(v) for v in corner)) for corner in self.corners]
        for first, second in zip(ends, ends[1:] + ends[:1], strict=True):
            edge = second - first
            length = ca.norm_2(edge)
            sides.append(((first + second) / 2, ca.vertcat(-edge[1], edge[0]) / length, length / 2))
        return sides

    @cached_property
    def system(self) -> ContactSystem:
        """Contact system with states x, y, theta, inputs F_i and m, and one multiplier w_i [N] per side."""
        n, p = len(self.corners), self.parameters
        x, x_next, u, w = (ca.SX.sym(s, k) for s, k in (("x", 3), ("x_next", 3), ("u", n + 1), ("w", n)))
        force, moment = ca.SX(2, 1), u[n]
        for i, (middle, normal, _) in enumerate(self._sides):
            force += w[i] * normal
            moment += w[i] * (middle[0] * normal[1] - middle[1] * normal[0])
        cos, sin = ca.cos(x[2]), ca.sin(x[2])
        rate = ca.vertcat(cos * force[0] - sin * force[1], sin * force[0] + cos * force[1], moment / self.reach)
        sides = range(1, n + 1)
        return ContactSystem(
            name=self.name,
            x=x,
            u=u,
            x_next=x_next,
            lam=w,
            residual=x_next - x - p["h"] * rate / (p["friction"] * p["m"] * p["g"]),
            gap=w + ca.sum1(u[:n]) - 2 * u[:n],
            states=signals("x [m] body; y [m] body; theta [rad] body, anticlockwise"),
            inputs=signals(
                "; ".join(
                    [
                        *(f"F{i} [N] force at side {i}" for i in sides),
                        "m [N m] moment of the force about the side's middle",
                    ]
                )
            ),
            contacts=signals("; ".join(f"side{i} [N] force of side {i}" for i in sides)),
            h=p["h"],
            parameters=p,
            gap_unit="N",
            referee_model=RefereeModel(),
            refinable=True,
        )

    @cached_property
    def on_the_side(self) -> Constraint:
        """Constraint that the pushing force acts between the two ends of its side."""
        system = self.system
        largest_moment = sum((system.lam[i] * half_length for i, (*_, half_length) in enumerate(self._sides)), ca.SX(0))
        m = system.u[len(self.corners)]
        return Constraint("on the side", ca.vertcat(largest_moment - m, largest_moment + m), 0.0, ca.inf)

    @property
    def u_lower(self) -> ca.SX:
        """Lower bounds of the inputs: 0 for forces, none for the moment."""
        return ca.vertcat(ca.SX.zeros(len(self.corners)), -ca.inf)


def outline(corners: Sequence[tuple[float, float]], pose: np.ndarray, role: str) -> list[Shape]:
    """Draw the sides of a body at a pose (x, y, theta)."""
    return [Segment(*ends, role) for ends in _sides_at(corners, pose)]


def side_frames(corners: Sequence[tuple[float, float]], pose: np.ndarray) -> list[ContactFrame]:
    """Return a contact frame at the middle of every side, although a moment shifts the point where a side pushes."""
    contact_frames = []
    for x1, y1, x2, y2 in _sides_at(corners, pose):
        length = math.hypot(x2 - x1, y2 - y1)
        middle = (x1 + x2) / 2, (y1 + y2) / 2
        contact_frames.append(ContactFrame(*middle, (y1 - y2) / length, (x2 - x1) / length))
    return contact_frames


def _sides_at(corners: Sequence[tuple[float, float]], pose: np.ndarray) -> list[tuple[float, float, float, float]]:
    x0, y0, angle = (float(value) for value in pose)
    cos, sin = math.cos(angle), math.sin(angle)
    ends = [(x0 + cos * x - sin * y, y0 + sin * x + cos * y) for x, y in corners]
    return [(*a, *b) for a, b in zip(ends, ends[1:] + ends[:1], strict=True)]
