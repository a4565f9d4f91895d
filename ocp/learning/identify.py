"""Physical parameters psi of a model from transitions: the one-step loss, its search, intervals."""

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
from ocp.learning.random_search import Cloud, RandomSearch

MAX_ROWS_AT_ONCE = 65536
"""Largest number of steps in one call, which bounds its memory."""


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
        self._places = [available.index(name) for name in names]
        self._step = StepFunction(step, **engine)

    def start(self, values: Mapping[str, float] | None = None) -> np.ndarray:
        """Return logarithms (n_psi,) of ``values`` by name; the others are the step's.

        Raises :class:`~ocp.errors.InputError` where one is not positive.
        """
        values_by_name = values or {}
        defaults = dict(zip(self.names, self.p[self._places], strict=True))
        psi = np.array([values_by_name.get(name, value) for name, value in defaults.items()], dtype=float)
        if nonpositive := [n for n, v in zip(self.names, psi, strict=True) if not 0 < v < np.inf]:
            raise InputError(
                f"{nonpositive[0]} is learned by its logarithm, so it must start positive, got"
                f" {psi[self.names.index(nonpositive[0])]:g}; give another start or leave it out"
            )
        return np.log(psi)

    def errors(self, log_psi: np.ndarray, buffer: Buffer) -> np.ndarray:
        """Return scaled errors (k, n, nx) at ``log_psi`` (k, n_psi); NaN for unsolved steps."""
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
        """Return all parameters of the step (k, np) at ``log_psi`` (k, n_psi)."""
        p = np.tile(self.p, (len(log_psi), 1))
        p[:, self._places] = np.exp(log_psi)
        return p

    def __call__(self, log_psi: np.ndarray, buffer: Buffer) -> np.ndarray:
        """``L`` (k,) at ``log_psi`` (k, n_psi)."""
        return self._mean(0.5 * np.sum(self.errors(log_psi, buffer) ** 2, axis=2)) * len(buffer)

    def sensitivity(self, log_psi: np.ndarray, width: float, buffer: Buffer) -> np.ndarray:
        """Return the root of each parameter's effect on the model at ``width`` up and down, (n_psi,).

        The effect is ``mean_t 1/2 |(f(psi') - f(psi)) / scale|²``, which does not use the next states.
        """
        n = len(log_psi)
        perturbed = log_psi + width * np.concatenate([np.eye(n), -np.eye(n), np.zeros((1, n))])
        errors = self.errors(perturbed, buffer)
        changes = self._mean(0.5 * np.sum((errors[:-1] - errors[-1]) ** 2, axis=2))
        return np.sqrt(np.minimum(changes[:n], changes[n:]))

    @staticmethod
    def _mean(losses: np.ndarray) -> np.ndarray:
        """Means (k,) of those of ``losses`` (k, n) that are numbers, if they are half or more."""
        finite = np.isfinite(losses)
        share = finite.mean(axis=1)
        total = np.where(finite, losses, 0.0).mean(axis=1)
        return np.divide(total, share, out=np.full(len(losses), np.inf), where=share >= 0.5)

    def in_scales_of(self, buffer: Buffer) -> OneStepLoss:
        """Return the same loss with :meth:`increments` of ``buffer`` as its scale."""
        other = copy.copy(self)
        other.scale = self.increments(buffer)
        return other

    @staticmethod
    def increments(buffer: Buffer) -> np.ndarray:
        """Return the standard deviation of ``x_next - x`` (nx,), 1 for a coordinate that never moves."""
        spread = (buffer.x_next - buffer.x).std(axis=0)
        return np.where(spread > 0, spread, 1.0)


CANDIDATE_STREAM = 1
"""Number of the random stream of candidates."""
ROW_STREAM = 2
"""Number of the random stream of the transitions that judge them."""


