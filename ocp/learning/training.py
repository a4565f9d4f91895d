"""Evaluation of policies under any contact law, and the training loop that all algorithms use."""

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
from dynamics.limits import EPISODES
from dynamics.settings import read_value
from ocp.errors import InputError
from ocp.learning.experiment import EXACT, Experiment
from ocp.learning.mbpo import MBPO
from ocp.learning.protocol import Algorithm, Row, State, TrainedPolicy, with_prefix, without_prefix
from ocp.learning.total_propagation import TotalPropagation
from ocp.learning.unroll_gradients import ARS, FOPG, ZOPG, AoBG
from ocp.learning.unrolling import non_finite_reward_message
from ocp.problem.resources import check_memory
from ocp.problem.task import Task
from ocp.store.checkpoint import UNSAVED, SavedWork
from ocp.store.json_values import to_json

if TYPE_CHECKING:
    import xarray as xr


EVALUATION_SEED = 1_000_000
"""Default seed of the initial states of evaluations; it differs from seeds of training."""


@dataclass(frozen=True)
class PolicyEvaluation:
    """Simulated episodes of a policy.

    ``returns`` (n,) are undiscounted sums of rewards, and ``lengths`` (n,) the numbers of steps until the end.
    ``measures`` maps names to means (n,) over the steps of each episode. After the end of an episode,
    ``states`` (n, N+1, nx) repeats the last state and ``inputs`` (n, N, nu) is 0. Each row of ``unsolved`` (k,
    2) is an episode and the step at which it ended because the contacts could not be solved.
    """

    returns: np.ndarray
    lengths: np.ndarray
    measures: dict[str, np.ndarray]
    states: np.ndarray
    inputs: np.ndarray
    unsolved: np.ndarray

    def summary(self) -> dict[str, float]:
        """Return means over the episodes, the standard deviation of returns, and the fraction of unsolved steps."""
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
    trained: TrainedPolicy,
    law: ContactLaw,
    episodes: int = 100,
    seed: int = EVALUATION_SEED,
) -> PolicyEvaluation:
    """Simulate episodes of a policy at the task's parameters, from random initial states drawn with ``seed``.

    Raises :class:`~ocp.errors.InputError`, naming step and episode, if a reward is not finite at finite states.
    """
    read_value("episodes", episodes, int, **EPISODES)
    x0 = experiment.task.reset(episodes, np.random.default_rng(seed))
    return evaluate_from(experiment, trained, law, x0)


def evaluate_from(experiment: Experiment, trained: TrainedPolicy, law: ContactLaw, x0: np.ndarray) -> PolicyEvaluation:
    """Simulate episodes of a policy from given states ``x0`` (n, nx); see :func:`evaluate`."""
    episodes = experiment.rollouts(experiment.task.horizon, law)(
        x0, trained.theta, trained.normaliser, n_samples=len(x0), states=True
    )
    states, lived = episodes.states, episodes.lived.astype(int)
    task, (n, nodes) = experiment.task, states.shape[:2]
    steps = np.arange(nodes - 1)
    finite = np.isfinite(states[:, 1:]).all(axis=-1)
    reached = np.where(finite.all(axis=-1), nodes - 1, np.argmin(finite, axis=1))
    non_finite = np.flatnonzero(reached < lived)
    unsolved = np.column_stack([non_finite, reached[non_finite]])
    lengths = np.minimum(lived, reached)
    counted = steps < lengths[:, None]
    inputs = np.zeros((n, nodes - 1, task.system.nu))
    inputs[counted] = experiment.inputs(trained, states[:, :-1][counted])
    arguments = states[:, :-1][counted], inputs[counted], states[:, 1:][counted], task.parameters.values
    returns = np.zeros((n, nodes - 1))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BatchWarning)
        returns[counted] = BatchFunction(task.rewards, "numpy", 1)(*arguments)[:, 0]
    non_finite = np.argwhere(~np.isfinite(returns))
    if len(non_finite):
        episode, step = non_finite[0].tolist()
        raise InputError(non_finite_reward_message(experiment, step, f"episode {episode} of the evaluation"))
    full_length = lengths == nodes - 1
    has_ended = BatchFunction(task.ends, "numpy", 1)(states[full_length, -1], task.parameters.values)
    total = returns.sum(axis=1)
    finals = BatchFunction(task.finals, "numpy", 1)(states[full_length, -1], task.parameters.values)
    total[full_length] += np.where(has_ended[:, 0] == 0, finals[:, 0], 0.0)
    return PolicyEvaluation(total, lengths, _measures(task, arguments, counted, lengths), states, inputs, unsolved)


