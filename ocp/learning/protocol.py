"""Base class of algorithms that learn a policy, and functions on the policy's network."""

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
from dynamics.settings import Configured
from ocp.errors import InputError
from ocp.problem.task import Task

if TYPE_CHECKING:
    from ocp.learning.experiment import Experiment


MIN_OBSERVATION_SCALE = 1e-2
"""Minimum scale of an observation; smaller variations are not scaled up to unit deviation."""


@dataclass(frozen=True)
class Normaliser:
    """Running normalisation of observations: a policy's input is ``(o - mean) / scale``.

    ``mean`` (n_o,) and ``m2`` (n_o,), the sum of squared deviations from the mean, are those of the ``n``
    observations so far.
    """

    n: float
    mean: np.ndarray
    m2: np.ndarray

    @classmethod
    def identity(cls, size: int) -> Normaliser:
        """Return a normaliser that leaves observations unchanged."""
        return cls(0.0, np.zeros(size), np.zeros(size))

    @property
    def scale(self) -> np.ndarray:
        """Standard deviation (n_o,), but at least ``MIN_OBSERVATION_SCALE``; 1 before the second observation."""
        if self.n < 2:
            return np.ones_like(self.m2)
        return np.maximum(np.sqrt(self.m2 / self.n), MIN_OBSERVATION_SCALE)

    def after(self, observations: np.ndarray) -> Normaliser:
        """Return the normaliser updated by ``observations`` (n, n_o), with the formulas of Chan, Golub and LeVeque."""
        n = len(observations)
        if not n:
            return self
        mean = observations.mean(axis=0)
        m2 = ((observations - mean) ** 2).sum(axis=0)
        total, mean_change = self.n + n, mean - self.mean
        return Normaliser(
            total, self.mean + mean_change * n / total, self.m2 + m2 + mean_change**2 * self.n * n / total
        )

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the entries of an algorithm's state that store the normaliser."""
        return {"normaliser.n": np.array(self.n), "normaliser.mean": self.mean, "normaliser.m2": self.m2}

    @classmethod
    def from_state(cls, state: dict[str, np.ndarray]) -> Normaliser:
        """Build a normaliser from the entries of :meth:`arrays` in an algorithm's state."""
        return cls(float(state["normaliser.n"]), state["normaliser.mean"], state["normaliser.m2"])


Layers = Sequence[tuple[Any, Any]]
"""Weights ``W`` (n_out, n_in) and offsets ``b`` (n_out,) of each layer of a network."""


def first_weights(sizes: Sequence[int], last: float, rng: np.random.Generator) -> np.ndarray:
    """Return random initial parameters (n_theta,) of a network with zero offsets.

    Weights are normal with standard deviation 1 / sqrt(fan in), multiplied by ``last`` in the last layer.
    ``sizes`` are the numbers of observations, of units of each hidden layer, and of actions.
    """
    arrays = []
    for layer, (fan_in, fan_out) in enumerate(pairwise(sizes)):
        size = last if layer == len(sizes) - 2 else 1.0
        arrays += [
            rng.standard_normal(fan_in * fan_out) * size / np.sqrt(fan_in),
            np.zeros(fan_out),
        ]
    return np.concatenate(arrays)


def layer_inputs(layers: Layers, observations: np.ndarray) -> list[np.ndarray]:
    """Return the inputs (n, n_in) of each of a network's layers at normalised observations (n, n_o)."""
    values = [observations]
    for weights, offsets in layers[:-1]:
        values.append(np.tanh(values[-1] @ weights.T + offsets))
    return values


def backpropagate(layers: Layers, inputs: Sequence[np.ndarray], output_gradient: np.ndarray) -> list[np.ndarray]:
    """Return gradients with respect to observations (n, n_o), then to values before tanh (n, n_out) of each layer.

    ``inputs`` are the :func:`layer_inputs`, and ``output_gradient`` (n, n_out) is the gradient with respect to
    the output of the last layer.
    """
    gradients = [output_gradient]
    for (weights, _), values in zip(reversed(layers[1:]), reversed(inputs[1:]), strict=True):
        gradients.insert(0, gradients[0] @ weights * (1 - values**2))
    return [gradients[0] @ layers[0][0], *gradients]


