"""Reinforcement learning tasks: a system with random starts, rewards, and conditions that end episodes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from dynamics.systems import ContactSystem, ParameterTable, Signal
from ocp.errors import InputError


@dataclass(frozen=True, eq=False)
class Measure:
    """A quantity of one step, such as a speed, whose mean is part of evaluations.

    ``expression`` is in (x, u, x_next) of the system and the parameters.
    """

    signal: Signal
    expression: ca.SX


@dataclass(frozen=True, eq=False, kw_only=True)
class Task:
    """Task of maximising the mean over starts of ``sum_t reward(x_t, u_t, x_{t+1}) + final(x_N)``, t < N.

    An episode starts at ``start``, an expression in the parameters and in ``chance`` (k, 1), whose
    entries are independent and uniform on [-1, 1]. It ends after ``horizon`` steps N, when
    ``final`` (an expression in x) is added, or earlier, at the first state at which ``done`` (an
    expression in x) is not zero; then no further reward and no ``final`` are added. A policy maps
    ``observation``, an expression in x, to inputs between ``lower`` and ``upper`` (nu,).

    ``lasts`` (k, 1) expresses ``done`` for planning: at finite states an episode continues if all
    its entries, expressions in x, are positive. It is needed only if ``done`` depends on x, and may
    be empty if ``done`` only rejects states that are not finite.

    All expressions may use the ``parameters``, which include those of the system. Evaluations
    report the ``measures``.

    Raises :class:`~ocp.errors.InputError` if a dimension does not fit.
    """

    name: str
    system: ContactSystem
    parameters: ParameterTable
    horizon: int
    start: ca.SX
    chance: ca.SX
    reward: ca.SX
    observation: ca.SX
    observations: tuple[Signal, ...]
    lower: np.ndarray
    upper: np.ndarray
    final: ca.SX | float = 0.0
    done: ca.SX | float = 0.0
    lasts: ca.SX | None = None
    measures: tuple[Measure, ...] = ()

    def __post_init__(self) -> None:
        system = self.system
        if isinstance(self.horizon, bool) or self.horizon < 1:
            raise InputError(f"{self.name}: an episode needs at least 1 step, got {self.horizon}")
        for field_name, entries, size in (
            ("start", ca.SX(self.start).numel(), system.nx),
            ("reward", ca.SX(self.reward).numel(), 1),
            ("final", ca.SX(self.final).numel(), 1),
            ("done", ca.SX(self.done).numel(), 1),
            ("observation", ca.SX(self.observation).numel(), len(self.observations)),
            ("lower", len(self.lower), system.nu),
            ("upper", len(self.upper), system.nu),
        ):
            if entries != size:
                raise InputError(f"{self.name}: {field_name} has {entries} entries, expected {size}")
        if not np.all(np.less(self.lower, self.upper)):
            raise InputError(f"{self.name}: lower bounds of inputs must be below the upper ones")

    @cached_property
    def mid_range(self) -> np.ndarray:
        """Middle (nu,) between the bounds of the inputs."""
        return (self.upper + self.lower) / 2

    @cached_property
    def half_range(self) -> np.ndarray:
        """Half the distance (nu,) between the bounds of the inputs."""
        return (self.upper - self.lower) / 2

    @cached_property
    def starts(self) -> ca.Function:
        """Function from ``(chance, parameters)`` to the first state (nx, 1)."""
        arguments = [self.chance, self.parameters.vector]
        return ca.Function("start", arguments, [ca.densify(ca.SX(self.start))])

    def reset(self, n: int, rng: np.random.Generator, p: np.ndarray | None = None) -> np.ndarray:
        """Return ``n`` random first states (n, nx) at parameters ``p`` (by default the task's values)."""
        chance = rng.uniform(-1.0, 1.0, (n, self.chance.numel()))
        values = self.parameters.values if p is None else p
        return np.array(self.starts.map(n)(chance.T, ca.repmat(ca.DM(values), 1, n))).T

    @cached_property
    def rewards(self) -> ca.Function:
        """Function from ``(x, u, x_next, parameters)`` to the reward of a step."""
        return self._of_step("reward", self.reward)

    @cached_property
    def finals(self) -> ca.Function:
        """Function from ``(x, parameters)`` to the reward at the end of a full episode."""
        return self._of_state("final", self.final)

    @cached_property
    def ends(self) -> ca.Function:
        """Function from ``(x, parameters)`` to 1 if an episode ends at x, else 0."""
        return self._of_state("done", ca.SX(self.done) != 0)

    @cached_property
    def observe(self) -> ca.Function:
        """Function from ``(x, parameters)`` to the policy's observation (n_o, 1)."""
        return self._of_state("observation", self.observation)

    @cached_property
    def measure(self) -> ca.Function:
        """Function from ``(x, u, x_next, parameters)`` to the measures of a step."""
        return self._of_step("measure", ca.vertcat(ca.SX(0, 1), *(measure.expression for measure in self.measures)))

    def _of_step(self, name: str, expression: ca.SX | float) -> ca.Function:
        arguments = [self.system.x, self.system.u, self.system.x_next, self.parameters.vector]
        return ca.Function(name, arguments, [ca.densify(ca.SX(expression))])

    def _of_state(self, name: str, expression: ca.SX | float) -> ca.Function:
        arguments = [self.system.x, self.parameters.vector]
        return ca.Function(name, arguments, [ca.densify(ca.SX(expression))])
