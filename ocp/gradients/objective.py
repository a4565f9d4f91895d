"""Objectives of gradient estimators: costs that are functions of a decision and of Gaussian noise."""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, Self

import casadi as ca
import numpy as np

from dynamics.batch import BatchFunction, BatchWarning, Gaussian, Moments
from dynamics.batch.graphs.step_graphs import dependence_table
from dynamics.systems import ParameterTable, Signal
from ocp.errors import InputError

Order = Literal["cost", "zeroth", "first"]
"""Quantity whose moments are computed: the cost, or the gradient estimate of zeroth or first order."""
Bulk = tuple[Moments, np.ndarray]
"""Moments of many samples, and the indices of samples left out because they are not finite."""


@dataclass(frozen=True)
class CostSamples:
    """Costs (n,) of n samples, with the samples' scores or gradients in ``direction`` (n, d)."""

    cost: np.ndarray
    direction: np.ndarray


@dataclass(frozen=True)
class ClosedForm:
    """Closed-form value and gradient of a smoothed objective, and moments of its estimators.

    ``objective`` is the value F = E f, and ``gradient`` (d,) the gradient of F. ``zobg_variance`` and
    ``fobg_variance`` (d,) are the variances of one sample of ZoBG (without baseline) and FoBG. ``fobg_mean``
    (d,) is the expectation of FoBG, which differs from ``gradient`` if f jumps.
    """

    objective: float
    gradient: np.ndarray
    zobg_variance: np.ndarray
    fobg_mean: np.ndarray
    fobg_variance: np.ndarray


class SampledObjective(ABC):
    """Base class of costs ``V(theta, w)`` whose mean over ``w ~ N(0, sigma^2 I)`` estimators differentiate.

    ``decision`` contains the names and units of the d components of ``theta`` (d,). ``parameters`` maps the
    names of all other parameters that a sweep may change to their values. ``n_noise`` is the number of
    components of w. ``adds_noise_to_decision`` is true for objectives ``V(theta + w)``.
    """

    adds_noise_to_decision: ClassVar[bool] = False
    name: str
    decision: tuple[Signal, ...]
    theta: np.ndarray
    n_noise: int
    parameters: dict[str, float]

    def at(self, values: Mapping[str, float]) -> Self:
        """Return a copy with other values of parameters or of components of the decision.

        The copy shares all compiled functions. Raises :class:`~ocp.errors.InputError` for an unknown name and
        for a value that is not finite.
        """
        names = [*(signal.name for signal in self.decision), *self.parameters]
        for name, value in values.items():
            if name not in names:
                listed = ", ".join(names[:12]) + (", ..." if len(names) > 12 else "")
                raise InputError(f"{self.name} has no parameter {name!r} to set; there are {listed}")
            if not np.isfinite(value):
                raise InputError(f"{self.name}: {name} must be finite, got {value}")
        copied = copy(self)
        pairs = zip(self.decision, self.theta, strict=True)
        copied.theta = np.array([values.get(s.name, current) for s, current in pairs], dtype=float)
        copied.parameters = {k: float(values.get(k, current)) for k, current in self.parameters.items()}
        return copied

    @property
    def values(self) -> np.ndarray:
        """Values of the parameters, in the order of ``parameters``."""
        return np.array(list(self.parameters.values()))

    @abstractmethod
    def costs(self, noise: np.ndarray) -> np.ndarray:
        """Return the costs (n,) at the noise (n, n_noise)."""

    @abstractmethod
    def sample_scores(self, noise: Gaussian, n: int) -> CostSamples:
        """Return the costs (n,) and scores (n, d) of n samples of the noise.

        The score is the gradient in theta of the log-density of the noise, ``sum_t D_theta pi(x_t)' w_t /
        sigma^2`` (Suh, Simchowitz, Zhang et al. 2022, def. II.1). Components of the noise that do not affect
        the cost are left out, since they would only add variance.
        """

    @abstractmethod
    def sample_gradients(self, noise: Gaussian, n: int) -> CostSamples:
        """Return the costs (n,) of n samples, and the gradients (n, d) of the costs with respect to theta."""

    def sample_perturbed(self, noise: Gaussian, n: int) -> CostSamples:
        """Return the costs (n,) at ``theta + w`` without noise on the inputs, and the scores ``w / sigma^2`` (n, d).

        For an objective without dynamics this is the same as :meth:`sample_scores`.
        """
        return self.sample_scores(noise, n)

    def moments(self, noise: Gaussian, n: int, order: Order, baseline: float = 0.0) -> Bulk | None:
        """Return moments over n samples of the cost, of (cost - baseline) * score, or of the gradient.

        The result is None if the objective can compute moments only from single samples.
        """
        return None

    def nominal_cost(self) -> float:
        """Return the cost at zero noise."""
        return float(self.costs(np.zeros((1, self.n_noise)))[0])

    def closed_form(self, sigma: float) -> ClosedForm | None:
        """Return the closed form, or None if the objective has none."""
        return None


