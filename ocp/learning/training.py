"""Policies judged under any law, and the loop that every algorithm runs in."""

from __future__ import annotations

import json
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import count
from typing import TYPE_CHECKING, Any

import numpy as np

from dynamics.batch import BatchFunction, BatchWarning
from dynamics.contact import ContactLaw
from ocp.errors import InputError
from ocp.learning.experiment import EXACT, Experiment, at_least
from ocp.learning.mbpo import MBPO
from ocp.learning.protocol import Algorithm, Row, State, Trained, prefixed, under
from ocp.learning.total_propagation import TotalPropagation
from ocp.learning.unroll_gradients import ARS, FOPG, ZOPG, AoBG
from ocp.learning.unrolling import non_finite_reward
from ocp.problem.resources import check_memory
from ocp.problem.task import Task
from ocp.store.checkpoint import Checkpoint
from ocp.store.json_values import to_json

if TYPE_CHECKING:
    import xarray as xr


SEED = 1_000_000
"""Of the first states that policies are judged from, by default; training draws others."""


@dataclass(frozen=True)
class Evaluation:
    """Episodes of a policy: the sum of rewards ``returns`` (n,), undiscounted; steps ``lengths``
    (n,) until their end; ``measures``, of each the mean over an episode's steps (n,); ``states``
    (n, N+1, nx), the last one repeated after the end; ``inputs`` (n, N, nu), 0 after the end.

    ``unsolved`` (k, 2) are sample and step of the contacts that found no solution; their episode's
    return counts no further.
    """

    returns: np.ndarray
    lengths: np.ndarray
    measures: dict[str, np.ndarray]
    states: np.ndarray
    inputs: np.ndarray
    unsolved: np.ndarray

    def summary(self) -> dict[str, float]:
        """Means over the episodes, the spread of returns, and the share of steps unsolved."""
        steps = max(float(self.lengths.sum()), 1.0)
        return {
            "return": float(self.returns.mean()),
            "return_deviation": float(self.returns.std()),
            "length": float(self.lengths.mean()),
            **{name: float(values.mean()) for name, values in self.measures.items()},
            "unsolved": len(self.unsolved) / steps,
        }


def evaluate(
    experiment: Experiment,
    trained: Trained,
    law: ContactLaw,
    episodes: int = 100,
    seed: int = SEED,
) -> Evaluation:
    """Episodes of the policy at the task's own parameters, from first states out of ``seed``.

    Raises :class:`~ocp.errors.InputError` where a reward is not a number though states are, with
    step and episode.
    """
    at_least(1, "episodes", episodes)
    x0 = experiment.task.reset(episodes, np.random.default_rng(seed))
    return evaluate_from(experiment, trained, law, x0)


def evaluate_from(experiment: Experiment, trained: Trained, law: ContactLaw, x0: np.ndarray) -> Evaluation:
    """As :func:`evaluate`, from first states ``x0`` (n, nx)."""
    found = experiment.rollouts(experiment.task.horizon, law)(
        x0, trained.theta, trained.normaliser, n_samples=len(x0), states=True
    )
    states, lived = found.states, found.lived.astype(int)
    task, (n, nodes) = experiment.task, states.shape[:2]
    steps = np.arange(nodes - 1)
    ok = np.isfinite(states[:, 1:]).all(axis=-1)
    reached = np.where(ok.all(axis=-1), nodes - 1, np.argmin(ok, axis=1))
    lost = np.flatnonzero(reached < lived)
    unsolved = np.column_stack([lost, reached[lost]])
    lengths = np.minimum(lived, reached)
    on = steps < lengths[:, None]
    inputs = np.zeros((n, nodes - 1, task.system.nu))
    inputs[on] = experiment.inputs(trained, states[:, :-1][on])
    at = states[:, :-1][on], inputs[on], states[:, 1:][on], task.parameters.values
    returns = np.zeros((n, nodes - 1))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BatchWarning)
        returns[on] = BatchFunction(task.rewards, "numpy", 1)(*at)[:, 0]
    lost = np.argwhere(~np.isfinite(returns))
    if len(lost):
        episode, step = lost[0].tolist()
        raise InputError(non_finite_reward(experiment, step, f"episode {episode} of the evaluation"))
    whole = lengths == nodes - 1
    ended = BatchFunction(task.ends, "numpy", 1)(states[whole, -1], task.parameters.values)
    total = returns.sum(axis=1)
    finals = BatchFunction(task.finals, "numpy", 1)(states[whole, -1], task.parameters.values)
    total[whole] += np.where(ended[:, 0] == 0, finals[:, 0], 0.0)
    return Evaluation(total, lengths, _measures(task, at, on, lengths), states, inputs, unsolved)