@dataclass(frozen=True, eq=False)
class Identification:
    """Identified parameters psi, ``values`` (n,) in the order of ``names``, and the course of the search.

    ``loss`` is that of eq. 4.1 on all transitions, divided by their number. ``model_params`` (k, n)
    are the means of the search distribution, first its start, and ``spread`` (k, n) its standard
    deviations of log psi; each pass begins where the last one ended.
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
    cloud: Cloud,
    seed: list[int],
    rows: int,
) -> Cloud:
    """Run one iteration of the search; the candidates are compared on the same ``rows`` random transitions.

    Random numbers depend on the seed and the number of the iteration alone.
    """
    count = int(cloud["count"])
    judging_rows = buffer
    if rows < len(buffer):
        chosen = np.random.default_rng([*seed, count, ROW_STREAM]).choice(len(buffer), rows, replace=False)
        judging_rows = buffer[np.sort(chosen)]
    rng = np.random.default_rng([*seed, count, CANDIDATE_STREAM])
    return search.iterate(cloud, lambda candidates: loss(candidates, judging_rows), rng)


def identify(
    loss: OneStepLoss,
    buffer: Buffer,
    start: np.ndarray,
    search: RandomSearch | None = None,
    seed: int = 0,
    rows: int = 128,
) -> Identification:
    """Minimise ``loss`` over log psi from ``start`` (n_psi,) by random search [abs eq. 4.1].

    Every iteration is judged by ``rows`` transitions; all of them choose between the start and the
    last means of the passes, and tell how sensitive the model is.

    Raises :class:`~ocp.errors.InputError` without transitions and for ``rows`` below 1.
    """
    if not len(buffer) or rows < 1:
        raise InputError(f"psi is learned from transitions: got {len(buffer)}, {rows} at a time")
    search = search or RandomSearch()
    clouds, ends = [search.begin(start)], [np.asarray(start, dtype=float)]
    for number in range(search.passes):
        if number:
            moves = loss.sensitivity(ends[-1], search.width, buffer)
            clouds.append(search.begin(ends[-1], moves, start))
        while not search.is_done(clouds[-1]):
            clouds.append(search_iteration(loss, buffer, search, clouds[-1], [seed, number], rows))
        ends.append(clouds[-1]["mean"])
    losses = loss(np.array(ends), buffer) / len(buffer)
    return Identification(
        names=loss.names,
        values=np.exp(ends[int(np.argmin(losses))]),
        loss=float(losses.min()),
        start_loss=float(losses[0]),
        model_params=np.exp([cloud["mean"] for cloud in clouds]),
        spread=np.array([search.deviations(cloud) for cloud in clouds]),
    )


N_RESAMPLES = 400
"""Number of bootstrap resamples."""
INTERVAL_TAIL = (1 - 0.95) / 2
"""Probability on either side of an interval."""
DIFFERENCE_STEP = 1e-4
"""Step of log psi in central differences."""
FLAT_EIGENVALUE_RATIO = 1e-10
"""Eigenvalue of the information, relative to the largest, below which a direction is flat."""
UNDETERMINED_SHARE = 0.05
"""Component of a parameter's axis in flat directions above which it is not determined."""


@dataclass(frozen=True, eq=False)
class Intervals:
    """Intervals ``low`` to ``high`` (n,) of psi; [0, inf] where the transitions do not determine it.

    ``information`` (n, n) is the mean over transitions of ``J_t' J_t``, J_t the derivative of the
    scaled errors by log psi.
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
    """Bootstrap over transitions; each resample's minimum is one Gauss-Newton step away.

    With J_t and errors r_t at ``log_psi`` (n_psi,), resample b's minimum is ``log_psi -
    (sum_b J_t'J_t)^(-1) sum_b J_t' r_t``. The interval has 95 % of the 400 minima and reaches to
    what was found: it measures the noise in the data and, where those are exact, the distance of
    the search from their minimum. J_t is by central differences; transitions that do not solve
    there are left out. Two-sided quantiles, so an interval is one of each parameter alone.
    """
    J, r = _linearised(loss, log_psi, buffer)
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


def _linearised(loss: OneStepLoss, log_psi: np.ndarray, buffer: Buffer) -> tuple[np.ndarray, np.ndarray]:
    """Return Jacobians (t, nx, n_psi) and errors (t, nx) of the transitions where all are finite."""
    n = len(log_psi)
    perturbed = log_psi + DIFFERENCE_STEP * np.concatenate([np.zeros((1, n)), np.eye(n), -np.eye(n)])
    errors = loss.errors(perturbed, buffer)
    finite = np.isfinite(errors).all(axis=(0, 2))
    slopes = (errors[1 : n + 1] - errors[n + 1 :]) / (2 * DIFFERENCE_STEP)
    return np.moveaxis(slopes, 0, 2)[finite], errors[0][finite]
