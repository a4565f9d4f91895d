"""Worlds of users' files: a function ``rollout(theta)`` in NumPy, JAX or torch, and optionally what is known of it."""

from __future__ import annotations

import inspect
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from dynamics.systems import Signal, signals
from ocp.errors import InputError
from ocp.gradients.worlds.report import Question
from ocp.gradients.worlds.world import World
from ocp.validation import expand_path
from problems.loading import check_file, import_file
from problems.source_digest import source_digest
from problems.user_code import guarded


@dataclass(frozen=True)
class OwnWorld:
    """World of a user's file, and the question that the file asks, or None where it defines no ``theta``.

    ``digest`` identifies the content of the file and of what it imports.
    """

    world: World
    question: Question | None
    digest: str


def load_own_world(path: str | Path, parameter: int = 0, output: int = 0) -> OwnWorld:
    """Read a world from a Python file.

    The file defines ``rollout(theta)``, from parameters (n, d) to outputs (n, m); keyword arguments with numbers as
    defaults, such as ``h=0.01``, are settings. It may define

    - ``gradient(theta)``, from (n, d) to (n, m, d),
    - ``theta``, the nominal parameters (d,), and ``size``, the size of each if it is not its absolute value,
    - ``truth(theta)``, the outputs (n, m) of the physics, or ``slope`` (m, d), their derivatives at theta,
    - ``sharper``, a mapping from settings to the factor of one refinement, such as ``{"h": 0.5}``,
    - ``parameters`` and ``outputs``, names with units, such as ``"v [m/s] speed; m [kg]"``.

    Raises :class:`~ocp.errors.InputError` if there is no such file, if it raises, and for a wrong type or shape.
    """
    file = expand_path(path).resolve()
    check_file(file)
    module = import_file(file)
    if not callable(getattr(module, "rollout", None)):
        raise InputError(f"{file}: the file must define rollout(theta), from parameters (n, d) to outputs (n, m)")
    settings = _settings(module.rollout, file)
    gradient = getattr(module, "gradient", None)
    world = World(
        file.stem,
        guarded(module.rollout, "rollout(theta)", file),
        None if gradient is None else _with_known_settings(guarded(gradient, "gradient(theta)", file), gradient),
        settings,
        _sharper(getattr(module, "sharper", {}), settings, file),
        method="gradient(theta)",
    )
    question = _question(module, world, file, (parameter, output)) if hasattr(module, "theta") else None
    return OwnWorld(world, question, source_digest(file))


def _settings(rollout: Any, file: Path) -> dict[str, float]:
    """Return the keyword arguments of ``rollout`` after theta, with their defaults."""
    settings = {}
    for name, argument in [*inspect.signature(rollout).parameters.items()][1:]:
        default = argument.default
        if isinstance(default, bool) or not isinstance(default, int | float):
            raise InputError(
                f"{file}: argument {name} of rollout must have a number as its default, such as {name}=0.01"
            )
        settings[name] = float(default)
    return settings


def _with_known_settings(call: Any, gradient: Any) -> Any:
    """Return ``gradient`` as a function that takes all settings and passes on those that it declares."""
    declared = [*inspect.signature(gradient).parameters][1:]
    return lambda theta, **settings: call(theta, **{name: settings[name] for name in declared if name in settings})


def _sharper(factors: Any, settings: dict[str, float], file: Path) -> dict[str, float]:
    if not isinstance(factors, dict):
        raise InputError(f'{file}: sharper must be a dict from settings to factors, such as {{"h": 0.5}}')
    for name, factor in factors.items():
        if name not in settings:
            raise InputError(f"{file}: sharper names {name!r}; settings of rollout are {', '.join(settings) or 'none'}")
        if not (isinstance(factor, int | float) and factor > 0 and factor != 1):
            raise InputError(f"{file}: the factor of {name} in sharper must be a positive number other than 1")
    return {name: float(factor) for name, factor in factors.items()}


def _question(module: Any, world: World, file: Path, indices: tuple[int, int]) -> Question:
    """Return the derivative of the chosen output by the chosen parameter, with the truth that the file knows."""
    parameter, output = indices
    theta = _numbers(module.theta, "theta", file)
    if parameter >= len(theta):
        raise InputError(f"{file}: theta has {len(theta)} parameters, got {parameter} as the index of the parameter")
    sizes = _numbers(module.size, "size", file) if hasattr(module, "size") else np.abs(theta)
    if sizes.shape != theta.shape or not sizes[parameter] > 0:
        raise InputError(
            f"{file}: parameter {parameter} of theta needs a size > 0; define size with one number for each parameter"
        )
    return Question(
        theta,
        float(sizes[parameter]),
        _truth(module, theta, file),
        parameter,
        output,
        (
            _signal(getattr(module, "parameters", ""), parameter, "theta", file),
            _signal(getattr(module, "outputs", ""), output, "y", file),
        ),
    )


def _numbers(value: Any, name: str, file: Path) -> np.ndarray:
    try:
        numbers = np.atleast_1d(np.asarray(value, dtype=float))
    except (TypeError, ValueError):
        numbers = np.empty((0, 0))
    if numbers.ndim != 1 or not numbers.size or not np.isfinite(numbers).all():
        raise InputError(f"{file}: {name} must be a number or a list of finite numbers, got {value!r}")
    return numbers


def _signal(definition: Any, index: int, name: str, file: Path) -> Signal:
    """Return the signal at an index of a definition such as ``"v [m/s]; m [kg]"``, by default ``name[index]``."""
    if not definition:
        return Signal(f"{name}[{index}]", "1")
    try:
        return signals(definition)[index]
    except (ValueError, IndexError, AttributeError) as error:
        raise InputError(f"{file}: {definition!r} does not name entry {index}; write 'v [m/s]; m [kg]'") from error


def _truth(module: Any, theta: np.ndarray, file: Path) -> World | None:
    """Return the physics that the file knows: ``truth(theta)``, or the plane with the derivative ``slope``."""
    if callable(getattr(module, "truth", None)):
        return World("truth", guarded(module.truth, "truth(theta)", file))
    if not hasattr(module, "slope"):
        return None
    try:
        slope = np.asarray(module.slope, dtype=float).reshape(-1, len(theta))
    except (TypeError, ValueError) as error:
        raise InputError(f"{file}: slope must be numbers (m, {len(theta)}), got {module.slope!r}") from error
    return World("slope", partial(_plane, slope, theta), lambda rows: np.tile(slope, (len(rows), 1, 1)))


def _plane(slope: np.ndarray, theta: np.ndarray, rows: np.ndarray) -> np.ndarray:
    return (rows - theta) @ slope.T
