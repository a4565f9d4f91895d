"""Policies along a plan: regulator gains with the plan's contacts fixed, and a receding-horizon controller."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ocp.judge.step_size import step_state
from ocp.mpc.active_set import ActiveSets
from ocp.mpc.controller import Controller
from ocp.mpc.linearised import LinearClosure, Linearised, linearise
from ocp.mpc.riccati import regulator_gains
from ocp.mpc.stages import Plan, StageModel, StageValues
from ocp.problem.evaluation import Evaluation
from ocp.problem.rollout import Gains, Rollout

LEAST_SMOOTHING = 1e-6
"""Smoothing mu used if the active set of a step has no linearisation, for example for redundant contacts."""


class Weights(NamedTuple):
    """Weights of squared deviations from a plan, relative to the cost above its lower bound.

    Deviations are in characteristic sizes. ``states`` weights states and ``inputs`` weights inputs, both as means
    over the horizon; ``end`` weights the last state.
    """

    states: float = 0.0
    end: float = 0.0
    inputs: float = 0.0


NO_WEIGHTS = Weights()
"""Weights that add nothing to the cost of the problem."""


def linearised_plan(model: StageModel, plan: Plan, evaluated: StageValues, smoothing: float = 0.0) -> Linearised:
    """Return the steps of a plan of any length, with contact eliminated as in :class:`PlanRegulator`."""
    closure = _smoothed_closure(model, plan, smoothing or LEAST_SMOOTHING)
    sets = ActiveSets(model)
    # In space all pairs are smoothed; whether gains at the active set hold a motion better was not compared there.
    if not smoothing and not any(contact.is_spatial for contact in sets.contacts):
        closed = sets.of(plan)
        with suppress(np.linalg.LinAlgError):
            return linearise(model, plan, evaluated, LinearClosure.from_active_set(plan, closed))
    return linearise(model, plan, evaluated, closure)


def _smoothed_closure(model: StageModel, plan: Plan, mu: float) -> LinearClosure:
    """Return ``gap dlam + lam dgap = 0`` at the point with ``lam gap = mu`` and the plan's ``lam - gap``."""
    lam_size, gap_size = model.sizes
    difference = plan.lam / lam_size - plan.gap / gap_size
    larger = (np.abs(difference) + np.sqrt(difference**2 + 4 * mu)) / 2
    lam = np.where(difference > 0, larger, mu / larger)
    gap = np.where(difference > 0, mu / larger, larger)
    zero = np.zeros_like(lam)
    return LinearClosure(lam / gap_size / larger, gap / lam_size / larger, zero, zero)


class PlanRegulator:
    """Linear-quadratic regulator along a plan x (1, N+1, nx) under the exact law, with the plan's contacts fixed.

    Every step is linearised with its active set fixed: open pairs have no force and closed pairs keep their gap
    zero, so that the jump at an impact is part of the linear dynamics. With a ``smoothing`` mu, in
    characteristic impulses times gaps, the law ``lam gap = mu`` is linearised instead, at the point with the
    same ``lam - gap`` as the plan, so that both force and gap of a pair near contact may change. The
    regulator's cost is the second-order expansion of the problem's cost at the plan, plus deviations with
    :class:`Weights`.
    """

    def __init__(self, evaluation: Evaluation, plan: Rollout) -> None:
        problem = evaluation.problem
        self._model = model = StageModel(problem, problem.exact_step)
        row = [evaluation.values.get(name, 0.0) for name in model.names]
        p = np.tile(row, (problem.N + 1, 1))
        self._plan = Plan(plan.x[0], plan.u[0], plan.lam[0], plan.gap[0])
        self._evaluated = model.evaluate(self._plan, evaluation.limits.u_before, p)
        self._plan.gap = self._evaluated.gap
        self._step_state = step_state(problem.system)
        for hessian in (self._evaluated.hessian, self._evaluated.end_hessian):
            hessian[..., self._step_state, :] = hessian[..., self._step_state] = 0.0
        self._sizes = problem.scales
        self._unit = abs(plan.cost - evaluation.least_cost)

    def linearised(self, smoothing: float = 0.0) -> Linearised:
        """Return the plan's steps with contact eliminated; they are smoothed if an active set has no linearisation."""
        return linearised_plan(self._model, self._plan, self._evaluated, smoothing)

    def gains(self, weights: Weights = NO_WEIGHTS, smoothing: float = 0.0) -> Gains:
        """Return K (N, nu, nx), k (N, nu) of the feedback ``u = K x + k``, with the plan's inputs at its states.

        If the step size is a state, inputs do not depend on it, since a replay at h/4 changes nothing else.
        """
        lin, plan, N = self.linearised(smoothing), self._plan, len(self._plan.u)
        nx, nu = self._model.nx, self._model.nu
        hessian, (end_gradient, end_hessian) = lin.hessian.copy(), lin.end
        of_states, of_inputs = self._unit / self._sizes.x**2, self._unit / self._sizes.u**2
        states, inputs = np.arange(nx), np.arange(nx + nu, nx + 2 * nu)
        hessian[:, states, states] += weights.states * of_states / N
        hessian[:, inputs, inputs] += weights.inputs * of_inputs / N
        end = end_gradient, end_hessian + np.diag(weights.end * of_states)
        K = regulator_gains(replace(lin, hessian=hessian, end=end))
        K[:, :, self._step_state] = 0.0
        return Gains(K, plan.u - np.einsum("kij,kj->ki", K, plan.x[:-1]))


class ControllerPolicy:
    """Receding-horizon controller as a function of the state; it is reset at step 0.

    ``samples`` counts the samples, and ``n_unplanned`` the samples at which no new plan could be computed; ``note``
    is the reason at the last such sample.
    """

    def __init__(self, evaluation: Evaluation) -> None:
        names = evaluation.problem.parameters.names
        values = {name: evaluation.values[name] for name in names}
        self.controller = Controller(evaluation.problem, parameters=values)
        self.samples, self.n_unplanned, self.note = 0, 0, ""

    def input(self, step: int, x: np.ndarray) -> np.ndarray:
        """Return the controller's input (nu,) for a measured state."""
        if step == 0:
            self.controller.reset()
        command = self.controller.step(x)
        self.samples += 1
        if command.status == "kept":
            self.n_unplanned, self.note = self.n_unplanned + 1, command.note
        return command.u