def _measures(
    task: Task, arguments: tuple[np.ndarray, ...], counted: np.ndarray, lengths: np.ndarray
) -> dict[str, np.ndarray]:
    """Return a mapping from names of measures to means (n,) over the steps in the mask ``counted`` (n, N)."""
    if not task.measures:
        return {}
    values = np.zeros((*counted.shape, len(task.measures)))
    values[counted] = BatchFunction(task.measure, "numpy", 1)(*arguments)
    means = values.sum(axis=1) / np.maximum(lengths, 1)[:, None]
    names = (measure.signal.name for measure in task.measures)
    return dict(zip(names, means.T, strict=True))


ALGORITHMS: dict[str, type[Algorithm]] = {
    algorithm.name: algorithm for algorithm in (FOPG, ZOPG, ARS, AoBG, TotalPropagation, MBPO)
}
"""Mapping from names to the algorithms that learn a policy."""


CHECKPOINT_KEY = "training"
"""Name under which a checkpoint stores a training's arrays."""
STATE_PREFIX = "run."
"""Prefix of the algorithm's state in a training's checkpoint."""
CURVE_PREFIX = "curve."
"""Prefix of the learning curves in a training's checkpoint."""
SETTINGS_KEY = "settings"
"""Name of the experiment's settings, as JSON, in a training's checkpoint."""
BEST_PREFIX = "best."
"""Prefix of the best policy in a training's checkpoint."""

Report = Callable[[int, Row], None]
"""Callback with the number of an iteration and its row, called after each iteration."""


@dataclass
class _Progress:
    """Progress of a training: algorithm's state, rows of the iterations, and the best policy evaluated so far."""

    state: State
    rows: list[Row] = field(default_factory=list)
    best: State = field(default_factory=dict)
    seconds_spent: float = 0.0

    @property
    def steps(self) -> float:
        """Number of steps simulated in all iterations so far."""
        return sum(row.get("env_steps", 0.0) for row in self.rows)


def train(experiment: Experiment, checkpoint: SavedWork = UNSAVED, report: Report | None = None) -> xr.Dataset:
    """Run an experiment, or continue it from ``checkpoint``; return learning curves and the policy.

    The curves are arrays over ``iteration`` 0..iterations. Entry k describes the policy after k iterations: its
    results ``evaluation_*`` under the exact law, if it was evaluated; and the total number of simulated steps
    ``env_steps`` (without evaluations) and the total time ``wall_s`` [s] at that point. The other curves are metrics of
    iteration k itself, such as return and gradient norm, with NaN as last entry. ``theta``, ``mean`` and
    ``scale`` belong to the policy with the best evaluation, ``theta_last`` to the last policy, and ``psi`` are
    the final parameters of the model. Results except times are bitwise the same with and without interruptions,
    for any number of threads.

    Raises :class:`~ocp.errors.InputError` if the checkpoint is from an experiment with other settings, and the
    errors of the algorithm.
    """
    progress = _resume(experiment, checkpoint) or _begin(experiment)
    algorithm, budget, steps, intervals = experiment.algorithm, experiment.budget, progress.steps, -1
    if budget and progress.rows:
        intervals = budget.intervals_in(steps - progress.rows[-1]["env_steps"])
    for k in count(len(progress.rows)):
        started = time.monotonic()
        is_last, is_due = k == experiment.iterations, k % experiment.evaluate_every == 0
        if budget:
            is_last, old_intervals, intervals = steps >= budget.steps, intervals, budget.intervals_in(steps)
            is_due = intervals > old_intervals
        evaluation = _evaluate_policy(experiment, progress, k) if is_last or is_due else {}
        iteration_row: Row = {}
        if not is_last:
            progress.state, iteration_row = algorithm.iterate(experiment, progress.state, k)
            iteration_row["env_steps"] = experiment.take_step_count()
            steps += iteration_row["env_steps"]
        row = {"wall_s": progress.seconds_spent, **evaluation, **iteration_row}
        progress.seconds_spent += time.monotonic() - started
        progress.rows.append(row)
        if report is not None:
            report(k, row)
        if not is_last and checkpoint.due():
            checkpoint.save_state(CHECKPOINT_KEY, **_checkpoint_arrays(experiment, progress))
        if is_last:
            break
    return _training_dataset(experiment, progress)


