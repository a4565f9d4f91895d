"""Couplings of joints: linear equations between the positions of hinges and slides."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from dynamics.systems.space.body import Body
from dynamics.systems.space.tree import Tree


@dataclass(frozen=True)
class Coupling:
    """The equation ``sum(coefficients[body] * q[body]) = value`` between positions of hinges and slides.

    The first body's joint depends on the others. The equation holds exactly at the end of a step, due to
    forces that do no work on the motions that it allows. ``value`` has the unit of the first body's q.
    """

    coefficients: Mapping[str, float]
    value: float = 0.0


class CoupledJoints:
    """All couplings of a tree: ``A p = b`` for the positions p of its hinges and slides.

    ``dependent`` are indices into v of the dependent joints, ``independent`` all others, and
    ``basis`` (nv, nv - m) the velocities that the couplings allow, ``v = basis v[independent]``.

    Raises ``ValueError`` for an unknown body, for a joint that is neither a hinge nor a slide, and for
    couplings that contradict or repeat each other.
    """

    def __init__(self, tree: Tree, couplings: Sequence[Coupling]) -> None:
        self.A, self.b = np.zeros((len(couplings), tree.nv)), np.array([c.value for c in couplings])
        for row, coupling in zip(self.A, couplings, strict=True):
            for name, coefficient in coupling.coefficients.items():
                body: Body | None = tree.bodies.get(name)
                if body is None or body.joint not in ("hinge", "slide"):
                    raise ValueError(f"{name!r} is coupled, but is neither a hinge nor a slide")
                row[tree.v_of[name]] = coefficient
        self.dependent = [tree.v_of[next(iter(c.coefficients))].start for c in couplings]
        self.independent = [i for i in range(tree.nv) if i not in self.dependent]
        square = self.A[:, self.dependent]
        if np.linalg.matrix_rank(square) < len(couplings):
            raise ValueError("couplings of joints contradict or repeat each other; give each joint one")
        self.A, self.b = np.linalg.solve(square, self.A), np.linalg.solve(square, self.b)
        self.basis = np.zeros((tree.nv, len(self.independent)))
        self.basis[self.independent] = np.eye(len(self.independent))
        self.basis[self.dependent] = -self.A[:, self.independent]

    def close(self, tree: Tree, q: ca.SX) -> ca.SX:
        """Return q (nq, 1) with the dependent joints at positions that satisfy the couplings."""
        closed, position = ca.SX(q), tree.position_of(q)
        indices = {tree.v_of[name].start: q_slice for name, q_slice in tree.q_of.items()}
        for k, i in enumerate(self.dependent):
            independent_part = self.A[k : k + 1, self.independent] @ position[self.independent]
            closed[indices[i]] = self.b[k] - independent_part
        return closed

    def constrain(self, force: ca.SX, position: ca.SX, v_next: ca.SX, h: ca.SX | float) -> ca.SX:
        """Return the equations of motion (nv, 1): the dynamics along ``basis``, and the couplings.

        ``force`` (nv, 1) is the residual without couplings, and ``position`` (nv, 1) contains the positions of hinges
        and slides before the step. Rows of dependent joints become ``A v+ + (A p - b) / h = 0``, so that the
        couplings hold at the end of the step.
        """
        rows = ca.SX(force)
        rows[self.independent] = self.basis.T @ force
        rows[self.dependent] = self.A @ v_next + (self.A @ position - self.b) / h
        return rows
