"""Projection of measured states onto states that are finite and without penetration."""

from __future__ import annotations

import casadi as ca
import numpy as np

from dynamics.batch import BatchFunction
from ocp.mpc.constraint_rows import MET_TOLERANCE
from ocp.problem.problem import Problem

IGNORED_PENETRATION = 1e-9
"""Penetration, in characteristic gaps, up to which it is not corrected."""
MAX_PROJECTIONS = 5
"""Maximum number of Gauss-Newton projections of a penetrating state."""


class Measurement:
    """Projector of measured states onto states from which a plan may start."""

    def __init__(self, problem: Problem) -> None:
        self.problem, system = problem, problem.system
        phi = system.phi
        self._distances, self.names = None, [signal.name for signal in system.states]
        if phi is not None and phi.numel():
            arguments = [system.x, problem.parameters.vector]
            outputs = [ca.densify(v) for v in (phi, ca.jacobian(phi, system.x).T)]
            self._distances = BatchFunction(ca.Function("mpc_distances", arguments, outputs), threads=1)

    def project(
        self, x: np.ndarray, expected: np.ndarray, bounds: list[np.ndarray], physical: np.ndarray
    ) -> tuple[np.ndarray, list[str]]:
        """Return the state from which to plan, and notes on changes of the state and on violated bounds.

        Entries that are not finite are replaced by entries of ``expected``. Penetration is removed by the
        smallest change of the state, in characteristic sizes. A state outside ``bounds`` is not changed.
        """
        finite_state, notes = x, []
        if not np.isfinite(finite_state).all():
            finite_state = np.where(np.isfinite(finite_state), finite_state, expected)
            notes.append("the measured state is not finite; the predicted one is used there")
        moved_out = self._move_out(finite_state, physical)
        if not np.array_equal(moved_out, finite_state):
            notes.append("the measured state penetrates and was moved out of contact")
        is_outside = np.maximum(bounds[0] - moved_out, moved_out - bounds[1]) > MET_TOLERANCE * self.problem.scales.x
        if names := [self.names[i] for i in np.flatnonzero(is_outside)]:
            notes.append(f"the measured state is outside the bounds on {', '.join(names)}")
        return moved_out, notes

    def _move_out(self, x: np.ndarray, physical: np.ndarray) -> np.ndarray:
        if self._distances is None:
            return x
        scales = self.problem.scales
        for _ in range(MAX_PROJECTIONS):
            phi, by_x = (v[0] for v in self._distances(x, physical))
            penetrating = phi < -IGNORED_PENETRATION * scales.gap
            if not penetrating.any():
                break
            J = by_x.reshape(phi.size, x.size)[penetrating]
            x = x - scales.x * (np.linalg.pinv(J * scales.x) @ phi[penetrating])
        return x
