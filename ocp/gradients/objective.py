"""Objectives for gradient estimators: a cost of a decision and of Gaussian noise."""

from __future__ import annotations

import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass
from typing import Any, Literal, Self

import casadi as ca
import numpy as np

from dynamics.batch import BatchFunction, BatchWarning, Gaussian, Moments
from dynamics.batch.graphs.step_graphs import dependence_table
from dynamics.systems import ParameterTable, Signal
from ocp.errors import InputError

Order = Literal["cost", "zeroth", "first"]
"""Quantity whose moments are summed: the cost, or an estimate of zeroth or first order."""
Bulk = tuple[Moments, np.ndarray]
"""Moments of many samples, and the indices of those left out as not finite."""


@dataclass(frozen=True)
class CostSamples:
    """Samples of n evaluations: ``cost`` (n,), and ``direction`` (n, d), their scores or gradients."""

    cost: np.ndarray
    direction: np.ndarray


@dataclass(frozen=True)
class ClosedForm:
    """Exact moments of an objective, for a decision of d components.

    ``objective`` is F = E f, ``gradient`` (d,) its gradient; ``zobg_variance`` and
    ``fobg_variance`` (d,) are variances of one sample (ZoBG without baseline), ``fobg_mean`` (d,)
    is the mean of the first-order estimate, which differs from ``gradient`` where f jumps.
    """

    objective: float
    gradient: np.ndarray
    zobg_variance: np.ndarray
    fobg_mean: np.ndarray
    fobg_variance: np.ndarray


class SampledObjective(ABC):
    """A cost ``V(theta, w)`` whose mean over ``w ~ N(0, sigma^2 I)`` is to be differentiated.

    ``decision`` names the d components of ``theta`` (d,); ``parameters`` holds every other number
    that a sweep may turn, by name; ``n_noise`` is the number of components of w.
    """

    name: str
    decision: tuple[Signal, ...]
    theta: np.ndarray
    n_noise: int
    parameters: dict[str, float]

    def at(self, values: Mapping[str, float]) -> Self:
        """Return the same objective with other parameters or components of the decision.

        Nothing is built or compiled again. Raises :class:`~ocp.errors.InputError` for a name that
        it does not have, and a value that is not finite.
        """
        names = [*(signal.name for signal in self.decision), *self.parameters]
        for name, value in values.items():
            if name not in names:
                listed = ", ".join(names[:12]) + (", ..." if len(names) > 12 else "")
                raise InputError(f"{self.name} has no parameter {name!r} to set; there are {listed}")
            if not np.isfinite(value):
                raise InputError(f"{self.name}: {name} must be finite, got {value}")
        other = copy(self)
        pairs = zip(self.decision, self.theta, strict=True)
        other.theta = np.array([values.get(s.name, current) for s, current in pairs], dtype=float)
        other.parameters = {k: float(values.get(k, current)) for k, current in self.parameters.items()}
        return other

    @property
    def values(self) -> np.ndarray:
        """Values of the parameters, in order."""
        return np.array(list(self.parameters.values()))

    @abstractmethod
    def costs(self, noise: np.ndarray) -> np.ndarray:
        """Return the costs (n,) at the noise (n, n_noise)."""

    @abstractmethod
    def sample_scores(self, noise: Gaussian, n: int) -> CostSamples:
        """Return the costs and scores of n samples.

        The score is the gradient by theta of the log-density of the noise,
        ``sum_t D_theta pi(x_t)' w_t / sigma^2`` (pathologies, def. II.1), of those components of
        the noise on which the cost depends: the score of any other adds variance alone.
        """

    @abstractmethod
    def sample_gradients(self, noise: Gaussian, n: int) -> CostSamples:
        """Return the costs of n samples and their gradients by theta (pathologies, def. II.2)."""

    def sample_perturbed(self, noise: Gaussian, n: int) -> CostSamples:
        """Return the costs at ``theta + w`` without further noise, and ``w / sigma^2``.

        Where the noise is added to the decision these are costs and scores.
        """
        return self.sample_scores(noise, n)

    def moments(self, noise: Gaussian, n: int, order: Order, baseline: float = 0.0) -> Bulk | None:
        """Return the moments over n samples of cost, of (cost - baseline) score, or of the gradient.

        Return None if the objective can do it no faster than sample by sample.
        """
        return None

    def nominal_cost(self) -> float:
        """Return the cost without noise."""
        return float(self.costs(np.zeros((1, self.n_noise)))[0])

    def closed_form(self, sigma: float) -> ClosedForm | None:
        """Return the closed form, or None if the objective has none."""
        return None


class StaticObjective(SampledObjective):
    """A cost ``f(theta + w)`` of a decision, given as a CasADi expression.

    ``cost`` is an expression in ``theta`` (d, 1) and the parameters. ``closed_form(values, sigma)``
    returns its closed form, ``values`` holding the decision's components and the parameters.
    ``engine`` is passed on to :class:`~dynamics.batch.BatchFunction`.

    Raises :class:`~ocp.errors.InputError` where dimensions do not fit.
    """

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
        """Return the costs (n,) at theta plus the noise (n, d)."""
        return without_warnings(self._cost, self.theta + noise, self.values)[:, 0]

    def sample_scores(self, noise: Gaussian, n: int) -> CostSamples:
        """Return the costs, and w / sigma^2 for the components on which the cost depends."""
        w = noise.draw(n, 1, self.n_noise)[:, 0]
        return CostSamples(self.costs(w), self._acts * w / noise.component_scales(self.n_noise) ** 2)

    def sample_gradients(self, noise: Gaussian, n: int) -> CostSamples:
        """Return the costs and gradients at theta + w."""
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
    """Call ``function`` without warnings of non-finite samples, which estimators count and name."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", category=BatchWarning, message=".*non-finite")
        return function(*args, **named)