def read_checkpoint(arrays: dict[str, np.ndarray]) -> tuple[int, dict[str, Any]]:
    """Return the number of rows in a checkpoint's arrays, and the settings of its experiment."""
    return len(arrays[f"{CURVE_PREFIX}wall_s"]), json.loads(str(arrays[SETTINGS_KEY]))


def _begin(experiment: Experiment) -> _Progress:
    experiment.take_step_count()
    return _Progress(experiment.algorithm.begin(experiment))


def _evaluate_policy(experiment: Experiment, progress: _Progress, k: int) -> Row:
    """Evaluate the policy on the same episodes in each iteration, and store it in ``progress`` if it is the best."""
    trained = experiment.algorithm.policy(experiment, progress.state)
    evaluation = evaluate(experiment, trained, EXACT, experiment.episodes)
    row = {f"evaluation_{name}": value for name, value in evaluation.summary().items()}
    best_return, normaliser = progress.best.get("return"), trained.normaliser
    if best_return is None or row["evaluation_return"] > float(best_return):
        progress.best = {
            "return": np.array(row["evaluation_return"]),
            "iteration": np.array(k),
            "theta": trained.theta,
            "mean": normaliser.mean,
            "scale": normaliser.scale,
        }
    return row


def _checkpoint_arrays(experiment: Experiment, progress: _Progress) -> dict[str, Any]:
    """Return a training's progress and settings as the arrays that a checkpoint stores."""
    return {
        **with_prefix(STATE_PREFIX, progress.state),
        **with_prefix(BEST_PREFIX, progress.best),
        **with_prefix(CURVE_PREFIX, _curves(progress.rows)),
        "spent": np.array(progress.seconds_spent),
        SETTINGS_KEY: np.array(json.dumps(to_json(experiment.settings()), sort_keys=True)),
    }


def _resume(experiment: Experiment, checkpoint: SavedWork) -> _Progress | None:
    arrays = checkpoint.state(CHECKPOINT_KEY)
    if arrays is None:
        return None
    _check_same_settings(json.loads(str(arrays[SETTINGS_KEY])), to_json(experiment.settings()))
    curves = without_prefix(CURVE_PREFIX, arrays)
    rows = [
        {name: float(values[i]) for name, values in curves.items() if not np.isnan(values[i])}
        for i in range(len(curves["wall_s"]))
    ]
    if experiment.budget is None and len(rows) > experiment.iterations:
        raise InputError(
            f"the run to resume has {len(rows)} iterations already, more than the"
            f" {experiment.iterations} requested; request more"
        )
    return _Progress(
        without_prefix(STATE_PREFIX, arrays), rows, without_prefix(BEST_PREFIX, arrays), float(arrays["spent"])
    )


def _check_same_settings(stored: dict[str, Any], requested: dict[str, Any]) -> None:
    different = [n for n in {**stored, **requested} if stored.get(n) != requested.get(n)]
    if different:
        differences = ", ".join(f"{n} = {stored.get(n)} not {requested.get(n)}" for n in different)
        raise InputError(f"the run to resume has other settings: {differences}; give the same, or start a new run")


