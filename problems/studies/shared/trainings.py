"""Trainings of a study, done side by side, each kept as a piece."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from dynamics.contact import ContactLaw
from ocp.errors import choose
from ocp.learning.algorithms import ALGORITHMS
from ocp.scheduling import Failure, Function, Tell, carried_out
from problems.studies.study import Pieces
from problems.tasks import registry
from problems.tasks.training import TrainingJob, trained
from problems.tasks.usual import made, usual

Curves = dict[str, np.ndarray]


def job(task: str, algorithm: str, law: ContactLaw, seed: int, **changed: Any) -> TrainingJob:
    """A training at the settings that are usual for the task, but for those ``changed``."""
    cls = choose("algorithm", algorithm, ALGORITHMS)
    values = {**usual(registry.spec(task), algorithm, cls), **changed}
    chosen, options = made(cls, values)
    return TrainingJob(
        task=task, params={}, algorithm=chosen, law=law, seed=seed, options=options, threads=1
    )


def curves(jobs: Mapping[str, TrainingJob], pieces: Pieces) -> dict[str, Curves]:
    """Every array of every training, by the key of its job; see :func:`side_by_side`.

    Results do not depend on how many processes there are, but for ``wall_s``.
    """
    return side_by_side(trained_curves, jobs, pieces)


def trained_curves(job: TrainingJob, tell: Tell) -> Curves:
    """Do a training; a :data:`~ocp.scheduling.Function`."""
    data = trained(job, tell)
    return {str(name): data[name].values for name in data.data_vars}


def side_by_side(function: Function, jobs: Mapping[str, Any], pieces: Pieces) -> dict[str, Curves]:
    """What ``function`` gives for every job, arrays by name, by the key of the job.

    Those that were kept are not redone; the others are done in as many processes as there are
    CPUs. Raises what a job raised.
    """
    found = {key: pieces.kept(key) for key in jobs}
    left = [key for key, arrays in found.items() if arrays is None]
    workers = min(len(os.sched_getaffinity(0)), max(1, len(left)))
    for place, outcome in carried_out(function, [jobs[key] for key in left], workers):
        if isinstance(outcome, Failure):
            raise outcome.error
        found[left[place]] = pieces.keep(left[place], outcome)
    return {key: arrays for key, arrays in found.items() if arrays is not None}


def at(grid: np.ndarray, along: np.ndarray, values: np.ndarray) -> np.ndarray:
    """``values`` over ``along``, where they are told, at the points of ``grid`` (n,).

    Linear from one judgement to the next; before the first and after the last there is none.
    """
    told = np.isfinite(values) & np.isfinite(along)
    return np.interp(grid, along[told], values[told], left=np.nan, right=np.nan)
