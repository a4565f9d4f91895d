"""Total propagation: policy gradients from noisy particles, by two gradient estimators mixed at each step."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, fields, replace
from typing import ClassVar

import casadi as ca
import numpy as np

from dynamics.batch import BatchFunction, BatchWarning, RolloutPolicy, StepFunction
from dynamics.batch.graphs.rollout_tapes import ClosedStep
from dynamics.batch.graphs.step_graphs import dependence_table
from dynamics.settings import setting
from ocp.errors import InputError, NotConverged
from ocp.learning.experiment import Experiment
from ocp.learning.protocol import Row, State, TrainedPolicy, policy_vjp
from ocp.learning.rollouts import episode_rewards
from ocp.learning.unrolling import Clipping, Starts, ascend, non_finite_reward_message, with_observations


@dataclass(frozen=True)
class Particles:
    """Simulated trajectories of n particles over H steps, with derivatives; arrays are (H, n, ...).

    ``alive`` is a mask of the particles whose episode still runs before a step. ``rewards`` are discounted, and
    0 after the end. The step has the derivatives ``x_by_x`` (.., nx, nx) and ``x_by_u`` (.., nx, nu), the
    discounted reward ``r_by_x``, ``r_by_u`` and ``r_by_next``, the normalised observations ``o_by_x``, and the
    inputs ``u_by_a`` (.., nu). ``observed`` are the observations.

    Four arrays have the particle as first axis: ``states`` (n, H+1, nx); ``stays_finite`` (n,), a mask of the
    particles whose states are all finite; ``final`` (n,), the discounted final reward of a whole episode; and
    its gradient ``final_by_x`` (n, nx).
    """

    policy: RolloutPolicy
    trained: TrainedPolicy
    states: np.ndarray
    alive: np.ndarray
    rewards: np.ndarray
    observed: np.ndarray
    x_by_x: np.ndarray
    x_by_u: np.ndarray
    r_by_x: np.ndarray
    r_by_u: np.ndarray
    r_by_next: np.ndarray
    o_by_x: np.ndarray
    u_by_a: np.ndarray
    stays_finite: np.ndarray
    final: np.ndarray
    final_by_x: np.ndarray

    @property
    def lived(self) -> np.ndarray:
        """Number of steps (n,) of each particle before its episode ends."""
        return self.alive.sum(axis=0)

    def select(self, selected: np.ndarray) -> Particles:
        """Return the particles in the mask ``selected`` (n,)."""
        sample_first = ("states", "stays_finite", "final", "final_by_x")
        arrays = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in ("policy", "trained")}
        selected_arrays = {n: a[selected] if n in sample_first else a[:, selected] for n, a in arrays.items()}
        return replace(self, **selected_arrays)

    def policy_vjp(self, t: int, bar: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the policy's ``bar' du/dtheta`` (n, n_theta) and ``bar' du/dx`` (n, nx) at step t, for bar (n, nu)."""
        normaliser = self.trained.normaliser
        observations = (self.observed[t] - normaliser.mean) / normaliser.scale
        by_theta, observation_gradient = policy_vjp(self.policy, self.trained.theta, observations, bar * self.u_by_a[t])
        return by_theta, np.einsum("no,nox->nx", observation_gradient, self.o_by_x[t])


def simulate_particles(experiment: Experiment, trained: TrainedPolicy, x0: np.ndarray, noise: np.ndarray) -> Particles:
    """Simulate particles ``x_{t+1} = f(x_t, u_t) + noise_t`` from x0 (n, nx) with noise (H, n, nx)."""
    model, rows = experiment.cached(_ModelStep), []
    x, alive = x0, np.ones(len(x0), dtype=bool)
    stayed_finite, states, weight = alive.copy(), [x0], 1.0
    for step_noise in noise:
        if not alive.any():
            rows.append({name: np.zeros_like(values) for name, values in rows[-1].items()})
            states.append(x)
            continue
        row = model.step(trained, x[alive], step_noise[alive])
        x_next = _scatter(alive, row.pop("x_next"))
        finite = np.isfinite(x_next).all(axis=1)
        stayed_finite &= finite
        weighted = {name: weight * row[name] for name in REWARD_ARRAYS}
        scattered = {name: _scatter(alive, values) for name, values in {**row, **weighted}.items()}
        rows.append({**scattered, "alive": alive})
        x = np.where((alive & finite)[:, None], x_next, x)
        alive = alive & finite & ~model.has_ended(x)
        states.append(x)
        weight *= experiment.discount
    experiment.count_steps(sum(row["alive"].sum() for row in rows))
    final_reward, by_x = np.zeros(len(x)), np.zeros_like(x)
    if len(noise) == experiment.task.horizon:
        final_reward, by_x = model.final(x)
    return Particles(
        policy=experiment.policy,
        trained=trained,
        states=np.stack(states, axis=1),
        stays_finite=stayed_finite,
        final=np.where(alive, weight * final_reward, 0.0),
        final_by_x=np.where(alive[:, None], weight * by_x, 0.0),
        **{name: np.stack([row[name] for row in rows]) for name in rows[0]},
    )