def _measures(task: Task, at: tuple[np.ndarray, ...], on: np.ndarray, lengths: np.ndarray) -> dict[str, np.ndarray]:
    """Means of the task's measures over the steps of each episode that count, ``on`` (n, N)."""
    if not task.measures:
        return {}
    values = np.zeros((*on.shape, len(task.measures)))
    values[on] = BatchFunction(task.measure, "numpy", 1)(*at)
    means = values.sum(axis=1) / np.maximum(lengths, 1)[:, None]
    names = (measure.signal.name for measure in task.measures)
    return dict(zip(names, means.T, strict=True))


ALGORITHMS: dict[str, type[Algorithm]] = {
    algorithm.name: algorithm for algorithm in (FOPG, ZOPG, ARS, AoBG, TotalPropagation, MBPO)
}


KEY = "training"
"""Name of the arrays in a checkpoint."""
_RUN, _CURVE, _SETTINGS, _BEST = "run.", "curve.", "settings", "best."

Report = Callable[[int, Row], None]
"""Called with the number of iterations done and what is told of them."""


@dataclass
class _Progress:
    """State of a training; ``best`` is the policy that was judged best so far."""

    state: State
    rows: list[Row] = field(default_factory=list)
    best: State = field(default_factory=dict)
    spent: float = 0.0

    @property
    def steps(self) -> float:
        """Simulated steps of all rows."""
        return sum(row.get("env_steps", 0.0) for row in self.rows)


def train(experiment: Experiment, checkpoint: Checkpoint | None = None, report: Report | None = None) -> xr.Dataset:
    """Run the experiment, from where ``checkpoint`` stopped, and return curves and policy.

    Row k of the curves, over ``iteration`` 0..iterations, tells of the policy after k iterations:
    ``evaluation_*`` under the exact law where it was judged, ``env_steps`` simulated (all that
    :meth:`Experiment.count_steps` was told of, but no judgement) and ``wall_s`` [s] spent to get
    there, and what iteration k itself told (return of the samples, gradient), NaN in the last row.
    ``theta``, ``mean`` and ``scale`` are of the policy that was judged best,
    ``theta_last`` of the last one; ``psi`` are the parameters of the model in the end.

    All but times is the same to the last bit whether or not the run was stopped on its way, and
    for any number of threads.

    Raises :class:`~ocp.errors.InputError` where the checkpoint is of other settings, and what the
    algorithm raises.
    """
    progress = _resume(experiment, checkpoint) or _start(experiment)
    algorithm, budget, steps, marks = experiment.algorithm, experiment.budget, progress.steps, -1
    if budget and progress.rows:
        marks = budget.passed(steps - progress.rows[-1]["env_steps"])
    for k in count(len(progress.rows)):
        started = time.monotonic()
        last, due = k == experiment.iterations, k % experiment.evaluate_every == 0
        if budget:
            last, before, marks = steps >= budget.steps, marks, budget.passed(steps)
            due = marks > before
        judged = _judge(experiment, progress, k) if last or due else {}
        told: Row = {}
        if not last:
            progress.state, told = algorithm.iterate(experiment, progress.state, k)
            told["env_steps"] = experiment.take_step_count()
            steps += told["env_steps"]
        row = {"wall_s": progress.spent, **judged, **told}
        progress.spent += time.monotonic() - started
        progress.rows.append(row)
        if report is not None:
            report(k, row)
        if checkpoint is not None and not last and checkpoint.due():
            checkpoint.save_state(KEY, **_arrays(experiment, progress))
        if last:
            break
    return _result(experiment, progress)


def read_checkpoint(arrays: dict[str, np.ndarray]) -> tuple[int, dict[str, Any]]:
    """How many iterations a checkpoint's arrays under :data:`KEY` hold, and of which settings."""
    return len(arrays[f"{_CURVE}wall_s"]), json.loads(str(arrays[_SETTINGS]))


def _start(experiment: Experiment) -> _Progress:
    experiment.take_step_count()
    return _Progress(experiment.algorithm.begin(experiment))


def _judge(experiment: Experiment, progress: _Progress, k: int) -> Row:
    """Evaluate the policy on the same episodes every time, and keep it where it is the best."""
    trained = experiment.algorithm.policy(experiment, progress.state)
    found = evaluate(experiment, trained, EXACT, experiment.episodes)
    row = {f"evaluation_{name}": value for name, value in found.summary().items()}
    held, normaliser = progress.best.get("return"), trained.normaliser
    if held is None or row["evaluation_return"] > float(held):
        progress.best = {
            "return": np.array(row["evaluation_return"]),
            "iteration": np.array(k),
            "theta": trained.theta,
            "mean": normaliser.mean,
            "scale": normaliser.scale,
        }
    return row


