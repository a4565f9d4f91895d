"""A measured state made fit for a plan: finite, within bounds, without penetration."""

from __future__ import annotations

import casadi as ca
import numpy as np

from ocp.problem import Problem

_DEPTH = 1e-9
"""Penetration that is left alone, in characteristic gaps."""
_ROUNDS = 5


class Measurement:
    """Projection of a measured state on the states that a plan may start from."""

    def __init__(self, problem: Problem) -> None:
        self.problem, system = problem, problem.system
        phi = system.phi
        self._distances = None
        if phi is not None and phi.numel():
            given = [system.x, problem.parameters.vector]
            self._distances = ca.Function("distances", given, [phi, ca.jacobian(phi, system.x)])

    def projected(
        self, x: np.ndarray, expected: np.ndarray, bounds: list[np.ndarray], physical: np.ndarray
    ) -> tuple[np.ndarray, list[str]]:
        """The state to plan from, and what was changed.

        A state that is not finite is replaced by the ``expected`` one; one outside ``bounds`` is
        clipped; penetration is taken back by the smallest motion, in characteristic sizes.
        """
        seen, told = x, []
        if not np.isfinite(seen).all():
            seen = np.where(np.isfinite(seen), seen, expected)
            told.append("the measured state is not finite; the predicted one is used there")
        clipped = np.clip(seen, *bounds)
        if not np.array_equal(clipped, seen):
            told.append("the measured state is outside its bounds and was clipped")
        outside = self._outside(clipped, physical)
        if not np.array_equal(outside, clipped):
            told.append("the measured state is in penetration and was moved out")
        return outside, told

    def _outside(self, x: np.ndarray, physical: np.ndarray) -> np.ndarray:
        if self._distances is None:
            return x
        scales = self.problem.scales
        for _ in range(_ROUNDS):
            phi, J = (np.array(v) for v in self._distances(x, physical))
            deep = phi.ravel() < -_DEPTH * scales.gap
            if not deep.any():
                break
            x = x - scales.x * (np.linalg.pinv(J[deep] * scales.x) @ phi.ravel()[deep])
        return x
