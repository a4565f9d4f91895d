"""Memory that a training needs, from its settings."""

from __future__ import annotations

from typing import Any

from ocp.effort import check_memory
from ocp.learning.experiment import Experiment

_ROW = 1e3
"""Bytes of what one iteration tells."""
_COPIES = 4
_OF_EPISODES = ("samples", "walkers", "directions")
_OF_STEPS = ("capacity", "explored", "batch", "model_batch", "rows", "candidates")


def training_memory(experiment: Experiment) -> float:
    """Bytes: states and inputs of all steps that are held at once, weights, and the curves."""
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
    return 8.0 * (_COPIES * numbers + weights) + _ROW * experiment.iterations


def check_training(experiment: Experiment, side_by_side: int) -> None:
    """Raise :class:`~ocp.errors.InputError` where so many at once need too much memory."""
    what = f"training {experiment.task.name} by {experiment.algorithm.name}"
    check_memory(what, training_memory(experiment) * side_by_side)


def _counts(experiment: Experiment) -> dict[str, float]:
    """Whole-number settings of the algorithm, and of the one that it stands around."""
    found: dict[str, float] = {}
    settings: dict[str, Any] = experiment.algorithm.settings()
    for name, value in settings.items():
        if isinstance(value, int) and not isinstance(value, bool):
            short = name.removeprefix("of.").removeprefix("search.")
            found[short] = found.get(short, 0.0) + float(value)
    return found
