"""What a training would take of memory and time, from its settings."""

from __future__ import annotations

from typing import Any

from ocp.effort import check_memory, check_time
from ocp.learning.experiment import Experiment

_STEPS = 1e5
"""Simulated steps a second with their derivatives, about: those of the slowest task, so that a
training is never said to take longer than a year where it would not by far."""
_ROW = 1e3
"""Bytes of what one iteration tells."""
_COPIES = 4
_OF_EPISODES = ("samples", "walkers", "directions")
_OF_STEPS = ("capacity", "explored", "batch", "model_batch", "rows", "candidates")
_UPDATES = ("updates", "model_steps", "searched")


def training_memory(experiment: Experiment) -> float:
    """Bytes: states and inputs of all steps that are held at once, weights, and the curves."""
    task, own = experiment.task, _counts(experiment)
    system = task.system
    steps = experiment.episodes * task.horizon + sum(own.get(name, 0.0) for name in _OF_STEPS)
    steps += _unrolled(experiment, own)
    steps += own.get("branches", 0.0) * own.get("longest", 0.0) * own.get("kept", 1.0)
    numbers = steps * (2 * system.nx + system.nu + len(task.observations) + 1)
    weights = experiment.policy.n_theta * (_COPIES + own.get("directions", 0.0))
    for units, layers in (("model_units", "model_layers"), ("critic_units", "critic_layers")):
        network = own.get(units, 0.0) ** 2 * own.get(layers, 0.0)
        weights += _COPIES * network * own.get("members", 1.0)
    weights += _COPIES * own.get("critic", 0.0) ** 2
    return 8.0 * (_COPIES * numbers + weights) + _ROW * experiment.iterations


def training_seconds(experiment: Experiment) -> float:
    """Seconds: simulated steps, and those of networks, of all iterations and judgements."""
    own, horizon = _counts(experiment), experiment.task.horizon
    judged = experiment.episodes * horizon / experiment.evaluate_every
    updates = sum(own.get(name, 0.0) for name in _UPDATES)
    batch = max(own.get("batch", 1.0), own.get("model_batch", 1.0), own.get("rows", 1.0))
    steps = _unrolled(experiment, own) + judged + updates * batch
    return experiment.iterations * steps / _STEPS


def check_training(experiment: Experiment, side_by_side: int = 1, all_of_them: int = 1) -> float:
    """Seconds that ``all_of_them`` take, so many at a time.

    Raises :class:`~ocp.errors.InputError` for more memory than there is, and for more than a year.
    """
    seconds = training_seconds(experiment) * all_of_them / side_by_side
    what = f"training {experiment.task.name} by {experiment.algorithm.name}"
    check_memory(what, training_memory(experiment) * side_by_side)
    check_time(what, seconds)
    return seconds


def _unrolled(experiment: Experiment, own: dict[str, float]) -> float:
    """Steps that are simulated in an iteration."""
    length = own.get("unroll", own.get("steps", float(experiment.task.horizon)))
    return sum(own.get(name, 0.0) for name in _OF_EPISODES) * length


def _counts(experiment: Experiment) -> dict[str, float]:
    """Whole-number settings of the algorithm, and of the one that it stands around."""
    found: dict[str, float] = {}
    settings: dict[str, Any] = experiment.algorithm.settings()
    for name, value in settings.items():
        if isinstance(value, int) and not isinstance(value, bool):
            short = name.removeprefix("of.").removeprefix("search.")
            found[short] = found.get(short, 0.0) + float(value)
    return found
