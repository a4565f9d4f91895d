"""Policies fitted to plans, to start from."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from scipy.optimize import minimize

from dynamics.batch import BatchFunction, DensePolicy, StepFunction, dense
from dynamics.contact import Barrier, Step
from dynamics.systems import ContactSystem
from ocp.errors import InputError, NotConverged
from ocp.learning.protocol import Normaliser, Trained, first_weights
from ocp.problem.evaluation import Evaluation
from ocp.problem.rollout import Gains
from ocp.problem.task import Task
from ocp.solution import Solution

_SMOOTH = 1e-2
"""Barrier parameter in characteristic sizes, under which contacts are felt before they close."""


def demonstrations(
    plans: Sequence[Solution], copies: int = 0, spread: float = 0.0, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """States (n, nx) of plans, of all scenarios and steps, and the inputs (n, nu) there.

    With ``copies`` each state comes so many times more, moved by normal noise of ``spread``
    characteristic sizes, and the input there is that of the plan's feedback, or for a plan of
    inputs alone of the feedback that :func:`tracking_gains` has for it; cut to the bounds.

    Raises :class:`~ocp.errors.InputError` where there is no plan, or one that has come to no
    number.
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
            beside = _perturbed(plan, scenario, copies, spread, rng)
            states.append(beside[0])
            inputs.append(beside[1])
    return np.concatenate(states), np.concatenate(inputs)


def _perturbed(
    plan: Solution, scenario: int, copies: int, spread: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """States around one scenario's and the inputs that lead back."""
    problem = plan.problem
    lower, upper = Evaluation(problem, plan.values).limits[2:4]
    gains = tracking_gains(plan, scenario) if plan.gains is None else plan.gains
    x = np.repeat(plan.data["x"].values[scenario, :-1], copies, axis=0)
    moved = x + spread * problem.scales.x * rng.standard_normal(x.shape)
    asked = [gains.input(at // copies, state) for at, state in enumerate(moved)]
    return moved, np.clip(asked, lower, upper)


def tracking_gains(plan: Solution, scenario: int = 0) -> Gains:
    """Feedback ``u = u_k + K_k (x - x_k)`` that leads back to a plan, K (N, nu, nx).

    The linear-quadratic regulator that minimises ``sum |dx / size|² + |du / size|²`` in the
    problem's characteristic sizes: ``K = -(R + B' P B)^-1 B' P A``, ``P <- Q + A' P (A + B K)``,
    ``P_N = Q``. ``A_k, B_k`` are the derivatives along the plan of a barrier law's step, since the
    exact one has none where a contact is about to open or close.

    Raises :class:`~ocp.errors.NotConverged` where such a step is not solved.
    """
    problem, sizes = plan.problem, plan.problem.scales
    x = plan.data["x"].values[scenario]
    all_inputs = plan.data["u"].values
    u = all_inputs[min(scenario, len(all_inputs) - 1)]
    step, function = _smoothed(problem.system, _SMOOTH * sizes.mu)
    p = Evaluation(problem, plan.values).step_values(step, own=False)
    A, B = function.slopes(x[:-1], u, p)[1:]
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
def _smoothed(system: ContactSystem, mu: float) -> tuple[Step, StepFunction]:
    """The step of a barrier law, built once for all plans of a task."""
    step = Barrier(mu=mu).close(system)
    return step, StepFunction(step)


LARGEST = 0.99
"""Share of the way from the middle to a bound at which an input is cut, as no finite action reaches
a bound."""
_ITERATIONS = 500
_ROWS = 64
"""Rows of a product of matrices: those of all samples are shared among threads, which wait for one
another on a busy machine, 50 times as long as they work, and round by how many they are."""


def fit_actions(
    task: Task, states: np.ndarray, inputs: np.ndarray, hidden: tuple[int, ...] = (), seed: int = 0
) -> Trained:
    """The policy with tanh layers ``hidden`` that does ``inputs`` (n, nu) in ``states`` (n, nx).

    It minimises the mean of ``|a(o) - a*|²``, the action before tanh against
    ``a* = artanh((u - mid) / half)``, with u cut to 0.99 of its way to the bounds. Observations are
    normalised by their own mean and deviation. The affine policy, ``()``, is the solution of least
    norm; others are where 500 iterations of L-BFGS lead from weights out of the ``seed``.
    """
    policy = dense(task.observe, hidden, task.lower, task.upper)
    seen = BatchFunction(task.observe, "numpy", 1)(states, task.parameters.values)
    normaliser = Normaliser.identity(seen.shape[1]).after(seen)
    seen = (seen - normaliser.mean) / normaliser.scale
    middle, half = (task.upper + task.lower) / 2, (task.upper - task.lower) / 2
    wanted = np.arctanh(np.clip((inputs - middle) / half, -LARGEST, LARGEST))
    if not hidden:
        features = np.column_stack([seen, np.ones(len(seen))])
        found = np.linalg.lstsq(features, wanted)[0]
        return Trained(np.concatenate([found[:-1].T.ravel(), found[-1]]), normaliser)
    first = first_weights(policy.sizes, 1.0, np.random.default_rng(seed))
    found = minimize(
        squared_error,
        first,
        (policy, seen, wanted),
        "L-BFGS-B",
        jac=True,
        options={"maxiter": _ITERATIONS, "maxfun": 2 * _ITERATIONS},
    )
    return Trained(found.x, normaliser)


def squared_error(
    theta: np.ndarray, policy: DensePolicy, seen: np.ndarray, wanted: np.ndarray
) -> tuple[float, np.ndarray]:
    """Mean of ``|a - a*|²`` over normalised observations (n, n_o), and its gradient (n_theta,).

    ``wanted`` (n, n_a) are the actions a*.
    """
    error, slope = 0.0, np.zeros_like(theta)
    for at in range(0, len(seen), _ROWS):
        part = _summed(theta, policy, seen[at : at + _ROWS], wanted[at : at + _ROWS])
        error, slope = error + part[0], slope + part[1]
    return error / len(seen), slope / len(seen)


def _summed(theta: np.ndarray, policy: DensePolicy, seen: np.ndarray, wanted: np.ndarray) -> tuple[float, np.ndarray]:
    """Sum of ``|a - a*|²`` and its gradient, back through the layers."""
    layers, values = policy.layers(theta), [seen]
    for weights, offsets in layers[:-1]:
        values.append(np.tanh(values[-1] @ weights.T + offsets))
    weights, offsets = layers[-1]
    off = values[-1] @ weights.T + offsets - wanted
    bar = 2 * off
    parts: list[np.ndarray] = []
    for (weights, _), before in zip(reversed(layers), reversed(values), strict=True):
        parts = [(bar.T @ before).ravel(), bar.sum(axis=0), *parts]
        bar = bar @ weights * (1 - before**2)
    return float((off**2).sum()), np.concatenate(parts)
