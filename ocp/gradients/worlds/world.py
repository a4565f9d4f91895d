"""Simulators, called worlds, as functions from parameters to outputs, with gradients if they have any."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from dynamics.batch import Gaussian
from dynamics.systems import Signal
from ocp.errors import InputError
from ocp.gradients.objective import CostSamples, SampledObjective

Simulation = Callable[..., Any]
"""Function ``(theta, **settings)`` of parameters (n, d) that returns outputs (n, m), or their gradients (n, m, d)."""
ROW_TOLERANCE = 1e-6
"""Largest difference between one row simulated alone and among others, as a share of the largest output."""


@dataclass(frozen=True)
class World:
    """Simulator that maps parameters theta (n, d) to outputs (n, m), each row independently of the others.

    ``simulate(theta, **settings)`` returns the outputs, and ``differentiate(theta, **settings)`` their gradients
    (n, m, d); it is None for a simulator without derivatives. ``settings`` are numbers such as the step size.
    ``sharper`` maps settings to the factors by which they change when the simulator is refined once, such as
    ``{"h": 0.5, "stiffness": 4.0}``, and ``longer`` those that extend its horizon to the factors of one extension, such
    as ``{"steps": 2.0}``. ``method`` says how the gradient is computed, and ``versions`` are those of
    the packages that simulate. ``samples_gradient`` is false where gradients are too slow to be sampled.
    ``compile(note, **settings)`` compiles a simulator, which may take minutes; it is None where nothing is compiled.
    ``note`` is called with texts on the progress.
    """

    name: str
    simulate: Simulation
    differentiate: Simulation | None = None
    settings: Mapping[str, float] = field(default_factory=dict)
    sharper: Mapping[str, float] = field(default_factory=dict)
    longer: Mapping[str, float] = field(default_factory=dict)
    method: str = "AD"
    versions: Mapping[str, str] = field(default_factory=dict)
    samples_gradient: bool = True
    compile: Callable[..., None] | None = None
    note: Callable[[str], None] = lambda text: None

    def rollout(self, theta: np.ndarray) -> np.ndarray:
        """Return the outputs (n, m) at theta (n, d).

        Raises :class:`~ocp.errors.InputError` if the simulator returns another shape or changes its argument.
        """
        outputs = self._call(self.simulate, "rollout(theta)", theta)
        if outputs.ndim != 2 or len(outputs) != len(theta) or outputs.shape[1] == 0:
            raise InputError(
                f"{self.name}: rollout(theta) returned the shape {outputs.shape} for theta of shape {theta.shape};"
                f" expected ({len(theta)}, m), one row of m outputs for each row of theta"
            )
        return outputs

    def gradient(self, theta: np.ndarray) -> np.ndarray:
        """Return the gradients (n, m, d) of the outputs at theta (n, d); raises the errors of :meth:`rollout`."""
        if self.differentiate is None:
            raise InputError(f"{self.name} has no gradient; use differences of its rollouts")
        gradients = self._call(self.differentiate, "gradient(theta)", theta)
        n, d = theta.shape
        if gradients.ndim != 3 or gradients.shape[::2] != (n, d):
            raise InputError(
                f"{self.name}: gradient(theta) returned the shape {gradients.shape} for theta of shape {theta.shape};"
                f" expected ({n}, m, {d}), the derivative of each of the m outputs by each parameter"
            )
        return gradients

    def prepare(self) -> None:
        """Compile the simulator at its settings, unless it is compiled."""
        if self.compile is not None:
            self.compile(self.note, **self.settings)

    def at(self, settings: Mapping[str, float]) -> World:
        """Return the simulator with changed values of its settings; raise InputError for an unknown setting."""
        for name in settings:
            if name not in self.settings:
                listed = ", ".join(self.settings) or "none"
                raise InputError(f"{self.name} has no setting {name!r}; its settings: {listed}")
        return replace(self, settings={**self.settings, **settings})

    def _call(self, function: Simulation, call: str, theta: np.ndarray) -> np.ndarray:
        argument = np.array(theta, dtype=float)
        try:
            values = np.asarray(function(argument, **self.settings), dtype=float)
        except InputError:
            raise
        except (TypeError, ValueError) as error:
            raise InputError(f"{self.name}: {call} did not return an array of numbers: {error}") from error
        if not np.array_equal(argument, theta, equal_nan=True):
            raise InputError(f"{self.name}: {call} changes its argument theta; work on a copy, theta.copy()")
        return values


def check_world(world: World, theta: np.ndarray) -> tuple[int, int]:
    """Simulate near ``theta`` (d,) in two calls, and return the number of outputs and the number of non-finite rows.

    Raises :class:`~ocp.errors.InputError` for a wrong shape, for results that differ between two calls with the same
    argument, for outputs of which none is finite at ``theta``, and for rows that depend on other rows.
    """
    world.prepare()
    rows = theta + 1e-3 * np.maximum(np.abs(theta), 1e-3) * np.arange(-1, 3)[:, None]
    first, second = world.rollout(rows), world.rollout(rows)
    if not np.array_equal(first, second, equal_nan=True):
        raise InputError(
            f"{world.name}: rollout(theta) returned other values in a second call with the same theta;"
            " seed its random numbers inside rollout"
        )
    if not np.isfinite(first[1]).any():
        raise InputError(
            f"{world.name}: rollout(theta) returned {first[1, 0]:g} at the nominal parameters; expected a finite number"
        )
    alone, scale = world.rollout(rows[1:2]), np.nanmax(np.abs(first), initial=0.0)
    if not np.allclose(alone, first[1:2], rtol=0, atol=ROW_TOLERANCE * scale, equal_nan=True):
        raise InputError(
            f"{world.name}: the outputs of one row of theta depend on the other rows; simulate every row by itself"
        )
    if world.differentiate is not None and (m := world.gradient(rows[:1]).shape[1]) != first.shape[1]:
        raise InputError(f"{world.name}: rollout(theta) has {first.shape[1]} outputs, gradient(theta) has {m}")
    return first.shape[1], int((~np.isfinite(first)).any(axis=1).sum())


class WorldObjective(SampledObjective):
    """One output of a simulator as a function of one of its parameters, with noise added to the parameter.

    ``theta`` (d,) are the nominal parameters of the simulator, ``parameter`` the index of the parameter that varies and
    ``output`` the index of the output. The decision has a single component, the varied parameter.
    """

    adds_noise_to_decision: ClassVar[bool] = True

    def __init__(
        self, world: World, theta: np.ndarray, parameter: int = 0, output: int = 0, signal: Signal | None = None
    ) -> None:
        world.prepare()
        self.name, self.world, self.n_noise, self.parameters = world.name, world, 1, {}
        self.decision = (signal or Signal("theta", "1"),)
        self.theta = np.array([theta[parameter]], dtype=float)
        self._base, self._parameter, self._output = np.array(theta, dtype=float), parameter, output

    def values_at(self, theta: np.ndarray) -> np.ndarray:
        """Return the output (n,) at values (n,) of the parameter."""
        return self.world.rollout(self._rows(theta))[:, self._output]

    def slopes_at(self, theta: np.ndarray) -> np.ndarray:
        """Return the simulator's derivative (n,) of the output at values (n,) of the parameter."""
        return self.world.gradient(self._rows(theta))[:, self._output, self._parameter]

    def costs(self, noise: np.ndarray) -> np.ndarray:
        """Return the output (n,) at the nominal parameter plus noise (n, 1)."""
        return self.values_at(self.theta[0] + noise[:, 0])

    def sample_scores(self, noise: Gaussian, n: int) -> CostSamples:
        """Return the outputs (n,) and the scores w / sigma^2 (n, 1) of n samples."""
        w = noise.draw(n, 1, 1)[:, 0]
        return CostSamples(self.costs(w), w / noise.component_scales(1) ** 2)

    def sample_gradients(self, noise: Gaussian, n: int) -> CostSamples:
        """Return the outputs (n,) and the simulator's derivatives (n, 1) at the parameter plus noise, for n samples."""
        theta = self.theta[0] + noise.draw(n, 1, 1)[:, 0, 0]
        return CostSamples(self.values_at(theta), self.slopes_at(theta)[:, None])

    def _rows(self, theta: np.ndarray) -> np.ndarray:
        rows = np.tile(self._base, (len(theta), 1))
        rows[:, self._parameter] = theta
        return rows
