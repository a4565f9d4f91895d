"""Particles of a noisy model, step by step, and all the derivatives along their ways."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, fields, replace

import casadi as ca
import numpy as np

from dynamics.batch import BatchFunction, BatchWarning, RolloutPolicy, StepFunction
from dynamics.batch.graphs.acting import depends
from dynamics.batch.graphs.rollout_tapes import Closed
from ocp.learning.experiment import Experiment
from ocp.learning.network import vjp
from ocp.learning.protocol import Trained
from ocp.learning.rollouts import episode_rewards


@dataclass(frozen=True)
class Particles:
    """n particles over H steps; all arrays (H, n, ...) but ``states`` (n, H+1, nx) and the last.

    ``alive`` before a step; ``rewards`` with their discount, 0 where not alive; ``x_by_x`` (.., nx,
    nx) and ``x_by_u`` (.., nx, nu) of the step, ``r_by_x``, ``r_by_u`` and ``r_by_next`` of the
    discounted reward; ``seen`` observations, ``o_by_x`` of the normalised ones; ``u_by_a`` (.., nu)
    of the squashing. ``lived`` (n,) steps before the end; ``good`` (n,) those that stayed finite;
    ``final`` (n,) and ``final_by_x`` (n, nx) what is gained at the end of a whole episode.
    """

    policy: RolloutPolicy
    trained: Trained
    states: np.ndarray
    alive: np.ndarray
    rewards: np.ndarray
    seen: np.ndarray
    x_by_x: np.ndarray
    x_by_u: np.ndarray
    r_by_x: np.ndarray
    r_by_u: np.ndarray
    r_by_next: np.ndarray
    o_by_x: np.ndarray
    u_by_a: np.ndarray
    good: np.ndarray
    final: np.ndarray
    final_by_x: np.ndarray

    @property
    def lived(self) -> np.ndarray:
        """Steps of each particle before its end."""
        return self.alive.sum(axis=0)

    def part(self, chosen: np.ndarray) -> Particles:
        """Those of ``chosen`` (n,) alone."""
        of_first = ("states", "good", "final", "final_by_x")
        arrays = {
            f.name: getattr(self, f.name)
            for f in fields(self)
            if f.name not in ("policy", "trained")
        }
        cut = {n: a[chosen] if n in of_first else a[:, chosen] for n, a in arrays.items()}
        return replace(self, **cut)

    def pulled(self, t: int, bar: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """``bar' du/dtheta`` (n, n_theta) and ``bar' du/dx`` (n, nx) at step t, bar (n, nu)."""
        normaliser = self.trained.normaliser
        seen = (self.seen[t] - normaliser.mean) / normaliser.scale
        by_theta, by_o = vjp(self.policy, self.trained.theta, seen, bar * self.u_by_a[t])
        return by_theta, np.einsum("no,nox->nx", by_o, self.o_by_x[t])


def simulate_particles(
    experiment: Experiment, trained: Trained, x0: np.ndarray, noise: np.ndarray
) -> Particles:
    """Particles ``x_{t+1} = f(x_t, u_t) + noise_t`` from x0 (n, nx), noise (H, n, nx)."""
    model, rows = experiment.cached(_Model), []
    x, alive = x0, np.ones(len(x0), dtype=bool)
    good, states, weight = alive.copy(), [x0], 1.0
    for each in noise:
        if not alive.any():
            rows.append({name: np.zeros_like(values) for name, values in rows[-1].items()})
            states.append(x)
            continue
        row = model.step(trained, x[alive], each[alive])
        x_next = _scatter(alive, row.pop("x_next"))
        finite = np.isfinite(x_next).all(axis=1)
        good &= finite
        of_reward = {name: weight * row[name] for name in _OF_REWARD}
        kept = {name: _scatter(alive, values) for name, values in {**row, **of_reward}.items()}
        rows.append({**kept, "alive": alive})
        x = np.where((alive & finite)[:, None], x_next, x)
        alive = alive & finite & ~model.ended(x)
        states.append(x)
        weight *= experiment.discount
    experiment.count_steps(sum(row["alive"].sum() for row in rows))
    gain, by_x = np.zeros(len(x)), np.zeros_like(x)
    if len(noise) == experiment.task.horizon:
        gain, by_x = model.final(x)
    return Particles(
        policy=experiment.policy,
        trained=trained,
        states=np.stack(states, axis=1),
        good=good,
        final=np.where(alive, weight * gain, 0.0),
        final_by_x=np.where(alive[:, None], weight * by_x, 0.0),
        **{name: np.stack([row[name] for row in rows]) for name in rows[0]},
    )


_OF_REWARD = ("rewards", "r_by_x", "r_by_u", "r_by_next")


def _scatter(alive: np.ndarray, values: np.ndarray) -> np.ndarray:
    """``values`` (k, ...) of the k that are ``alive`` (n,), 0 for the others."""
    found = np.zeros((len(alive), *values.shape[1:]))
    found[alive] = values
    return found


class _Model:
    """One step of the model with its derivatives, and those of the task's functions."""

    def __init__(self, experiment: Experiment) -> None:
        task = experiment.task
        step = experiment.law.close(replace(task.system, parameters=task.parameters))
        self.closed, self.reach = step, dict[int, np.ndarray]()
        self.experiment, self.p = experiment, experiment.physics
        self.whole = step.p.pack(experiment.parameters_by_name(self.p))
        self.take = StepFunction(step, threads=experiment.threads)
        self.observe = with_jacobians(task.observe, 1)
        self.reward = with_jacobians(task.rewards, 3)
        self.gain = with_jacobians(task.finals, 1)
        self.ends = BatchFunction(task.ends, "numpy", 1)

    def step(self, trained: Trained, x: np.ndarray, noise: np.ndarray) -> dict[str, np.ndarray]:
        """Next states ``x_next`` of ``x`` (n, nx) and the entries of a row of particles."""
        task, (n, nx) = self.experiment.task, x.shape
        u = self.experiment.inputs(trained, x)
        seen, by_x = self.observe(x, self.p)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", BatchWarning)
            steps, x_by_x, x_by_u = self.take.slopes(x, u, self.whole)
            x_next = steps.x_next + noise
            rewards, r_by_x, r_by_u, r_by_next = self.reward(x, u, x_next, self.p)
        half, middle = (task.upper - task.lower) / 2, (task.upper + task.lower) / 2
        columns = by_x.reshape(n, nx, -1).transpose(0, 2, 1)
        return {
            "x_next": x_next,
            "rewards": rewards[:, 0],
            "seen": seen,
            "x_by_x": x_by_x,
            "x_by_u": x_by_u,
            "r_by_x": r_by_x,
            "r_by_u": r_by_u,
            "r_by_next": r_by_next,
            "o_by_x": columns / trained.normaliser.scale[:, None],
            "u_by_a": half * (1 - ((u - middle) / half) ** 2),
        }

    def ended(self, x: np.ndarray) -> np.ndarray:
        """Whether an episode ends at x, (n,)."""
        return self.ends(x, self.p)[:, 0] != 0

    def final(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What is gained at the end, (n,), and its slope (n, nx)."""
        value, slope = self.gain(x, self.p)
        return value[:, 0], slope


def acting_entries(experiment: Experiment, steps: int) -> np.ndarray:
    """Which entries of each x_{t+1} have a way to the return of ``steps`` steps, (steps, nx).

    By the reward of the step that ends there as well: what a particle is moved by is in it.
    """
    known, task = experiment.cached(_Model), experiment.task
    if steps not in known.reach:
        closed = Closed(known.closed, episode_rewards(task, steps), experiment.policy)
        later, arguments = closed.ways().over(steps)[1], task.rewards.sx_in()
        at_once = depends(task.rewards(*arguments), arguments[2])
        known.reach[steps] = later[:, : task.system.nx] | at_once
    return known.reach[steps]


def with_jacobians(fn: ca.Function, count: int) -> BatchFunction:
    """``fn`` with its dense Jacobians by the first ``count`` arguments, each column by column."""
    arguments = fn.sx_in()
    value = fn(*arguments)
    slopes = [ca.densify(ca.jacobian(value, argument)) for argument in arguments[:count]]
    return BatchFunction(ca.Function(fn.name(), arguments, [value, *slopes]), "numpy", 1)