def policy_vjp(
    policy: RolloutPolicy, theta: np.ndarray, observations: np.ndarray, output_gradient: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return a policy's vector-Jacobian products ``g' da/dtheta`` (n, n_theta) and ``g' da/do`` (n, n_o).

    g is the ``output_gradient`` (n, n_a), and ``observations`` (n, n_o) are normalised. A policy without
    observations has its parameters as action, so da/dtheta is the identity.
    """
    if not isinstance(policy, DensePolicy):
        return output_gradient, np.zeros_like(observations)
    layers = policy.layers(theta)
    inputs = layer_inputs(layers, observations)
    by_observation, *gradients = backpropagate(layers, inputs, output_gradient)
    by_theta: list[np.ndarray] = []
    for (weights, _), values, gradient in zip(layers, inputs, gradients, strict=True):
        outer = gradient[:, :, None] * values[:, None, :]
        by_theta += [outer.reshape(len(gradient), weights.size), gradient]
    return np.hstack(by_theta), by_observation


def renormalise_policy(policy: RolloutPolicy, theta: np.ndarray, before: Normaliser, after: Normaliser) -> np.ndarray:
    """Return parameters (n_theta,) that keep a policy unchanged when ``after`` replaces the normaliser ``before``.

    With means m and scales s, the first layer becomes ``W' = W s'/s`` and ``b' = b + W (m' - m)/s``.
    """
    if not isinstance(policy, DensePolicy):
        return theta
    parameters = theta.copy()
    weights, offsets = policy.layers(parameters)[0]
    offsets += weights @ ((after.mean - before.mean) / before.scale)
    weights *= after.scale / before.scale
    return parameters


STATE_WEIGHT = 1e-3
"""Weight of squared deviations of observations in the regulator's cost, relative to squared actions."""
RICCATI_STEPS = 1000
"""Number of Riccati iterations of the stationary regulator."""
MAX_REST_CHANGE = 1e-2
"""Largest change of a state entry in one step for which the system counts as at rest."""
TANH_LINEAR_SHARE = 0.1
"""Factor on the values before tanh of an embedded affine map; it is small, so that tanh is nearly linear."""


