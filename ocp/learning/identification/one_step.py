"""How far a model's next states are from those that were seen, as its parameters vary."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dynamics.batch import StepFunction
from dynamics.contact import Step
from ocp.errors import InputError, did_you_mean
from ocp.learning.explorer import Buffer

ROWS_AT_ONCE = 65536
"""Steps of one call, which bounds its memory."""


class OneStepLoss:
    """``L(psi; D) = sum_t 1/2 |(f(x_t, u_t; psi) - x_{t+1}) / scale|²`` [abs eq. 4.1].

        loss = OneStepLoss(law.close(task.system), ["friction", "spring"])
        loss(np.log(psi), buffer)        # psi (k, n_psi) gives (k,)

    psi are positive parameters of ``step`` by name, searched by their logarithms; the others have
    ``values``, by default the step's own. ``scale`` (nx,) divides the errors: 1 is the equation,
    whose sum adds squares of m, rad, m/s and rad/s; :meth:`increments` gives all coordinates a say.

    A step that cannot be solved at some psi counts as the mean of those that can; L is infinite
    where less than half of them are.

    Raises :class:`~ocp.errors.InputError` for unknown names, no name, one named twice, and scales
    that are not positive.
    """

    def __init__(
        self,
        step: Step,
        names: Sequence[str],
        values: Mapping[str, float] | None = None,
        scale: np.ndarray | float = 1.0,
        **engine: Any,
    ) -> None:
        known = step.p.names
        if unknown := [name for name in names if name not in known]:
            raise InputError(
                f"{step.system.name} has no parameter {unknown[0]!r}"
                f"{did_you_mean(unknown[0], known)}; there are {', '.join(known)}"
            )
        if not names or len(set(names)) < len(names):
            raise InputError(f"name each parameter to learn once, got {', '.join(names) or 'none'}")
        self.names = tuple(names)
        self.p = step.p.pack(values)
        self.scale = np.broadcast_to(np.asarray(scale, dtype=float), (step.system.nx,))
        if not (np.isfinite(self.scale).all() and (self.scale > 0).all()):
            raise InputError("scales of errors must be positive and finite")
        self._places = [known.index(name) for name in names]
        self._step = StepFunction(step, **engine)

    def start(self, values: Mapping[str, float] | None = None) -> np.ndarray:
        """Logarithms (n_psi,) of ``values`` by name, those not given being the step's.

        Raises :class:`~ocp.errors.InputError` where one is not positive.
        """
        given = values or {}
        known = dict(zip(self.names, self.p[self._places], strict=True))
        psi = np.array([given.get(name, value) for name, value in known.items()], dtype=float)
        if bad := [n for n, v in zip(self.names, psi, strict=True) if not 0 < v < np.inf]:
            raise InputError(
                f"{bad[0]} is learned by its logarithm, so it must start positive, got"
                f" {psi[self.names.index(bad[0])]:g}; give another start or leave it out"
            )
        return np.log(psi)

    def errors(self, log_psi: np.ndarray, buffer: Buffer) -> np.ndarray:
        """Scaled errors (k, n, nx) at ``log_psi`` (k, n_psi); NaN where a step is not solved."""
        log_psi, n = np.atleast_2d(log_psi), len(buffer)
        found = np.empty((len(log_psi), n, buffer.x.shape[1]))
        many = max(1, ROWS_AT_ONCE // max(n, 1))
        for first in range(0, len(log_psi), many):
            some = log_psi[first : first + many]
            k = len(some)
            p = np.repeat(self.parameters(some), n, axis=0)
            steps = self._step(np.tile(buffer.x, (k, 1)), np.tile(buffer.u, (k, 1)), p)
            found[first : first + k] = steps.x_next.reshape(k, n, -1) - buffer.x_next
        return found / self.scale

    def parameters(self, log_psi: np.ndarray) -> np.ndarray:
        """All parameters of the step (k, np) at ``log_psi`` (k, n_psi)."""
        p = np.tile(self.p, (len(log_psi), 1))
        p[:, self._places] = np.exp(log_psi)
        return p

    def __call__(self, log_psi: np.ndarray, buffer: Buffer) -> np.ndarray:
        """``L`` (k,) at ``log_psi`` (k, n_psi)."""
        return self._mean(0.5 * np.sum(self.errors(log_psi, buffer) ** 2, axis=2)) * len(buffer)

    def sensitivity(self, log_psi: np.ndarray, width: float, buffer: Buffer) -> np.ndarray:
        """Root of what each parameter, ``width`` up and down, moves the model by, (n_psi,).

        Of ``mean_t 1/2 |(f(psi') - f(psi)) / scale|²``, whatever was seen.
        """
        n = len(log_psi)
        around = log_psi + width * np.concatenate([np.eye(n), -np.eye(n), np.zeros((1, n))])
        errors = self.errors(around, buffer)
        moved = self._mean(0.5 * np.sum((errors[:-1] - errors[-1]) ** 2, axis=2))
        return np.sqrt(np.minimum(moved[:n], moved[n:]))

    @staticmethod
    def _mean(each: np.ndarray) -> np.ndarray:
        """Means (k,) of those of ``each`` (k, n) that are numbers, if they are half or more."""
        known = np.isfinite(each)
        share = known.mean(axis=1)
        total = np.where(known, each, 0.0).mean(axis=1)
        return np.divide(total, share, out=np.full(len(each), np.inf), where=share >= 0.5)

    def in_scales_of(self, buffer: Buffer) -> OneStepLoss:
        """The same loss with :meth:`increments` of ``buffer`` for its scale."""
        other = copy.copy(self)
        other.scale = self.increments(buffer)
        return other

    @staticmethod
    def increments(buffer: Buffer) -> np.ndarray:
        """Standard deviation of ``x_next - x`` (nx,), 1 for a coordinate that never moves."""
        spread = (buffer.x_next - buffer.x).std(axis=0)
        return np.where(spread > 0, spread, 1.0)
