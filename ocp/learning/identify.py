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


DRAWS, ROWS = 1, 2
"""Streams of random numbers: of candidates, of the transitions that judge them."""


@dataclass(frozen=True, eq=False)
class Identification:
    """psi as found, ``values`` (n,) in the order of ``names``, and how the search came there.

    ``loss`` is eq. 4.1's over all transitions, over their number; ``model_params`` (k, n) are the
    means of the cloud, first its start, and ``spread`` (k, n) its standard deviations of log psi;
    each pass begins where the last one ended.
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
    """One iteration of the search: candidates, judged alike by ``rows`` transitions drawn anew.

    Random numbers depend on the seed and the number of the iteration alone.
    """
    count = int(cloud["count"])
    judges = buffer
    if rows < len(buffer):
        drawn = np.random.default_rng([*seed, count, ROWS]).choice(len(buffer), rows, replace=False)
        judges = buffer[np.sort(drawn)]
    rng = np.random.default_rng([*seed, count, DRAWS])
    return search.iterate(cloud, lambda candidates: loss(candidates, judges), rng)


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
        while not search.done(clouds[-1]):
            clouds.append(search_iteration(loss, buffer, search, clouds[-1], [seed, number], rows))
        ends.append(clouds[-1]["mean"])
    losses = loss(np.array(ends), buffer) / len(buffer)
    return Identification(
        names=loss.names,
        values=np.exp(ends[int(np.argmin(losses))]),
        loss=float(losses.min()),
        start_loss=float(losses[0]),
        model_params=np.exp([each["mean"] for each in clouds]),
        spread=np.array([search.deviations(each) for each in clouds]),
    )


_RESAMPLES, _TAIL = 400, (1 - 0.95) / 2
STEP = 1e-4
"""Of log psi in central differences."""
FLAT = 1e-10
"""Share of the largest eigenvalue of the information below which a direction is not seen."""
SEEN = 0.05
"""Part of a parameter's axis in unseen directions above which it is not determined."""


@dataclass(frozen=True, eq=False)
class Intervals:
    """``low`` and ``high`` (n,) of psi; [0, inf] for one that the transitions do not determine.

    ``information`` (n, n) is the mean over transitions of ``J_t' J_t``, J_t the derivative of the
    scaled errors by log psi.
    """

    low: np.ndarray
    high: np.ndarray
    information: np.ndarray


def intervals(
    loss: OneStepLoss,
    log_psi: np.ndarray,
    buffer: Buffer,
    seed: int = 0,
) -> Intervals:
    """Bootstrap over transitions, each resample's minimum being one Gauss-Newton step away.

    With J_t and errors r_t at ``log_psi`` (n_psi,), resample b's minimum is ``log_psi -
    (sum_b J_t'J_t)^(-1) sum_b J_t' r_t``. The interval has 95 % of the 400 minima and reaches to
    what was found: it measures the noise in the data and, where those are exact, the distance of
    the search from their minimum. J_t is by central differences; transitions that do not solve
    there are left out. Two-sided quantiles, so an interval is one of each parameter alone.
    """
    J, r = _linearised(loss, log_psi, buffer)
    each = np.einsum("tia,tib->tab", J, J), np.einsum("tia,ti->ta", J, r)
    information = each[0].mean(axis=0)
    eigenvalues, axes = np.linalg.eigh(information)
    unseen = eigenvalues <= FLAT * eigenvalues[-1]
    lost = np.linalg.norm(axes[:, unseen], axis=1) > SEEN
    seen = axes[:, ~unseen]
    rng = np.random.default_rng([seed, 0])
    n = len(J)
    minima = [log_psi]
    for _ in range(_RESAMPLES):
        weights = np.bincount(rng.integers(n, size=n), minlength=n)
        H = seen.T @ np.tensordot(weights, each[0], 1) @ seen
        minima.append(log_psi - seen @ np.linalg.lstsq(H, seen.T @ (weights @ each[1]))[0])
    low, high = np.quantile(minima[1:], [_TAIL, 1 - _TAIL], axis=0)
    return Intervals(
        np.where(lost, 0.0, np.exp(np.minimum(low, log_psi))),
        np.where(lost, np.inf, np.exp(np.maximum(high, log_psi))),
        information,
    )


def _linearised(loss: OneStepLoss, log_psi: np.ndarray, buffer: Buffer) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives (t, nx, n_psi) and errors (t, nx) where all of them are finite."""
    n = len(log_psi)
    around = log_psi + STEP * np.concatenate([np.zeros((1, n)), np.eye(n), -np.eye(n)])
    errors = loss.errors(around, buffer)
    good = np.isfinite(errors).all(axis=(0, 2))
    slopes = (errors[1 : n + 1] - errors[n + 1 :]) / (2 * STEP)
    return np.moveaxis(slopes, 0, 2)[good], errors[0][good]