def balancing_feedback(task: Task, x_rest: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return W (nu, n_o) and b (nu,) of a feedback ``a = W o + b`` that stabilises ``task`` at ``x_rest`` (nx,).

    The feedback is the linear-quadratic regulator with cost ``1e-3 |C (x - rest)|² + |a|²``, where C is the
    Jacobian of the observations. The step of the barrier law with mu = 1e-10 is linearised at ``x_rest`` with the
    inputs in the middle of their range. The result is close to the stabilising feedback of least effort.

    Raises :class:`~ocp.errors.InputError` if the system does not rest at ``x_rest``, or if the regulator cannot
    be computed from the observations.
    """
    if np.shape(x_rest) != (task.system.nx,) or not np.isfinite(x_rest).all():
        raise InputError(
            f"rest must be {task.system.nx} finite numbers, a state of {task.name}, got {np.shape(x_rest)}"
        )
    step = Barrier(mu=1e-10).close(replace(task.system, parameters=task.parameters))
    stepped, by_x, by_u = StepFunction(step, "casadi", 1).derivatives(x_rest[None], task.mid_range[None])
    change = np.abs(stepped.x_next[0] - x_rest).max()
    if not change < MAX_REST_CHANGE:
        raise InputError(f"{task.name} does not rest at the state given: a step moves it {change:g}")
    x, p = task.system.x, task.parameters.vector
    observation = task.observe(x, p)
    observe = ca.Function("look", [x, p], [observation, ca.densify(ca.jacobian(observation, x))])
    observed, C = (np.array(values) for values in observe(x_rest, task.parameters.values))
    gain = _regulator(by_x[0], by_u[0] * task.half_range, STATE_WEIGHT * C.T @ C)
    W = -gain @ np.linalg.pinv(C)
    if np.abs(W @ C + gain).max() > 1e-6 * np.abs(gain).max():
        raise InputError(f"{task.name} cannot be stabilised at rest from its observations alone")
    return W, -W @ observed[:, 0]


def embed_affine(W: np.ndarray, b: np.ndarray, layers: Layers) -> None:
    """Set ``layers``, which are views of a network's parameters, so that its output is close to ``W o + b``.

    The first units of each hidden layer compute 0.1 (W o + b), for which tanh is nearly linear; the last layer
    multiplies them by 10 and ignores all other units. Raises :class:`~ocp.errors.InputError` if a hidden layer
    has fewer units than there are inputs.
    """
    n, (*hidden, last) = len(b), layers
    if not hidden:
        last[0][...], last[1][...] = W, b
        return
    if any(len(offsets) < n for _, offsets in hidden):
        raise InputError(f"a policy that balances needs hidden layers of at least {n} units")
    for layer, (weights, offsets) in enumerate(hidden):
        weights[:n], offsets[:n] = (TANH_LINEAR_SHARE * W, TANH_LINEAR_SHARE * b) if layer == 0 else (0.0, 0.0)
        if layer:
            weights[:n, :n] = np.eye(n)
    last[0][...], last[1][...] = 0.0, 0.0
    last[0][:, :n] = np.eye(n) / TANH_LINEAR_SHARE


def _regulator(A: np.ndarray, B: np.ndarray, Q: np.ndarray) -> np.ndarray:
    """Return the gain K of the infinite-horizon regulator ``a = -K x`` of ``x+ = A x + B a``, cost ``x'Qx + a'a``."""
    P, K, identity = Q, np.zeros((B.shape[1], len(A))), np.eye(B.shape[1])
    for _ in range(RICCATI_STEPS):
        K = np.linalg.solve(identity + B.T @ P @ B, B.T @ P @ A)
        P = Q + A.T @ P @ (A - B @ K)
    return K


State = dict[str, np.ndarray]
"""Mapping from names to an algorithm's arrays between two iterations, as stored in a checkpoint."""

Row = dict[str, float]
"""Mapping from names to numbers of one iteration: ``return_mean`` of the samples and, for algorithms with
gradients, ``gradient_norm`` and ``gradient_variance`` (trace of the covariance of one sample's gradient).
The training loop adds ``env_steps``, the number of simulated steps."""


class TrainedPolicy(NamedTuple):
    """A trained policy: its parameters ``theta`` (n_theta,) and its normaliser of observations."""

    theta: np.ndarray
    normaliser: Normaliser

    @classmethod
    def from_state(cls, state: State) -> TrainedPolicy:
        """Build the policy from an algorithm's state."""
        return cls(state["theta"], Normaliser.from_state(state))

    @property
    def digest(self) -> str:
        """First ten hexadecimal digits of a hash of the policy, which identify it in records."""
        n, mean, m2 = self.normaliser.arrays().values()
        arrays = (np.asarray(array, dtype=float) for array in (self.theta, n, mean, m2))
        return hashlib.sha256(b"".join(array.tobytes() for array in arrays)).hexdigest()[:10]


class Algorithm(Configured):
    """Base class of algorithms that improve a policy; attributes are settings and do not change.

    Random numbers in iteration k come only from :meth:`Experiment.rng` and :meth:`Experiment.noise` with that
    k, so that a resumed run gives the same result as a run without interruption.
    """

    name: ClassVar[str]
    summary: ClassVar[str]
    contact: ClassVar[str]
    """Name of the contact law under which the algorithm learns by default."""

    def settings(self) -> dict[str, Any]:
        """Return a mapping from names to the settings, as recorded with a run."""
        return dict(vars(self))

    def check(self, experiment: Experiment) -> None:
        """Raise :class:`~ocp.errors.InputError` if the settings do not fit the experiment; called before any work."""

    def begin(self, experiment: Experiment) -> State:
        """Return the state before the first iteration; raises the errors of :meth:`check`."""
        self.check(experiment)
        normaliser = Normaliser.identity(len(experiment.task.observations))
        if experiment.start is not None:
            normaliser = experiment.start.normaliser
        return {"theta": experiment.first_theta(), **normaliser.arrays()}

    def iterate(self, experiment: Experiment, state: State, k: int) -> tuple[State, Row]:
        """Return the algorithm's state after iteration k, and the iteration's row; ``state`` is not modified."""
        raise NotImplementedError

    def policy(self, experiment: Experiment, state: State) -> TrainedPolicy:
        """Return the policy in an algorithm's state, without exploration noise."""
        return TrainedPolicy.from_state(state)


def with_prefix(prefix: str, arrays: Mapping[str, Any]) -> State:
    """Return the arrays with ``prefix`` added to each name."""
    return {prefix + name: value for name, value in arrays.items()}


def without_prefix(prefix: str, state: State) -> State:
    """Return the entries of ``state`` whose names begin with ``prefix``, with the prefix removed from their names."""
    return {n.removeprefix(prefix): value for n, value in state.items() if n.startswith(prefix)}
