"""Policies along a plan: the regulator's gains with the plan's contacts, and a controller that plans again."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ocp.mpc.active_set import ActiveSets
from ocp.mpc.controller import Controller
from ocp.mpc.linearised import LinearClosure, Linearised, linearise
from ocp.mpc.riccati import Regulator
from ocp.mpc.stages import Plan, StageModel
from ocp.problem.evaluation import Evaluation
from ocp.problem.rollout import Gains, Rollout

LEAST_SMOOTHING = 1e-6
"""Smoothing of steps whose active set has no linearisation, as where contacts are redundant."""


class Weights(NamedTuple):
    """Weights of deviations from a plan by a characteristic size, in what the plan can change of its cost.

    Of states over the whole horizon, of the last state, and of inputs over the whole horizon.
    """

    states: float = 0.0
    end: float = 0.0
    inputs: float = 0.0


NO_WEIGHTS = Weights()
"""No deviation costs more than in the problem."""


class PlanRegulator:
    """Linear-quadratic regulator along a plan x (1, N+1, nx) of the exact law, with the contacts of the plan.

    Every step is linearised with its active set held: open pairs have no force and closed ones keep their gap zero, so
    that the jump at an impact is part of the linear dynamics. With a ``smoothing`` mu, in characteristic impulses times
    gaps, the derivatives are instead those of the point of ``lam gap = mu`` with the plan's ``lam - gap``: pairs near
    contact then share both sides. The regulated cost is the problem's second-order expansion at the plan, with
    :class:`Weights` of deviations added.
    """

    def __init__(self, evaluation: Evaluation, plan: Rollout) -> None:
        problem = evaluation.problem
        self._model = model = StageModel(problem, problem.exact_step)
        row = [evaluation.values.get(name, 0.0) for name in model.names]
        p = np.tile(row, (problem.N + 1, 1))
        self._plan = Plan(plan.x[0], plan.u[0], plan.lam[0], plan.gap[0])
        self._evaluated = model.evaluate(self._plan, evaluation.limits.u_before, p)
        self._plan.gap = self._evaluated.gap
        self._regulator = Regulator(model.nx, model.nu, model.N)
        self._sizes = problem.scales
        self._unit = abs(plan.cost - evaluation.least_cost)

    def linearised(self, smoothing: float = 0.0) -> Linearised:
        """Return the plan's steps with contact eliminated; where an active set has no linearisation, smoothed."""
        closure = self._smoothed(smoothing or LEAST_SMOOTHING)
        if not smoothing:
            closed = ActiveSets(self._model).of(self._plan)
            with suppress(np.linalg.LinAlgError):
                active = LinearClosure.from_active_set(self._plan, closed)
                return linearise(self._model, self._plan, self._evaluated, active)
        return linearise(self._model, self._plan, self._evaluated, closure)

    def _smoothed(self, mu: float) -> LinearClosure:
        """Return ``gap dlam + lam dgap = 0`` at the point of the central path with the plan's ``lam - gap``."""
        lam_size, gap_size = self._model.sizes
        difference = self._plan.lam / lam_size - self._plan.gap / gap_size
        larger = (np.abs(difference) + np.sqrt(difference**2 + 4 * mu)) / 2
        lam = np.where(difference > 0, larger, mu / larger)
        gap = np.where(difference > 0, mu / larger, larger)
        zero = np.zeros_like(lam)
        return LinearClosure(lam / gap_size / larger, gap / lam_size / larger, zero, zero)

    def gains(self, weights: Weights = NO_WEIGHTS, smoothing: float = 0.0) -> Gains:
        """Return K (N, nu, nx) and k (N, nu) with ``u = K x + k``, which keeps the plan's own trajectory."""
        lin, plan, N = self.linearised(smoothing), self._plan, len(self._plan.u)
        nx, nu = self._model.nx, self._model.nu
        hessian, (end_gradient, end_hessian) = lin.hessian.copy(), lin.end
        of_states, of_inputs = self._unit / self._sizes.x**2, self._unit / self._sizes.u**2
        states, inputs = np.arange(nx), np.arange(nx + nu, nx + 2 * nu)
        hessian[:, states, states] += weights.states * of_states / N
        hessian[:, inputs, inputs] += weights.inputs * of_inputs / N
        end = end_gradient, end_hessian + np.diag(weights.end * of_states)
        K = self._regulator.gains(replace(lin, hessian=hessian, end=end))
        return Gains(K, plan.u - np.einsum("kij,kj->ki", K, plan.x[:-1]))


class ControllerPolicy:
    """A controller as a function of the state, which begins anew at step 0.

    Of its ``samples``, ``kept`` went on with the plan before; ``note`` is the last one's reason.
    """

    def __init__(self, evaluation: Evaluation) -> None:
        names = evaluation.problem.parameters.names
        values = {name: evaluation.values[name] for name in names}
        self.controller = Controller(evaluation.problem, parameters=values)
        self.samples, self.kept, self.note = 0, 0, ""

    def input(self, step: int, x: np.ndarray) -> np.ndarray:
        """Return the controller's input (nu,) for a measured state."""
        if step == 0:
            self.controller.reset()
        command = self.controller.step(x)
        self.samples += 1
        if command.status == "kept":
            self.kept, self.note = self.kept + 1, command.note
        return command.u
