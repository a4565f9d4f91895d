"""A measured state made fit for a plan: finite, and without penetration."""

from __future__ import annotations

import casadi as ca
import numpy as np

from ocp.mpc.constraint_rows import MET
from ocp.problem.problem import Problem

_DEPTH = 1e-9
"""Penetration that is left alone, in characteristic gaps."""
_ROUNDS = 5


class Measurement:
    """Projection of a measured state on the states that a plan may start from."""

    def __init__(self, problem: Problem) -> None:
        self.problem, system = problem, problem.system
        phi = system.phi
        self._distances, self.names = None, [signal.name for signal in system.states]
        if phi is not None and phi.numel():
            given = [system.x, problem.parameters.vector]
            self._distances = ca.Function("distances", given, [phi, ca.jacobian(phi, system.x)])

    def projected(
        self, x: np.ndarray, expected: np.ndarray, bounds: list[np.ndarray], physical: np.ndarray
    ) -> tuple[np.ndarray, list[str]]:
        """The state to plan from, and what was changed or is not as a plan wants it.

        A state that is not finite is replaced by the ``expected`` one; penetration is taken back by
        the smallest motion, in characteristic sizes. One outside ``bounds`` is planned from as it
        is.
        """
        seen, told = x, []
        if not np.isfinite(seen).all():
            seen = np.where(np.isfinite(seen), seen, expected)
            told.append("the measured state is not finite; the predicted one is used there")
        outside = self._outside(seen, physical)
        if not np.array_equal(outside, seen):
            told.append("the measured state is in penetration and was moved out")
        beyond = np.maximum(bounds[0] - outside, outside - bounds[1]) > MET * self.problem.scales.x
        if names := [self.names[i] for i in np.flatnonzero(beyond)]:
            told.append(f"the measured state is outside the bounds on {', '.join(names)}")
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