def _curves(rows: list[Row]) -> dict[str, np.ndarray]:
    names = dict.fromkeys(name for row in rows for name in row)
    return {name: np.array([row.get(name, np.nan) for row in rows]) for name in names}


def _training_dataset(experiment: Experiment, progress: _Progress) -> xr.Dataset:
    import xarray as xr

    curves = _curves(progress.rows)
    steps = np.nan_to_num(curves["env_steps"])
    curves["env_steps"] = np.concatenate([[0.0], np.cumsum(steps)[:-1]])
    trained = experiment.algorithm.policy(experiment, progress.state)
    best_policy = progress.best
    return xr.Dataset(
        {
            **{name: ("iteration", values) for name, values in curves.items()},
            "theta": ("parameter", best_policy["theta"]),
            "theta_last": ("parameter", trained.theta),
            "mean": ("observation", best_policy["mean"]),
            "scale": ("observation", best_policy["scale"]),
            "psi": ("physical", progress.state.get("psi", experiment.physics)),
            "best_iteration": ((), int(best_policy["iteration"])),
        },
        coords={
            "iteration": np.arange(len(progress.rows)),
            "observation": [signal.name for signal in experiment.task.observations],
            "physical": [parameter.name for parameter in experiment.task.parameters],
        },
        attrs=to_json(experiment.settings()),
    )


BYTES_PER_ROW = 1e3
"""Estimated memory of one iteration's row in the learning curves [bytes]."""
ARRAY_COPIES = 4
"""Estimated number of copies of an array in memory during a training."""
EPISODE_COUNTS = ("samples", "n_envs", "directions")
"""Names of algorithms' settings that are numbers of episodes."""
STEP_COUNTS = ("capacity", "random_steps", "batch", "model_batch", "rows", "candidates")
"""Names of algorithms' settings that are numbers of steps."""


def check_training(experiment: Experiment, side_by_side: int) -> None:
    """Raise :class:`~ocp.errors.InputError` if ``side_by_side`` trainings at once need too much memory.

    The estimated memory of a training is that of its stored states and inputs, weights, and learning curves.
    """
    task, counts = experiment.task, _integer_settings(experiment)
    system = task.system
    steps = experiment.episodes * task.horizon + sum(counts.get(name, 0.0) for name in STEP_COUNTS)
    length = counts.get("unroll", counts.get("steps", float(task.horizon)))
    steps += sum(counts.get(name, 0.0) for name in EPISODE_COUNTS) * length
    steps += counts.get("branches", 0.0) * counts.get("max_branch", 0.0) * counts.get("branch_iterations", 1.0)
    numbers = steps * (2 * system.nx + system.nu + len(task.observations) + 1)
    weights = experiment.policy.n_theta * (ARRAY_COPIES + counts.get("directions", 0.0))
    for units, layers in (("model_units", "model_layers"), ("critic_units", "critic_layers")):
        network = counts.get(units, 0.0) ** 2 * counts.get(layers, 0.0)
        weights += ARRAY_COPIES * network * counts.get("members", 1.0)
    weights += ARRAY_COPIES * counts.get("critic", 0.0) ** 2
    bytes_per_training = 8.0 * (ARRAY_COPIES * numbers + weights) + BYTES_PER_ROW * experiment.iterations
    check_memory(f"training {task.name} by {experiment.algorithm.name}", bytes_per_training * side_by_side)


def _integer_settings(experiment: Experiment) -> dict[str, float]:
    """Return a mapping from names to the algorithm's integer settings, including those of a wrapped algorithm."""
    counts: dict[str, float] = {}
    settings: dict[str, Any] = experiment.algorithm.settings()
    for name, value in settings.items():
        if isinstance(value, int) and not isinstance(value, bool):
            short_name = name.removeprefix("of.").removeprefix("search.")
            counts[short_name] = counts.get(short_name, 0.0) + float(value)
    return counts