REWARD_ARRAYS = ("rewards", "r_by_x", "r_by_u", "r_by_next")
"""Names of the particles' arrays that are multiplied by the discount."""


def _scatter(alive: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return an array (n, ...) with ``values`` (k, ...) at the k entries in the mask ``alive`` (n,), 0 elsewhere."""
    scattered = np.zeros((len(alive), *values.shape[1:]))
    scattered[alive] = values
    return scattered


class _ModelStep:
    """Compiled step of the model and functions of its task, with their derivatives."""

    def __init__(self, experiment: Experiment) -> None:
        task = experiment.task
        step = experiment.law.close(replace(task.system, parameters=task.parameters))
        self.closed_step, self.acting = step, dict[int, np.ndarray]()
        self.experiment, self.p = experiment, experiment.physics
        self.step_parameters = step.p.pack(task.parameters.unpack(self.p))
        self.step_function = StepFunction(step, threads=experiment.threads)
        self.observe = with_jacobians(task.observe, 1)
        self.reward = with_jacobians(task.rewards, 3)
        self.final_reward = with_jacobians(task.finals, 1)
        self.ends = BatchFunction(task.ends, "numpy", 1)

    def step(self, trained: TrainedPolicy, x: np.ndarray, noise: np.ndarray) -> dict[str, np.ndarray]:
        """Return the next states ``x_next`` from ``x`` (n, nx), and the arrays of :class:`Particles` at this step."""
        task, (n, nx) = self.experiment.task, x.shape
        u = self.experiment.inputs(trained, x)
        observations, by_x = self.observe(x, self.p)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", BatchWarning)
            steps, x_by_x, x_by_u = self.step_function.derivatives(x, u, self.step_parameters)
            x_next = steps.x_next + noise
            rewards, r_by_x, r_by_u, r_by_next = self.reward(x, u, x_next, self.p)
        columns = by_x.reshape(n, nx, -1).transpose(0, 2, 1)
        return {
            "x_next": x_next,
            "rewards": rewards[:, 0],
            "observed": observations,
            "x_by_x": x_by_x,
            "x_by_u": x_by_u,
            "r_by_x": r_by_x,
            "r_by_u": r_by_u,
            "r_by_next": r_by_next,
            "o_by_x": columns / trained.normaliser.scale[:, None],
            "u_by_a": task.half_range * (1 - ((u - task.mid_range) / task.half_range) ** 2),
        }

    def has_ended(self, x: np.ndarray) -> np.ndarray:
        """Return a mask (n,) of the states x (n, nx) at which an episode ends."""
        return self.ends(x, self.p)[:, 0] != 0

    def final(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the final reward (n,) at states x (n, nx), and its gradient (n, nx)."""
        value, slope = self.final_reward(x, self.p)
        return value[:, 0], slope


def acting_entries(experiment: Experiment, steps: int) -> np.ndarray:
    """Return a mask (steps, nx) of the entries of each x_{t+1} on which the return depends.

    Here the return includes the reward of the step from t to t+1, since that reward depends on the particle's
    noise.
    """
    model, task = experiment.cached(_ModelStep), experiment.task
    if steps not in model.acting:
        closed = ClosedStep(model.closed_step, episode_rewards(task, steps), experiment.policy)
        later, arguments = closed.cost_dependence.masks(steps)[1], task.rewards.sx_in()
        acts_at_once = dependence_table(task.rewards(*arguments), arguments[2])
        model.acting[steps] = later[:, : task.system.nx] | acts_at_once
    return model.acting[steps]


def with_jacobians(fn: ca.Function, count: int) -> BatchFunction:
    """Return a batch function of ``fn`` and its Jacobians by the first ``count`` arguments, in column-major order."""
    arguments = fn.sx_in()
    value = fn(*arguments)
    slopes = [ca.densify(ca.jacobian(value, argument)) for argument in arguments[:count]]
    return BatchFunction(ca.Function(fn.name(), arguments, [value, *slopes]), "numpy", 1)


@dataclass(frozen=True, kw_only=True)
class TotalPropagation(Clipping):
    """Algorithm of gradient ascent by total propagation along particles ``x_{t+1} = f(x_t, u_t) + sigma e_t``.

    Backwards in time, the gradient with respect to the mean of x_{t+1} is estimated by the likelihood ratio, L,
    and by reparameterisation, R. Both estimates are mixed as ``k L + (1 - k) R``, ``k = 1 / (1 + v_L / v_R)``,
    where v_L and v_R are the variances over particles of the resulting gradients of the policy's parameters
    (:func:`total_propagation`). ``sigma`` [units of the state] is the same for all entries; actions have no
    noise.

    Source: Parmas, Rasmussen, Peters and Doya (ICML 2018), algorithm 1. Their method PIPPS also uses a learned
    Gaussian process as f, and importance weights over the batch in L.
    """

    name: ClassVar[str] = "total-propagation"
    summary: ClassVar[str] = "gradients of both orders, mixed at every step of the backward pass"
    contact: ClassVar[str] = "exact"

    sigma: float = setting(1e-2, "standard deviation of the particles' noise", "units of the state", above=0)
    samples: int = setting(64, "unrolls per iteration", hint="a variance needs two", least=2)

    def iterate(self, experiment: Experiment, state: State, k: int) -> tuple[State, Row]:
        """Simulate particles and make one step along their total-propagation gradient."""
        starts, steps = Starts.from_state(state), self.steps(experiment)
        shape = (steps, *starts.x.shape)
        noise = experiment.rng(k, "states").standard_normal(shape)
        particles = simulate_particles(experiment, TrainedPolicy.from_state(state), starts.x, self.sigma * noise)
        non_finite = np.argwhere(particles.stays_finite & ~np.isfinite(particles.rewards))
        if len(non_finite):
            step, sample = non_finite[0].tolist()
            raise InputError(non_finite_reward_message(experiment, step, f"sample {sample} in iteration {k}"))
        finite = particles.stays_finite
        if finite.sum() < 2:
            raise NotConverged(
                f"{experiment.task.name}: {finite.sum()} of {self.samples} particles of iteration {k}"
                " stayed finite; lower the learning rate, sigma or the unroll length"
            )
        finite_particles = particles.select(finite)
        score = acting_entries(experiment, steps)[:, None] * noise[:, finite] / self.sigma
        gradients, share = total_propagation(finite_particles, score)
        gradients = self.clip_gradients(gradients)
        gradient = gradients.mean(axis=0)
        new_state = {
            **ascend(self.optimiser, state, gradient, self.rate),
            **starts.after(experiment, particles.states, particles.lived, k).arrays(),
        }
        changed = with_observations(experiment, new_state, finite_particles.observed[finite_particles.alive])
        row = {
            "return_mean": float(finite_particles.rewards.sum(axis=0).mean()),
            "nonfinite": float((~finite).sum()),
            "gradient_norm": float(np.linalg.norm(gradient)),
            "gradient_variance": float(gradients.var(axis=0, ddof=1).sum()),
            "likelihood_ratio_share": float(share.mean()),
        }
        return changed, row


def total_propagation(particles: Particles, score: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the gradients (n, n_theta) of the return, and the weight k (H,) of the likelihood ratio at each step.

    ``score`` (H, n, nx) is the score function of the mean of x_{t+1}, ``e_t / sigma``, or 0 for entries that do
    not affect the return. With the return G_{t+1} from x_{t+1} on and its gradient g, the gradient of ``r_t +
    G_{t+1}`` with respect to the mean of x_{t+1} is estimated by ``R = dr_t/dx_{t+1} + g`` and ``L = (r_t +
    G_{t+1} - b) score``, where b is the mean over the other particles that are alive.
    """
    state_gradient, returns_to_go = particles.final_by_x, particles.final
    total, shares = 0.0, np.zeros(len(particles.alive))
    for t in reversed(range(len(shares))):
        alive = particles.alive[t]
        alive_column = alive[:, None]
        returns_to_go = np.where(alive, particles.rewards[t] + returns_to_go, 0.0)
        advantage = (returns_to_go - _mean_of_others(returns_to_go, alive))[:, None]
        gradients = [
            np.where(alive_column, bar, 0.0) for bar in (advantage * score[t], particles.r_by_next[t] + state_gradient)
        ]
        by_x, by_u = particles.x_by_x[t], particles.x_by_u[t]
        by_theta = [particles.policy_vjp(t, _vector_jacobian(bar, by_u))[0] for bar in gradients]
        v_L, v_R = (float(by_order.var(axis=0, ddof=1).sum()) for by_order in by_theta)
        k = shares[t] = v_R / (v_L + v_R) if v_L + v_R > 0 else 0.0
        mixed_gradient = k * gradients[0] + (1 - k) * gradients[1]
        bar_u = np.where(alive_column, _vector_jacobian(mixed_gradient, by_u) + particles.r_by_u[t], 0.0)
        change, policy_gradient = particles.policy_vjp(t, bar_u)
        total = total + change
        state_gradient = np.where(
            alive_column, _vector_jacobian(mixed_gradient, by_x) + particles.r_by_x[t] + policy_gradient, 0.0
        )
    return np.asarray(total), shares


def _vector_jacobian(bar: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Return the product ``bar' slope`` (n, b) of bar (n, a) and the Jacobian slope (n, a, b) for each sample."""
    return np.einsum("na,nab->nb", bar, slope)


def _mean_of_others(values: np.ndarray, alive: np.ndarray) -> np.ndarray:
    """Return for each particle the mean of ``values`` (n,) over the other living particles, or 0 if there are none."""
    count = alive.sum()
    return (values[alive].sum() - values) / max(count - 1, 1) if count > 1 else 0.0 * values
