"""Imitation learning: policies fitted to optimal control solutions, from which a training may start."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from scipy.optimize import minimize

from dynamics.batch import BatchFunction, DensePolicy, StepFunction, dense_policy
from dynamics.contact import Barrier, Step
from dynamics.systems import ContactSystem
from ocp.errors import InputError, NotConverged
from ocp.learning.protocol import Normaliser, TrainedPolicy, backpropagate, first_weights, layer_inputs
from ocp.problem.evaluation import Evaluation
from ocp.problem.rollout import Gains
from ocp.problem.task import Task
from ocp.solution import Solution

SMOOTHING_MU_SHARE = 1e-2
"""Barrier parameter mu of the contact law that tracking gains use, as a fraction of the problem's characteristic mu."""


def demonstrations(
    plans: Sequence[Solution], copies: int = 0, spread: float = 0.0, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Return the states (n, nx) of plans at all scenarios and steps, and the plans' inputs (n, nu) in these states.

    For each state, ``copies`` perturbed states are added, with normal noise of ``spread`` characteristic sizes.
    The inputs in the perturbed states are computed by the plan's feedback, or by :func:`tracking_gains` for an
    open-loop plan, and clipped to the bounds.

    Raises :class:`~ocp.errors.InputError` if there is no plan or a plan is not finite.
    """
    if not plans:
        raise InputError("no plans to fit the policy to; give at least one")
    states, inputs = [], []
    for number, plan in enumerate(plans):
        x, u = (plan.data[name].values for name in ("x", "u"))
        if not (np.isfinite(x).all() and np.isfinite(u).all()):
            raise InputError(f"plan {number}, of {plan.problem.name}, has non-finite states or inputs; leave it out")
        states.append(x[:, :-1].reshape(-1, x.shape[2]))
        inputs.append(np.broadcast_to(u, (len(x), *u.shape[1:])).reshape(-1, u.shape[2]))
        rng = np.random.default_rng([seed, number])
        for scenario in range(len(x) if copies else 0):
            perturbed = _perturbed_demonstrations(plan, scenario, copies, spread, rng)
            states.append(perturbed[0])
            inputs.append(perturbed[1])
    return np.concatenate(states), np.concatenate(inputs)


def _perturbed_demonstrations(
    plan: Solution, scenario: int, copies: int, spread: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Return perturbed states (n, nx) of one scenario, and the inputs (n, nu) of the feedback in these states."""
    problem = plan.problem
    lower, upper = Evaluation(problem, plan.values).limits[2:4]
    gains = tracking_gains(plan, scenario) if plan.gains is None else plan.gains
    x = np.repeat(plan.data["x"].values[scenario, :-1], copies, axis=0)
    perturbed_states = x + spread * problem.scales.x * rng.standard_normal(x.shape)
    corrected_inputs = [gains.input(index // copies, state) for index, state in enumerate(perturbed_states)]
    return perturbed_states, np.clip(corrected_inputs, lower, upper)


def tracking_gains(plan: Solution, scenario: int = 0) -> Gains:
    """Return gains K (N, nu, nx) of feedback ``u = u_k + K_k (x - x_k)`` that tracks a plan.

    The feedback is the linear-quadratic regulator that minimises ``sum |dx / size|² + |du / size|²`` with the
    problem's characteristic sizes: ``K = -(R + B' P B)^-1 B' P A``, ``P <- Q + A' P (A + B K)``, ``P_N = Q``.
    ``A_k, B_k`` are derivatives of the step along the plan under a barrier law, since the exact law has no
    derivatives where a contact is about to open or close.

    Raises :class:`~ocp.errors.NotConverged` if a step cannot be solved under the barrier law.
    """
    problem, sizes = plan.problem, plan.problem.scales
    x = plan.data["x"].values[scenario]
    all_inputs = plan.data["u"].values
    u = all_inputs[min(scenario, len(all_inputs) - 1)]
    step, function = _smoothed_step(problem.system, SMOOTHING_MU_SHARE * sizes.mu)
    p = Evaluation(problem, plan.values).step_values(step, with_law_values=False)
    A, B = function.derivatives(x[:-1], u, p)[1:]
    if not (np.isfinite(A).all() and np.isfinite(B).all()):
        raise NotConverged(
            f"{problem.name}: a step near the plan was not solved under the barrier law, so that no"
            " feedback is known there; fit to the plan alone, with copies = 0"
        )
    (N, nu), nx = u.shape, x.shape[1]
    Q, R = np.diag(sizes.x**-2.0), np.diag(sizes.u**-2.0)
    P, K = Q, np.empty((N, nu, nx))
    for k in reversed(range(N)):
        pulled = B[k].T @ P
        K[k] = -np.linalg.solve(R + pulled @ B[k], pulled @ A[k])
        P = Q + A[k].T @ P @ (A[k] + B[k] @ K[k])
        P = (P + P.T) / 2
    return Gains(K, u - np.einsum("kij,kj->ki", K, x[:-1]))


@lru_cache(maxsize=1)
def _smoothed_step(system: ContactSystem, mu: float) -> tuple[Step, StepFunction]:
    """Return the system's step under the barrier law and its compiled function; the last result is cached."""
    step = Barrier(mu=mu).close(system)
    return step, StepFunction(step)


MAX_ACTION_SHARE = 0.99
"""Maximum distance of a target input from mid-range, in half ranges; no finite action gives an input at a bound."""
MAX_LBFGS_ITERATIONS = 500
"""Maximum number of iterations of L-BFGS."""
ROWS_PER_PRODUCT = 64
"""Maximum number of rows of a matrix product. NumPy computes larger products with several threads, which is slow
on a busy machine and makes rounding depend on the number of threads."""


def fit_actions(
    task: Task, states: np.ndarray, inputs: np.ndarray, hidden: tuple[int, ...] = (), seed: int = 0
) -> TrainedPolicy:
    """Fit a policy with tanh layers ``hidden`` to pairs of ``states`` (n, nx) and ``inputs`` (n, nu).

    The fit minimises the mean of ``|a(o) - a*|²``, where a is the action before tanh and ``a* = artanh((u -
    mid) / half)``, with u limited to 0.99 of the half range. Observations are normalised by their mean and
    standard deviation. The affine policy, ``hidden = ()``, is the least-squares solution of minimum norm;
    policies with hidden layers are fitted by up to 500 iterations of L-BFGS from random weights drawn with
    ``seed``.
    """
    policy = dense_policy(task.observe, hidden, task.lower, task.upper)
    observations = BatchFunction(task.observe, "numpy", 1)(states, task.parameters.values)
    normaliser = Normaliser.identity(observations.shape[1]).after(observations)
    observations = (observations - normaliser.mean) / normaliser.scale
    target_actions = np.arctanh(
        np.clip((inputs - task.mid_range) / task.half_range, -MAX_ACTION_SHARE, MAX_ACTION_SHARE)
    )
    if not hidden:
        features = np.column_stack([observations, np.ones(len(observations))])
        fitted = np.linalg.lstsq(features, target_actions)[0]
        return TrainedPolicy(np.concatenate([fitted[:-1].T.ravel(), fitted[-1]]), normaliser)
    initial_theta = first_weights(policy.sizes, 1.0, np.random.default_rng(seed))
    fitted = minimize(
        squared_error,
        initial_theta,
        (policy, observations, target_actions),
        "L-BFGS-B",
        jac=True,
        options={"maxiter": MAX_LBFGS_ITERATIONS, "maxfun": 2 * MAX_LBFGS_ITERATIONS},
    )
    return TrainedPolicy(fitted.x, normaliser)


def squared_error(
    theta: np.ndarray, policy: DensePolicy, observations: np.ndarray, target_actions: np.ndarray
) -> tuple[float, np.ndarray]:
    """Return the mean of ``|a - a*|²`` over normalised observations (n, n_o), and its gradient (n_theta,).

    Here a are the policy's actions before tanh, and a* are the ``target_actions`` (n, n_a).
    """
    error, slope = 0.0, np.zeros_like(theta)
    for first_row in range(0, len(observations), ROWS_PER_PRODUCT):
        chunk_sums = _summed_error(
            theta,
            policy,
            observations[first_row : first_row + ROWS_PER_PRODUCT],
            target_actions[first_row : first_row + ROWS_PER_PRODUCT],
        )
        error, slope = error + chunk_sums[0], slope + chunk_sums[1]
    return error / len(observations), slope / len(observations)


def _summed_error(
    theta: np.ndarray, policy: DensePolicy, observations: np.ndarray, target_actions: np.ndarray
) -> tuple[float, np.ndarray]:
    """Return the sum of ``|a - a*|²`` over observations, and its gradient (n_theta,) by backpropagation."""
    layers = policy.layers(theta)
    inputs = layer_inputs(layers, observations)
    weights, offsets = layers[-1]
    errors = inputs[-1] @ weights.T + offsets - target_actions
    _, *gradients = backpropagate(layers, inputs, 2 * errors)
    by_layer = [((gradient.T @ z).ravel(), gradient.sum(axis=0)) for gradient, z in zip(gradients, inputs, strict=True)]
    return float((errors**2).sum()), np.concatenate([part for layer in by_layer for part in layer])
