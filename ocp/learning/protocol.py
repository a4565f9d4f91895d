"""What every algorithm that learns a policy keeps to, and the network of the policy."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import casadi as ca
import numpy as np

from dynamics.batch import DensePolicy, RolloutPolicy, StepFunction
from dynamics.contact import Barrier
from ocp.errors import InputError
from ocp.problem.task import Task

if TYPE_CHECKING:
    from ocp.learning.experiment import Experiment


LEAST_SCALE = 1e-2
"""Observations that vary less than this are not blown up to unit size."""


@dataclass(frozen=True)
class Normaliser:
    """Mean and sum of squares ``m2`` about it, each (n_o,), of ``n`` observations so far.

    A policy sees ``(o - mean) / scale``. Before the second observation the scale is 1.
    """

    n: float
    mean: np.ndarray
    m2: np.ndarray

    @classmethod
    def identity(cls, size: int) -> Normaliser:
        """Leave observations as they are."""
        return cls(0.0, np.zeros(size), np.zeros(size))

    @property
    def scale(self) -> np.ndarray:
        """Standard deviation, (n_o,), at least ``LEAST_SCALE``."""
        if self.n < 2:
            return np.ones_like(self.m2)
        return np.maximum(np.sqrt(self.m2 / self.n), LEAST_SCALE)

    def after(self, observations: np.ndarray) -> Normaliser:
        """With ``observations`` (n, n_o) added (Chan, Golub and LeVeque)."""
        n = len(observations)
        if not n:
            return self
        mean = observations.mean(axis=0)
        m2 = ((observations - mean) ** 2).sum(axis=0)
        total, off = self.n + n, mean - self.mean
        return Normaliser(total, self.mean + off * n / total, self.m2 + m2 + off**2 * self.n * n / total)

    def arrays(self) -> dict[str, np.ndarray]:
        """As a checkpoint holds it."""
        return {"seen.n": np.array(self.n), "seen.mean": self.mean, "seen.m2": self.m2}

    @classmethod
    def of(cls, state: dict[str, np.ndarray]) -> Normaliser:
        """Out of a state that holds :meth:`arrays`."""
        return cls(float(state["seen.n"]), state["seen.mean"], state["seen.m2"])


def first_weights(sizes: Sequence[int], last: float, rng: np.random.Generator) -> np.ndarray:
    """Normal weights of deviation 1 / sqrt(fan in), the last layer's ``last`` times that; b = 0.

    ``sizes`` are the lengths of the observations, the hidden layers and the action.
    """
    parts = []
    for layer, (fan_in, fan_out) in enumerate(pairwise(sizes)):
        size = last if layer == len(sizes) - 2 else 1.0
        parts += [
            rng.standard_normal(fan_in * fan_out) * size / np.sqrt(fan_in),
            np.zeros(fan_out),
        ]
    return np.concatenate(parts)


def vjp(policy: RolloutPolicy, theta: np.ndarray, seen: np.ndarray, bar: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """``bar' da/dtheta`` (n, n_theta) and ``bar' da/do`` (n, n_o) at normalised observations.

    ``seen`` is (n, n_o), ``bar`` (n, n_a); a policy without observations is its own parameters.
    """
    if not isinstance(policy, DensePolicy):
        return bar, np.zeros_like(seen)
    layers, values = policy.layers(theta), [seen]
    for weights, offsets in layers[:-1]:
        values.append(np.tanh(values[-1] @ weights.T + offsets))
    parts: list[np.ndarray] = []
    for (weights, _), before in zip(reversed(layers), reversed(values), strict=True):
        outer = bar[:, :, None] * before[:, None, :]
        parts = [outer.reshape(len(bar), weights.size), bar, *parts]
        bar = bar @ weights
        if before is not seen:
            bar = bar * (1 - before**2)
    return np.hstack(parts), bar


def renormalised(policy: RolloutPolicy, theta: np.ndarray, before: Normaliser, after: Normaliser) -> np.ndarray:
    """Parameters of the same policy where ``after`` normalises what ``before`` did.

    ``W' = W s'/s`` and ``b' = b + W (m' - m)/s`` of the first layer, with the means m and scales s.
    """
    if not isinstance(policy, DensePolicy):
        return theta
    moved = theta.copy()
    weights, offsets = policy.layers(moved)[0]
    offsets += weights @ ((after.mean - before.mean) / before.scale)
    weights *= after.scale / before.scale
    return moved


_WEIGHT = 1e-3
_STEPS = 1000
_STILL = 1e-2
_SMALL = 0.1


def balancing_feedback(task: Task, rest: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """W (nu, n_o) and b (nu,) of ``a = W o + b``, which keeps ``task`` at ``rest`` (nx,).

    The linear-quadratic regulator of the sharp step, mu = 1e-10, linearised at the state with the
    inputs in their middle, for the cost ``1e-3 |C (x - rest)|² + |a|²``, C the derivative of what
    is observed: nearly the feedback of least effort that is stable at all.

    Raises :class:`~ocp.errors.InputError` where the system does not rest there, or no feedback on
    what is observed keeps it.
    """
    if np.shape(rest) != (task.system.nx,) or not np.isfinite(rest).all():
        raise InputError(f"rest must be {task.system.nx} finite numbers, a state of {task.name}, got {np.shape(rest)}")
    step = Barrier(mu=1e-10).close(replace(task.system, parameters=task.parameters))
    middle, half = (task.upper + task.lower) / 2, (task.upper - task.lower) / 2
    stepped, by_x, by_u = StepFunction(step, "casadi", 1).slopes(rest[None], middle[None])
    moved = np.abs(stepped.x_next[0] - rest).max()
    if not moved < _STILL:
        raise InputError(f"{task.name} does not rest at the state given: a step moves it {moved:g}")
    x, p = task.system.x, task.parameters.vector
    observation = task.observe(x, p)
    look = ca.Function("look", [x, p], [observation, ca.densify(ca.jacobian(observation, x))])
    seen, C = (np.array(part) for part in look(rest, task.parameters.values))
    gain = _regulator(by_x[0], by_u[0] * half, _WEIGHT * C.T @ C)
    W = -gain @ np.linalg.pinv(C)
    if np.abs(W @ C + gain).max() > 1e-6 * np.abs(gain).max():
        raise InputError(f"{task.name} cannot be stabilised at rest from its observations alone")
    return W, -W @ seen[:, 0]


def embed_affine(W: np.ndarray, b: np.ndarray, layers: list[tuple[np.ndarray, np.ndarray]]) -> None:
    """Make a network's ``layers`` (views of its parameters) compute ``W o + b`` nearly.

    The first units of each hidden layer carry a tenth of it, where tanh hardly bends; the last
    layer listens to no others. Raises :class:`~ocp.errors.InputError` for layers with fewer units
    than there are inputs.
    """
    n, (*hidden, last) = len(b), layers
    if not hidden:
        last[0][...], last[1][...] = W, b
        return
    if any(len(offsets) < n for _, offsets in hidden):
        raise InputError(f"a policy that balances needs hidden layers of at least {n} units")
    for place, (weights, offsets) in enumerate(hidden):
        weights[:n], offsets[:n] = (_SMALL * W, _SMALL * b) if place == 0 else (0.0, 0.0)
        if place:
            weights[:n, :n] = np.eye(n)
    last[0][...], last[1][...] = 0.0, 0.0
    last[0][:, :n] = np.eye(n) / _SMALL


def _regulator(A: np.ndarray, B: np.ndarray, Q: np.ndarray) -> np.ndarray:
    """K of ``a = -K x`` that is best over many steps of ``x+ = A x + B a``, by Riccati's steps."""
    P, K, one = Q, np.zeros((B.shape[1], len(A))), np.eye(B.shape[1])
    for _ in range(_STEPS):
        K = np.linalg.solve(one + B.T @ P @ B, B.T @ P @ A)
        P = Q + A.T @ P @ (A - B @ K)
    return K


