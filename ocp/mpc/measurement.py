"""Projection of measured states onto states that are finite and without penetration."""

from __future__ import annotations

import numpy as np

from ocp.judge.constraint_rows import MET_TOLERANCE
from ocp.mpc.compiled_sample import IGNORED_PENETRATION, MAX_PROJECTIONS, PhaseSample
from ocp.mpc.stages import StageModel


class Measurement:
    """Projector of measured states onto states from which a plan may start."""

    def __init__(self, model: StageModel) -> None:
        self.model, self.names = model, [signal.name for signal in model.problem.system.states]
        self._tolerance = MET_TOLERANCE * model.problem.scales.x

    def project(
        self,
        x: np.ndarray,
        expected: np.ndarray,
        bounds: list[np.ndarray],
        physical: np.ndarray,
        compiled: PhaseSample | None = None,
    ) -> tuple[np.ndarray, list[str]]:
        """Return the state from which to plan, and notes on changes of the state and on violated bounds.

        Entries that are not finite are replaced by entries of ``expected``. Penetration is removed by the
        smallest change of the state, in characteristic sizes. A state outside ``bounds`` is not changed.
        """
        finite_state, notes = x, []
        if not np.isfinite(finite_state).all():
            finite_state = np.where(np.isfinite(finite_state), finite_state, expected)
            notes.append("the measured state is not finite; the predicted one is used there")
        moved_out = (self._move_out if compiled is None else compiled.move_out)(finite_state, physical)
        if (moved_out != finite_state).any():
            notes.append("the measured state penetrates and was moved out of contact")
        is_outside = np.maximum(bounds[0] - moved_out, moved_out - bounds[1]) > self._tolerance
        if is_outside.any():
            names = [self.names[i] for i in np.flatnonzero(is_outside)]
            notes.append(f"the measured state is outside the bounds on {', '.join(names)}")
        return moved_out, notes

    def _move_out(self, x: np.ndarray, physical: np.ndarray) -> np.ndarray:
        distances, scales = self.model.distances, self.model.problem.scales
        if distances is None:
            return x
        for _ in range(MAX_PROJECTIONS):
            phi, by_x = (v[0] for v in distances(x, physical))
            penetrating = phi < -IGNORED_PENETRATION * scales.gap
            if not penetrating.any():
                break
            J = by_x.reshape(phi.size, x.size)[penetrating]
            x = x - scales.x * (np.linalg.pinv(J * scales.x) @ phi[penetrating])
        return x
