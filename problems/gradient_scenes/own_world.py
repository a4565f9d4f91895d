"""Simulators in users' files: ``rollout(theta)`` in NumPy, JAX or torch, and optionally gradient and exact output."""

from __future__ import annotations

import inspect
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from dynamics.systems import Signal, signals
from ocp.errors import InputError
from ocp.gradients.worlds.report import Question
from ocp.gradients.worlds.world import World
from ocp.validation import Number, Positive, expand_path, validated
from problems.loading import check_file, import_file
from problems.source_digest import source_digest
from problems.user_code import guarded


@dataclass(frozen=True)
class OwnWorld:
    """Simulator of a user's file, and the derivative to be judged, which is None if the file defines no ``theta``.

    ``digest`` identifies the content of the file and of what it imports.
    """

    world: World
    question: Question | None
    digest: str


def load_own_world(path: str | Path, parameter: int = 0, output: int = 0) -> OwnWorld:
    """Read a simulator from a Python file.

    The file defines ``rollout(theta)``, from parameters (n, d) to outputs (n, m); keyword arguments with numbers as
    defaults, such as ``h=0.01``, are settings. It may define

    - ``gradient(theta)``, from (n, d) to (n, m, d),
    - ``theta``, the nominal parameters (d,), and ``size``, their characteristic sizes, by default absolute values,
    - ``truth(theta)``, the exact outputs (n, m), or ``slope`` (m, d), their derivatives at theta,
    - ``sharper``, a mapping from settings to the factor of one refinement, such as ``{"h": 0.5}``,
    - ``longer``, the same for one extension of the horizon, such as ``{"steps": 2}``,
    - ``parameters`` and ``outputs``, names with units, such as ``"v [m/s] speed; m [kg]"``.

    Raises :class:`~ocp.errors.InputError` if there is no such file, if it raises, and for a wrong type or shape.
    """
    file = expand_path(path).resolve()
    check_file(file)
    module = import_file(file)
    if not callable(getattr(module, "rollout", None)):
        raise InputError(f"{file}: the file must define rollout(theta), from parameters (n, d) to outputs (n, m)")
    missing = [a.name for a in [*inspect.signature(module.rollout).parameters.values()][1:] if a.default is a.empty]
    if missing:
        raise InputError(f"{file}: argument {missing[0]} of rollout has no default; write a number, as in h=0.01")
    settings = {
        name: validated(f"{file}: the default of argument {name} of rollout", argument.default, Number)
        for name, argument in [*inspect.signature(module.rollout).parameters.items()][1:]
    }
    sharper, longer = (_changes(module, name, settings, file) for name in ("sharper", "longer"))
    gradient = _gradient(module, file) if hasattr(module, "gradient") else None
    simulate = guarded(module.rollout, "rollout(theta)", file)
    world = World(file.stem, simulate, gradient, settings, sharper, longer, method="gradient(theta)")
    question = _question(module, file, parameter, output) if hasattr(module, "theta") else None
    return OwnWorld(world, question, source_digest(file))


def _changes(module: ModuleType, name: str, settings: dict[str, float], file: Path) -> dict[str, float]:
    """Return a mapping from settings to factors that a file defines, by default an empty one."""
    factors = validated(f"{file}: {name}", getattr(module, name, {}), dict[str, Positive])
    if unknown := sorted(factors.keys() - settings.keys()):
        listed = ", ".join(settings) or "none"
        raise InputError(f"{file}: {name} names {unknown[0]!r}; settings of rollout: {listed}")
    return factors


def _gradient(module: ModuleType, file: Path) -> Any:
    """Return ``gradient`` as a function that takes all settings and passes on those that it declares."""
    call, declared = guarded(module.gradient, "gradient(theta)", file), inspect.signature(module.gradient).parameters
    return lambda theta, **settings: call(theta, **{name: settings[name] for name in settings if name in declared})


def _question(module: ModuleType, file: Path, parameter: int, output: int) -> Question:
    """Return the derivative to be judged, of an output by a parameter, with the exact output of the file, if any."""
    theta = _array(module, "theta", file)
    if parameter >= len(theta):
        raise InputError(f"{file}: theta has {len(theta)} parameters, got {parameter} as the index of the parameter")
    sizes = _array(module, "size", file) if hasattr(module, "size") else np.abs(theta)
    if sizes.shape != theta.shape or not sizes[parameter] > 0:
        raise InputError(
            f"{file}: parameter {parameter} of theta needs a size > 0; define size with one number for each parameter"
        )
    named = _signal(module, "parameters", parameter, file), _signal(module, "outputs", output, file)
    return Question(theta, float(sizes[parameter]), _truth(module, theta, file), parameter, output, named)


def _array(module: ModuleType, name: str, file: Path) -> np.ndarray:
    """Return the finite numbers that a file defines under a name, as an array (d,); a single number gives d = 1."""
    value = getattr(module, name)
    value = np.asarray(value).tolist() if hasattr(value, "shape") else value
    return np.atleast_1d(np.array(validated(f"{file}: {name}", value, list[Number] | Number), dtype=float))


def _signal(module: ModuleType, name: str, index: int, file: Path) -> Signal:
    """Return the signal at an index of a definition such as ``"v [m/s]; m [kg]"``, by default ``parameters[index]``."""
    definition = getattr(module, name, None)
    try:
        return Signal(f"{name}[{index}]", "1") if definition is None else signals(definition)[index]
    except (ValueError, IndexError) as error:
        raise InputError(f"{file}: {definition!r} does not name entry {index}; write 'v [m/s]; m [kg]'") from error


def _truth(module: ModuleType, theta: np.ndarray, file: Path) -> World | None:
    """Return the exact output in a file: ``truth(theta)``, or a linear function with the derivative ``slope``."""
    if callable(getattr(module, "truth", None)):
        return World("truth", guarded(module.truth, "truth(theta)", file))
    if not hasattr(module, "slope"):
        return None
    d = len(theta)
    try:
        slope = np.asarray(module.slope, dtype=float)
        # Without two dimensions it is the slope of one output, or by one parameter.
        slope = slope if slope.ndim > 1 else slope.reshape(-1, d)
    except (TypeError, ValueError) as error:
        raise InputError(f"{file}: slope must be numbers (m, {d}), got {module.slope!r}") from error
    if slope.ndim != 2 or slope.shape[1] != d or not np.isfinite(slope).all():
        raise InputError(f"{file}: slope must be finite numbers (m, {d}), got {slope.tolist()}")
    return World("slope", lambda rows: (rows - theta) @ slope.T, lambda rows: np.tile(slope, (len(rows), 1, 1)))