State = dict[str, np.ndarray]
"""All that an algorithm must remember from one iteration to the next, as a checkpoint stores it."""

Row = dict[str, float]
"""What is told of one iteration, by name. All tell ``return_mean`` (of the samples drawn), those
with gradients ``gradient_norm`` and ``gradient_variance`` (trace of the covariance of one sample's
gradient); the loop adds ``env_steps``, the simulated steps that it counted."""


class Trained(NamedTuple):
    """Parameters ``theta`` (n_theta,) of a policy, and what it has seen."""

    theta: np.ndarray
    normaliser: Normaliser

    @classmethod
    def of(cls, state: State) -> Trained:
        """The policy of an algorithm's state."""
        return cls(state["theta"], Normaliser.of(state))

    @property
    def digest(self) -> str:
        """Ten hex digits over all of it."""
        n, mean, m2 = self.normaliser.arrays().values()
        parts = (np.asarray(part, dtype=float) for part in (self.theta, n, mean, m2))
        return hashlib.sha256(b"".join(part.tobytes() for part in parts)).hexdigest()[:10]


class Algorithm:
    """One way to improve a policy; its attributes are its settings, frozen.

    The numbers of iteration k are drawn by :meth:`Experiment.rng` and :meth:`Experiment.noise` at
    k, so that a run that goes on from a stored state ends as one that was never stopped.
    """

    name: ClassVar[str]
    summary: ClassVar[str]
    contact: ClassVar[str]
    """Name of the contact law that it is meant to learn through."""

    def settings(self) -> dict[str, Any]:
        """What was chosen, for the run's record."""
        return dict(vars(self))

    def check(self, experiment: Experiment) -> None:
        """Raise :class:`~ocp.errors.InputError` where settings do not fit, before any work."""
        raise NotImplementedError

    def begin(self, experiment: Experiment) -> State:
        """State before the first iteration, the first policy; raises as :meth:`check` does."""
        self.check(experiment)
        normaliser = Normaliser.identity(len(experiment.task.observations))
        if experiment.start is not None:
            normaliser = experiment.start.normaliser
        return {"theta": experiment.first_theta(), **normaliser.arrays()}

    def iterate(self, experiment: Experiment, state: State, k: int) -> tuple[State, Row]:
        """State after iteration k, and what is told of it; ``state`` is left as it was."""
        raise NotImplementedError

    def policy(self, experiment: Experiment, state: State) -> Trained:
        """The policy as it is, without noise."""
        return Trained.of(state)


def prefixed(prefix: str, arrays: Mapping[str, Any]) -> State:
    """Entries named ``prefix`` and their own name."""
    return {prefix + name: value for name, value in arrays.items()}


def under(prefix: str, state: State) -> State:
    """The entries that :func:`prefixed` named, by their own names."""
    return {n.removeprefix(prefix): value for n, value in state.items() if n.startswith(prefix)}