def _arrays(experiment: Experiment, progress: _Progress) -> dict[str, Any]:
    """What a checkpoint holds."""
    return {
        **prefixed(_RUN, progress.state),
        **prefixed(_BEST, progress.best),
        **prefixed(_CURVE, _curves(progress.rows)),
        "spent": np.array(progress.spent),
        _SETTINGS: np.array(json.dumps(to_json(experiment.settings()), sort_keys=True)),
    }


def _resume(experiment: Experiment, checkpoint: Checkpoint | None) -> _Progress | None:
    found = None if checkpoint is None else checkpoint.state(KEY)
    if found is None:
        return None
    _check_same_settings(json.loads(str(found[_SETTINGS])), to_json(experiment.settings()))
    curves = under(_CURVE, found)
    rows = [
        {name: float(values[i]) for name, values in curves.items() if not np.isnan(values[i])}
        for i in range(len(curves["wall_s"]))
    ]
    if experiment.budget is None and len(rows) > experiment.iterations:
        raise InputError(
            f"the run to resume has {len(rows)} iterations already, more than the"
            f" {experiment.iterations} requested; request more"
        )
    return _Progress(under(_RUN, found), rows, under(_BEST, found), float(found["spent"]))


def _check_same_settings(stored: dict[str, Any], asked: dict[str, Any]) -> None:
    differ = [n for n in {**stored, **asked} if stored.get(n) != asked.get(n)]
    if differ:
        told = ", ".join(f"{n} = {stored.get(n)} not {asked.get(n)}" for n in differ)
        raise InputError(f"the run to resume has other settings: {told}; give the same, or start a new run")


def _curves(rows: list[Row]) -> dict[str, np.ndarray]:
    names = dict.fromkeys(name for row in rows for name in row)
    return {name: np.array([row.get(name, np.nan) for row in rows]) for name in names}


def _result(experiment: Experiment, progress: _Progress) -> xr.Dataset:
    import xarray as xr

    curves = _curves(progress.rows)
    steps = np.nan_to_num(curves["env_steps"])
    curves["env_steps"] = np.concatenate([[0.0], np.cumsum(steps)[:-1]])
    trained = experiment.algorithm.policy(experiment, progress.state)
    best = progress.best
    return xr.Dataset(
        {
            **{name: ("iteration", values) for name, values in curves.items()},
            "theta": ("parameter", best["theta"]),
            "theta_last": ("parameter", trained.theta),
            "mean": ("observation", best["mean"]),
            "scale": ("observation", best["scale"]),
            "psi": ("physical", progress.state.get("psi", experiment.physics)),
            "best_iteration": ((), int(best["iteration"])),
        },
        coords={
            "iteration": np.arange(len(progress.rows)),
            "observation": [signal.name for signal in experiment.task.observations],
            "physical": [parameter.name for parameter in experiment.task.parameters],
        },
        attrs=to_json(experiment.settings()),
    )


_ROW = 1e3
"""Bytes of what one iteration tells."""
_COPIES = 4
_OF_EPISODES = ("samples", "walkers", "directions")
_OF_STEPS = ("capacity", "explored", "batch", "model_batch", "rows", "candidates")


def check_training(experiment: Experiment, side_by_side: int) -> None:
    """Raise :class:`~ocp.errors.InputError` where so many at once need too much memory.

    That of each is states and inputs of all steps that are held at once, weights, and the curves.
    """
    task, own = experiment.task, _counts(experiment)
    system = task.system
    steps = experiment.episodes * task.horizon + sum(own.get(name, 0.0) for name in _OF_STEPS)
    length = own.get("unroll", own.get("steps", float(task.horizon)))
    steps += sum(own.get(name, 0.0) for name in _OF_EPISODES) * length
    steps += own.get("branches", 0.0) * own.get("longest", 0.0) * own.get("kept", 1.0)
    numbers = steps * (2 * system.nx + system.nu + len(task.observations) + 1)
    weights = experiment.policy.n_theta * (_COPIES + own.get("directions", 0.0))
    for units, layers in (("model_units", "model_layers"), ("critic_units", "critic_layers")):
        network = own.get(units, 0.0) ** 2 * own.get(layers, 0.0)
        weights += _COPIES * network * own.get("members", 1.0)
    weights += _COPIES * own.get("critic", 0.0) ** 2
    each = 8.0 * (_COPIES * numbers + weights) + _ROW * experiment.iterations
    check_memory(f"training {task.name} by {experiment.algorithm.name}", each * side_by_side)


def _counts(experiment: Experiment) -> dict[str, float]:
    """Whole-number settings of the algorithm, and of the one that it stands around."""
    found: dict[str, float] = {}
    settings: dict[str, Any] = experiment.algorithm.settings()
    for name, value in settings.items():
        if isinstance(value, int) and not isinstance(value, bool):
            short = name.removeprefix("of.").removeprefix("search.")
            found[short] = found.get(short, 0.0) + float(value)
    return found
