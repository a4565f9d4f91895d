"""Identification of a model's physical parameters psi from transitions, with confidence intervals."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dynamics.batch import StepFunction
from dynamics.contact import Step
from ocp.errors import InputError, did_you_mean
from ocp.learning.explorer import Buffer
from ocp.search.random_search import RandomSearch, SearchDistribution

MAX_ROWS_AT_ONCE = 65536
"""Maximum number of simulated steps in one call, which limits memory."""


class OneStepLoss:
    """One-step loss ``L(psi; D) = sum_t 1/2 |(f(x_t, u_t; psi) - x_{t+1}) / scale|²`` of transitions D.

        loss = OneStepLoss(law.close(task.system), ["friction", "spring"])
        loss(np.log(psi), buffer)        # psi (k, n_psi) gives (k,)

    With ``scale`` 1 this is the loss of Zhang, Jin and Wang (2023), eq. 4.1, which adds squares of m, rad, m/s
    and rad/s. With :meth:`increments` as ``scale`` (nx,) all state entries have similar weight. psi are the
    parameters of ``step`` listed in ``names``; they are positive and are passed as logarithms. All other
    parameters are fixed at ``values`` (default: the step's values). If the model's step cannot be solved at
    some psi, its loss is replaced by the mean over the solved steps; L is infinite if more than half of the
    steps cannot be solved.

    Raises :class:`~ocp.errors.InputError` if ``names`` is empty or contains unknown or repeated names, or if a
    scale is not positive.
    """

    def __init__(
        self,
        step: Step,
        names: Sequence[str],
        values: Mapping[str, float] | None = None,
        scale: np.ndarray | float = 1.0,
        **engine: Any,
    ) -> None:
        available = step.p.names
        if unknown := [name for name in names if name not in available]:
            raise InputError(
                f"{step.system.name} has no parameter {unknown[0]!r}"
                f"{did_you_mean(unknown[0], available)}; there are {', '.join(available)}"
            )
        if not names or len(set(names)) < len(names):
            raise InputError(f"name each parameter to learn once, got {', '.join(names) or 'none'}")
        self.names = tuple(names)
        self.p = step.p.pack(values)
        self.scale = np.broadcast_to(np.asarray(scale, dtype=float), (step.system.nx,))
        if not (np.isfinite(self.scale).all() and (self.scale > 0).all()):
            raise InputError("scales of errors must be positive and finite")
        self._columns = [available.index(name) for name in names]
        self._step = StepFunction(step, **engine)

    def start(self, values: Mapping[str, float] | None = None) -> np.ndarray:
        """Return log psi (n_psi,) at ``values``, a mapping from names; names that it lacks have the step's values.

        Raises :class:`~ocp.errors.InputError` if a value is not positive.
        """
        values_by_name = values or {}
        defaults = dict(zip(self.names, self.p[self._columns], strict=True))
        psi = np.array([values_by_name.get(name, value) for name, value in defaults.items()], dtype=float)
        if nonpositive := [n for n, v in zip(self.names, psi, strict=True) if not 0 < v < np.inf]:
            raise InputError(
                f"{nonpositive[0]} is learned by its logarithm, so it must start positive, got"
                f" {psi[self.names.index(nonpositive[0])]:g}; give another start or leave it out"
            )
        return np.log(psi)

    def errors(self, log_psi: np.ndarray, buffer: Buffer) -> np.ndarray:
        """Return the scaled one-step errors (k, n, nx) at ``log_psi`` (k, n_psi), NaN for unsolved steps."""
        log_psi, n = np.atleast_2d(log_psi), len(buffer)
        errors = np.empty((len(log_psi), n, buffer.x.shape[1]))
        candidates_at_once = max(1, MAX_ROWS_AT_ONCE // max(n, 1))
        for first in range(0, len(log_psi), candidates_at_once):
            candidates = log_psi[first : first + candidates_at_once]
            k = len(candidates)
            p = np.repeat(self.parameters(candidates), n, axis=0)
            steps = self._step(np.tile(buffer.x, (k, 1)), np.tile(buffer.u, (k, 1)), p)
            errors[first : first + k] = steps.x_next.reshape(k, n, -1) - buffer.x_next
        return errors / self.scale

    def parameters(self, log_psi: np.ndarray) -> np.ndarray:
        """Return the step's full parameter vectors (k, np) at ``log_psi`` (k, n_psi)."""
        p = np.tile(self.p, (len(log_psi), 1))
        p[:, self._columns] = np.exp(log_psi)
        return p

    def __call__(self, log_psi: np.ndarray, buffer: Buffer) -> np.ndarray:
        """Return the loss L (k,) at ``log_psi`` (k, n_psi)."""
        return self._mean(0.5 * np.sum(self.errors(log_psi, buffer) ** 2, axis=2)) * len(buffer)

    def sensitivity(self, log_psi: np.ndarray, width: float, buffer: Buffer) -> np.ndarray:
        """Return the sensitivity (n_psi,) of the model's steps to each entry of ``log_psi`` (n_psi,).

        The sensitivity is the square root of ``mean_t 1/2 |(f(psi') - f(psi)) / scale|²``, where psi' has the
        entry moved up or down by ``width``, in the direction of smaller effect. The measured next states are
        not used.
        """
        n = len(log_psi)
        perturbed = log_psi + width * np.concatenate([np.eye(n), -np.eye(n), np.zeros((1, n))])
        errors = self.errors(perturbed, buffer)
        changes = self._mean(0.5 * np.sum((errors[:-1] - errors[-1]) ** 2, axis=2))
        return np.sqrt(np.minimum(changes[:n], changes[n:]))

    @staticmethod
    def _mean(losses: np.ndarray) -> np.ndarray:
        """Return the mean (k,) over the finite ``losses`` of each row (k, n), infinite if less than half are finite."""
        finite = np.isfinite(losses)
        share = finite.mean(axis=1)
        total = np.where(finite, losses, 0.0).mean(axis=1)
        return np.divide(total, share, out=np.full(len(losses), np.inf), where=share >= 0.5)

    def in_scales_of(self, buffer: Buffer) -> OneStepLoss:
        """Return a copy of this loss whose scale is the :meth:`increments` of ``buffer``."""
        copied = copy.copy(self)
        copied.scale = self.increments(buffer)
        return copied

    @staticmethod
    def increments(buffer: Buffer) -> np.ndarray:
        """Return the standard deviation (nx,) of ``x_next - x``, or 1 for a state entry that does not vary."""
        spread = (buffer.x_next - buffer.x).std(axis=0)
        return np.where(spread > 0, spread, 1.0)


CANDIDATE_STREAM = 1
"""Index of the random stream from which candidates are drawn."""
ROW_STREAM = 2
"""Index of the random stream that selects the transitions on which candidates are compared."""


@dataclass(frozen=True, eq=False)
class Identification:
    """Identified parameters psi, ``values`` (n,) in the order of ``names``, and the history of the search.

    ``loss`` is the one-step loss over all transitions divided by their number, and ``start_loss`` the same at
    the start of the search. In each iteration of all passes, exp of the search distribution's mean is a row of
    ``model_params`` (k, n), and its standard deviations of log psi are a row of ``spread`` (k, n).
    """

    names: tuple[str, ...]
    values: np.ndarray
    loss: float
    start_loss: float
    model_params: np.ndarray = field(repr=False)
    spread: np.ndarray = field(repr=False)


def search_iteration(
    loss: OneStepLoss,
    buffer: Buffer,
    search: RandomSearch,
    distribution: SearchDistribution,
    seed: list[int],
    rows: int,
) -> SearchDistribution:
    """Return the search distribution after an iteration in which candidates are compared on ``rows`` transitions.

    The transitions are drawn at random. Random numbers depend only on the seed and the iteration's number.
    """
    count = int(distribution.count)
    judging_rows = buffer
    if rows < len(buffer):
        chosen = np.random.default_rng([*seed, count, ROW_STREAM]).choice(len(buffer), rows, replace=False)
        judging_rows = buffer[np.sort(chosen)]
    rng = np.random.default_rng([*seed, count, CANDIDATE_STREAM])
    return search.iterate(distribution, lambda candidates: loss(candidates, judging_rows), rng)


def identify(
    loss: OneStepLoss,
    buffer: Buffer,
    start: np.ndarray,
    search: RandomSearch | None = None,
    seed: int = 0,
    rows: int = 128,
) -> Identification:
    """Minimise the one-step ``loss`` over log psi from ``start`` (n_psi,) by random search.

    Every iteration compares candidates on ``rows`` random transitions. The start and the final means of all
    passes are then compared on all transitions, and the best of them is returned. Sensitivities are also
    computed on all transitions.

    Raises :class:`~ocp.errors.InputError` for an empty ``buffer`` and for ``rows`` below 1.
    """
    if not len(buffer) or rows < 1:
        raise InputError(f"psi is learned from transitions: got {len(buffer)}, {rows} at a time")
    search = search or RandomSearch()
    distributions, ends = [search.begin(start)], [np.asarray(start, dtype=float)]
    for number in range(search.passes):
        if number:
            sensitivity = loss.sensitivity(ends[-1], search.width, buffer)
            distributions.append(search.begin(ends[-1], sensitivity, start))
        while not search.is_done(distributions[-1]):
            distributions.append(search_iteration(loss, buffer, search, distributions[-1], [seed, number], rows))
        ends.append(distributions[-1].mean)
    losses = loss(np.array(ends), buffer) / len(buffer)
    return Identification(
        names=loss.names,
        values=np.exp(ends[int(np.argmin(losses))]),
        loss=float(losses.min()),
        start_loss=float(losses[0]),
        model_params=np.exp([d.mean for d in distributions]),
        spread=np.array([search.deviations(d) for d in distributions]),
    )


N_RESAMPLES = 400
"""Number of bootstrap resamples for an interval."""
INTERVAL_TAIL = (1 - 0.95) / 2
"""Probability below an interval, and equally above it; the interval contains 95 %."""
DIFFERENCE_STEP = 1e-4
"""Step of log psi for central differences."""
FLAT_EIGENVALUE_RATIO = 1e-10
"""Maximum ratio of an eigenvalue of a flat direction to the largest eigenvalue of the information matrix."""
UNDETERMINED_SHARE = 0.05
"""Norm of the projection of a parameter's axis onto flat directions, above which the parameter is undetermined."""


@dataclass(frozen=True, eq=False)
class Intervals:
    """Intervals from ``low`` (n,) to ``high`` (n,) of psi, [0, inf] for entries that the data do not determine.

    ``information`` (n, n) is the mean over transitions of ``J_t' J_t``, where J_t is the derivative of
    the scaled errors with respect to log psi.
    """

    low: np.ndarray
    high: np.ndarray
    information: np.ndarray


def bootstrap_intervals(
    loss: OneStepLoss,
    log_psi: np.ndarray,
    buffer: Buffer,
    seed: int = 0,
) -> Intervals:
    """Return 95 % intervals of psi by a bootstrap over transitions, with one Gauss-Newton step per resample.

    With J_t and errors r_t at ``log_psi`` (n_psi,), the minimum of resample b is approximated by ``log_psi -
    (sum_b J_t'J_t)^(-1) sum_b J_t' r_t``. The interval contains 95 % of the 400 minima and, in any case, the
    identified value. It measures the noise in the data and, for exact data, the distance of the search from the
    minimum. J_t is computed by central differences; transitions whose step cannot be solved near ``log_psi``
    are left out. Each parameter has its own interval, between two-sided quantiles.
    """
    J, r = _jacobians_and_errors(loss, log_psi, buffer)
    products = np.einsum("tia,tib->tab", J, J), np.einsum("tia,ti->ta", J, r)
    information = products[0].mean(axis=0)
    eigenvalues, axes = np.linalg.eigh(information)
    unseen = eigenvalues <= FLAT_EIGENVALUE_RATIO * eigenvalues[-1]
    undetermined = np.linalg.norm(axes[:, unseen], axis=1) > UNDETERMINED_SHARE
    seen_axes = axes[:, ~unseen]
    rng = np.random.default_rng([seed, 0])
    n = len(J)
    minima = [log_psi]
    for _ in range(N_RESAMPLES):
        weights = np.bincount(rng.integers(n, size=n), minlength=n)
        H = seen_axes.T @ np.tensordot(weights, products[0], 1) @ seen_axes
        minima.append(log_psi - seen_axes @ np.linalg.lstsq(H, seen_axes.T @ (weights @ products[1]))[0])
    low, high = np.quantile(minima[1:], [INTERVAL_TAIL, 1 - INTERVAL_TAIL], axis=0)
    return Intervals(
        np.where(undetermined, 0.0, np.exp(np.minimum(low, log_psi))),
        np.where(undetermined, np.inf, np.exp(np.maximum(high, log_psi))),
        information,
    )


def _jacobians_and_errors(loss: OneStepLoss, log_psi: np.ndarray, buffer: Buffer) -> tuple[np.ndarray, np.ndarray]:
    """Return Jacobians (t, nx, n_psi) and errors (t, nx) of the transitions for which both are finite."""
    n = len(log_psi)
    perturbed = log_psi + DIFFERENCE_STEP * np.concatenate([np.zeros((1, n)), np.eye(n), -np.eye(n)])
    errors = loss.errors(perturbed, buffer)
    finite = np.isfinite(errors).all(axis=(0, 2))
    slopes = (errors[1 : n + 1] - errors[n + 1 :]) / (2 * DIFFERENCE_STEP)
    return np.moveaxis(slopes, 0, 2)[finite], errors[0][finite]
