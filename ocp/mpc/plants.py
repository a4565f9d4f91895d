"""Plants of closed-loop simulations: the controller's model, a more exact model, or a changed model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from dynamics.batch import StepFunction
from dynamics.systems.planar.machine import with_implicit_forces
from ocp.errors import InputError, choose, did_you_mean
from ocp.judge.referee import REFINEMENT
from ocp.judge.step_size import step_size_kind
from ocp.mpc.phase import numbers
from ocp.problem.checks import check_physics
from ocp.problem.problem import Problem
from ocp.simulators.mujoco_world import MujocoWorld
from ocp.validation import Index, Number, validated

PLANTS = {
    "exact": "the exact law at the model's step size",
    "referee": "the most exact contact model of the system",
    "h/4": "the most exact contact model at a quarter of the step size, the input held",
    "noise": "the exact law, with noise of 1 % of the characteristic sizes where none is given",
    "mujoco": "MuJoCo with its soft contact, at steps of a millisecond, the input held",
}
"""Mapping from names of plants to their descriptions."""


@dataclass(frozen=True)
class Disturbance:
    """Differences between the plant and the controller's model.

    ``noise_state`` and ``noise_input`` are standard deviations of the noise on the measured state and on the
    applied input, in the signals' units: one number for all signals, or a mapping from names. ``mismatch`` maps
    names of parameters to their values in the plant. If ``delay``, each input is applied one sample late.
    ``pushes`` maps numbers of samples to changes (nx,) of the state.
    """

    noise_state: float | Mapping[str, float] = 0.0
    noise_input: float | Mapping[str, float] = 0.0
    mismatch: Mapping[str, float] = field(default_factory=dict)
    delay: bool = False
    pushes: Mapping[int, np.ndarray] = field(default_factory=dict)


class Plant:
    """Simulated plant, which is advanced from sample to sample and may have other parameters than the model.

    Velocity-dependent forces of a planar machine are integrated implicitly, so that they gain no
    energy (:func:`~dynamics.systems.planar.machine.with_implicit_forces`). There are ``samples_per_step`` samples
    per step of the problem, whose step size must be a parameter unless this is 1.

    Raises :class:`~ocp.errors.InputError` for an unknown plant or parameter, and for ``h/4`` if the step size
    is not a parameter, and the errors of :class:`~ocp.simulators.mujoco_world.MujocoWorld`.
    """

    def __init__(self, problem: Problem, name: str, mismatch: Mapping[str, float], samples_per_step: int = 1) -> None:
        choose("plant", name, PLANTS)
        names = problem.parameters.names
        mismatch = check_mismatch(problem, mismatch)
        system = with_implicit_forces(problem.system)
        if system is not problem.system:
            problem = replace(problem, system=system)
        self.problem, self.substeps = problem, 1
        values = dict(zip(names, problem.parameters.values, strict=True)) | dict(mismatch)
        step_size = step_size_kind(problem.system)
        if samples_per_step > 1:
            values[step_size.parameter] /= samples_per_step
        self._mujoco = MujocoWorld(problem, values) if name == "mujoco" else None
        step = problem.referee_step if name in ("referee", "h/4") else problem.exact_step
        if name == "h/4":
            if step_size.kind != "parameter":
                raise InputError(f"plant h/4: {step_size.reason or 'the step size is a state'}; take referee")
            values[step_size.parameter] /= REFINEMENT
            self.substeps = REFINEMENT
        self._step, self._solve = StepFunction(step, threads=1), step.solve
        self._p = step.p.pack({name: values[name] for name in step.p.names if name in values})
        is_referee_model = step is not problem.exact_step
        self.lam = slice(0, 0 if is_referee_model else problem.system.nlam)

    def step(self, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the state (nx,) one sample later, and the sample's impulses (nlam,), NaN unless the law is exact."""
        total = np.zeros(self.problem.system.nlam)
        if self._mujoco is not None:
            return self._mujoco.step(x, u), total * np.nan
        for _ in range(self.substeps):
            batch_step = self._step(x[None], u[None], self._p)
            x_next, lam = batch_step.x_next[0], batch_step.lam[0, self.lam]
            if not np.isfinite(x_next).all():  # The solver of single steps tries more starts.
                x_next, lam = (np.array(v).ravel() for v in self._solve(x, u, self._p)[:2])
                lam = lam[self.lam]
            x = x_next
            total = total + lam if lam.size else np.full_like(total, np.nan)
        return x, total


def check_mismatch(problem: Problem, mismatch: Mapping[str, float]) -> Mapping[str, float]:
    """Return ``mismatch``, the parameter values of the plant, as validated numbers.

    Raises :class:`~ocp.errors.InputError` for a name that is not a parameter of the problem, and for
    values that are not finite or physically impossible.
    """
    mismatch = validated("mismatch", mismatch, Mapping[str, Number])
    names = problem.parameters.names
    _check_names(f"mismatch: {problem.name} has no physical parameter", mismatch, names)
    if mismatch:
        check_physics(problem, problem.parameters.defaults | dict(mismatch))
    return mismatch


def _check_names(refusal: str, values: Mapping[str, float], names: list[str]) -> None:
    for name in values:
        if name not in names:
            raise InputError(f"{refusal} {name!r}{did_you_mean(name, names)}; there are {', '.join(names)}")


def check_pushes(problem: Problem, pushes: Mapping[int, np.ndarray], steps: int) -> None:
    """Raise :class:`~ocp.errors.InputError` for a push after the last sample or with a shape other than (nx,)."""
    for k, change in validated("pushes", pushes, Mapping[Index, Any]).items():
        if k >= steps:
            raise InputError(f"pushes: the sample must be from 0 to {steps - 1}, got {k}")
        numbers(f"pushes[{k}]", change, (problem.system.nx,), finite=True)


def deviations(values: float | Mapping[str, float], names: list[str], label: str) -> np.ndarray:
    """Return the standard deviations of all signals, from one number or from a mapping (0 for absent names).

    Raises :class:`~ocp.errors.InputError` for an unknown name and a negative or non-finite number.
    """
    values = validated(label, values, Number | Mapping[str, Number])
    if isinstance(values, Mapping):
        _check_names(f"{label}: unknown signal", values, names)
        standard_deviations = np.array([float(values.get(name, 0.0)) for name in names])
    else:
        standard_deviations = np.full(len(names), float(values))
    if not (np.isfinite(standard_deviations).all() and (standard_deviations >= 0).all()):
        raise InputError(f"{label} must be 0 or more and finite, got {values}")
    return standard_deviations