class StaticObjective(SampledObjective):
    """Objective ``f(theta + w)`` without dynamics, given as a CasADi expression.

    ``cost`` is an expression in ``theta`` (d, 1) and the parameters. ``closed_form(values, sigma)`` returns the
    closed form of the smoothed objective, where ``values`` maps names of the decision's components and of
    parameters to numbers. ``engine`` are further arguments of :class:`~dynamics.batch.BatchFunction`.

    Raises :class:`~ocp.errors.InputError` if dimensions do not match.
    """

    adds_noise_to_decision: ClassVar[bool] = True

    def __init__(
        self,
        name: str,
        decision: tuple[Signal, ...],
        theta: ca.SX,
        cost: ca.SX,
        value: np.ndarray,
        parameters: ParameterTable,
        closed_form: Callable[[dict[str, float], float], ClosedForm] | None = None,
        **engine: Any,
    ) -> None:
        decision_values = np.atleast_1d(np.asarray(value, dtype=float))
        if theta.numel() != len(decision) or decision_values.shape != (len(decision),) or cost.numel() != 1:
            raise InputError(
                f"{name}: a decision with {len(decision)} named components needs as many symbols"
                f" and values and one cost, got {theta.numel()}, {decision_values.size} and {cost.numel()}"
            )
        self.name, self.decision, self.theta, self.n_noise = name, decision, decision_values, len(decision)
        self.parameters, self._closed_form = parameters.defaults, closed_form
        self._acts = dependence_table(cost, theta)[0]
        arguments = [theta, parameters.vector]
        values = [ca.densify(cost), ca.densify(ca.gradient(cost, theta))]
        self._cost = BatchFunction(ca.Function("cost", arguments, values[:1]), **engine)
        self._cost_and_gradient = BatchFunction(ca.Function("cost_and_gradient", arguments, values), **engine)

    def costs(self, noise: np.ndarray) -> np.ndarray:
        """Return the costs (n,) at ``theta + noise`` for noise (n, d)."""
        return without_warnings(self._cost, self.theta + noise, self.values)[:, 0]

    def sample_scores(self, noise: Gaussian, n: int) -> CostSamples:
        """Return the costs (n,) and the scores w / sigma^2 (n, d), 0 for components that do not affect the cost."""
        w = noise.draw(n, 1, self.n_noise)[:, 0]
        return CostSamples(self.costs(w), self._acts * w / noise.component_scales(self.n_noise) ** 2)

    def sample_gradients(self, noise: Gaussian, n: int) -> CostSamples:
        """Return the costs (n,) and gradients (n, d) at ``theta + w``."""
        theta = self.theta + noise.draw(n, 1, self.n_noise)[:, 0]
        cost, gradient = without_warnings(self._cost_and_gradient, theta, self.values)
        return CostSamples(cost[:, 0], gradient)

    def closed_form(self, sigma: float) -> ClosedForm | None:
        """Return the closed form, or None if the objective has none."""
        if self._closed_form is None:
            return None
        theta = {s.name: float(v) for s, v in zip(self.decision, self.theta, strict=True)}
        try:
            return self._closed_form({**theta, **self.parameters}, sigma)
        except ArithmeticError as error:
            raise InputError(
                f"{self.name}: at sigma = {sigma:g} its closed form overflows double precision;"
                " take another sigma, or other parameters"
            ) from error


def without_warnings(function: Callable[..., Any], *args: Any, **named: Any) -> Any:
    """Call ``function`` without warnings about non-finite samples, which estimators count separately."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", category=BatchWarning, message=".*non-finite")
        return function(*args, **named)
