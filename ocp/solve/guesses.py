"""Conversion of a user's guess to states and inputs of a problem."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from ocp.errors import InputError
from ocp.problem.checks import check_guess
from ocp.problem.evaluation import Evaluation
from ocp.problem.problem import Problem
from ocp.problem.sketch import Pose, Sketch, UserGuess
from ocp.solution import Solution
from ocp.solve.warm_start import carried_guess

if TYPE_CHECKING:
    import xarray as xr

GuessLike: TypeAlias = "Solution | xr.Dataset | tuple[ArrayLike, ArrayLike] | Sketch | Mapping[int, Pose]"
"""A solution (or loaded run), a dataset with x and u, a pair of states and inputs, a sketch, or its keyframes."""


def user_guess_of(guess: GuessLike, problem: Problem, values: dict[str, float]) -> UserGuess:
    """Return a user's guess as states (N+1, nx) and inputs (N, nu); of several scenarios the first is used.

    A run of another problem gives the states and inputs with the same names (:func:`shared_guess`).

    Raises :class:`~ocp.errors.InputError` for other shapes, values that are not finite, and a sketch that does not fit.
    """
    import xarray as xr

    if isinstance(guess, Mapping) and not isinstance(guess, xr.Dataset):
        guess = Sketch(keyframes=guess)
    if isinstance(guess, Sketch):
        return guess.drawn(Evaluation(problem, values))
    if isinstance(guess, Solution):
        if _names(guess.data) == _signal_names(problem):
            return UserGuess(carried_guess(guess, problem, values))
        guess = guess.data
    if isinstance(guess, xr.Dataset):
        if missing := {"x", "u"} - set(guess):
            raise InputError(f"the guess has no {' and no '.join(sorted(missing))}; it needs both")
        x, u = guess["x"].values, guess["u"].values
        has_same_shape = x.shape[-2:] == (problem.N + 1, problem.system.nx) and _names(guess) == _signal_names(problem)
        if "time" in guess.coords and {"state", "control"} <= set(guess.coords) and not has_same_shape:
            return UserGuess(check_guess(problem, shared_guess(guess, Evaluation(problem, values))))
        guess = (x[0], u[0]) if x.ndim == 3 else (x, u)
    return UserGuess(check_guess(problem, guess))


def shared_guess(run: xr.Dataset, evaluation: Evaluation) -> tuple[np.ndarray, np.ndarray]:
    """Return the problem's guess, with states and inputs of the same names replaced by a resampled run's.

    The last values are held after the end of the run. Raises :class:`~ocp.errors.InputError` if no name is shared.
    """
    X, U = (np.array(trajectory, dtype=float) for trajectory in evaluation.initial_guess)
    new_times, old_times = evaluation.node_times(), run["time"].values
    own_names, run_names = _signal_names(evaluation.problem), _names(run)
    if not any(set(names) & set(run_signals) for names, run_signals in zip(own_names, run_names, strict=True)):
        theirs, ours = (", ".join([*states, *inputs]) for states, inputs in (run_names, own_names))
        raise InputError(f"the guess has {theirs}, and {evaluation.problem.name} has {ours}: no name in common")
    for trajectory, key, names, run_signals in zip((X, U), "xu", own_names, run_names, strict=True):
        run_values = run[key].values.reshape(-1, *run[key].shape[-2:])[0]
        for index, name in enumerate(names):
            if name in run_signals:
                signal = run_values[:, run_signals.index(name)]
                trajectory[:, index] = np.interp(new_times[: len(trajectory)], old_times[: len(signal)], signal)
    return X, U


def _names(run: xr.Dataset) -> list[list[str]]:
    """Return the names of a run's states and of its inputs; a list is empty if the run has none."""
    return [[str(name) for name in run[axis].values] if axis in run.coords else [] for axis in ("state", "control")]


def _signal_names(problem: Problem) -> list[list[str]]:
    return [[signal.name for signal in signals] for signals in (problem.system.states, problem.system.inputs)]
