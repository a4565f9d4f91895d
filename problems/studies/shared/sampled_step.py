"""One contact step and its derivatives at many points: the laws' own graphs, evaluated in bulk."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from dynamics.batch import BatchFunction
from dynamics.contact import Step


@dataclass(frozen=True)
class StepValues:
    """Values at n points: ``x_next`` (n, nx), ``lam`` (n, nlam), ``gap`` and ``mu`` (n, nlam),

    ``x_by_x`` (n, nx, nx), ``x_by_u`` (n, nx, nu), ``lam_by_x`` (n, nlam, nx): the total
    derivatives of x_next and lam through the contact.
    """

    x_next: np.ndarray
    lam: np.ndarray
    gap: np.ndarray
    mu: np.ndarray
    x_by_x: np.ndarray
    x_by_u: np.ndarray
    lam_by_x: np.ndarray


class SampledStep:
    """A closed step, for arrays of states, inputs and parameters.

    Derivatives are :meth:`dynamics.contact.Step.contact_jacobian` at the solved impulse.
    """

    def __init__(self, step: Step) -> None:
        self._step = step
        # The path solver of several contacts is hundreds of iterations, most of them skipped by
        # CasADi's conditionals: unrolled and compiled it would take minutes to build.
        backend = "auto" if step.system.nlam <= 1 else "casadi"
        self._solve = BatchFunction(step.solve, backend)
        x, u, p, lam = step.system.x, step.system.u, step.p.vector, step.lam
        x_next = step.x_next_of_lam
        by_x, by_u = step.contact_jacobian(x), step.contact_jacobian(u)
        through = ca.jacobian(x_next, lam)
        outputs = [
            step.mu,
            ca.jacobian(x_next, x) + through @ by_x,
            ca.jacobian(x_next, u) + through @ by_u,
            by_x,
        ]
        dense = [ca.densify(output) for output in outputs]
        self._derive = BatchFunction(ca.Function("step_derivatives", [x, u, p, lam], dense))

    def __call__(
        self, x: ArrayLike, u: ArrayLike, values: Mapping[str, ArrayLike] | None = None,
        **law: ArrayLike,
    ) -> StepValues:  # fmt: skip
        """Evaluate at ``x`` (n, nx) and ``u`` (n, nu), either shared by all points as one row.

        ``values`` of parameters and ``law`` of the law's replace those of the step, each a number,
        or one for each point, see :meth:`dynamics.systems.ParameterTable.pack`.
        """
        system = self._step.system
        states, inputs, p = self._rows(x, u, self._step.p.pack(values, **law))
        n = len(states)
        x_next, lam, gap, _ = self._solve(states, inputs, p)
        mu, by_x, by_u, lam_by_x = self._derive(states, inputs, p, lam)

        def matrices(rows: np.ndarray, height: int, width: int) -> np.ndarray:
            return rows.reshape(n, width, height).transpose(0, 2, 1)

        return StepValues(
            x_next, lam, gap, mu,
            matrices(by_x, system.nx, system.nx),
            matrices(by_u, system.nx, system.nu),
            matrices(lam_by_x, self._step.n, system.nx),
        )  # fmt: skip

    def roll_out(self, x: ArrayLike, u: ArrayLike, steps: int) -> tuple[np.ndarray, np.ndarray]:
        """Repeat the step under a constant input: states (n, steps + 1, nx), lam (n, steps, nlam).

        ``x`` and ``u`` as for a call.
        """
        states, inputs, p = self._rows(x, u, self._step.p.values)
        n = len(states)
        path = np.empty((n, steps + 1, self._step.system.nx))
        impulses = np.empty((n, steps, self._step.n))
        path[:, 0] = states
        for k in range(steps):
            path[:, k + 1], impulses[:, k], _, _ = self._solve(path[:, k], inputs, p)
        return path, impulses

    @staticmethod
    def _rows(*arrays: ArrayLike) -> list[np.ndarray]:
        rows = [np.atleast_2d(np.asarray(array, dtype=float)) for array in arrays]
        n = max(len(array) for array in rows)
        return [np.broadcast_to(array, (n, array.shape[1])) for array in rows]
