"""Scenarios of friction, masses and step sizes, in which one policy is replayed and followed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ocp.judge.constraints import broken_constraints, excess_violation
from ocp.judge.disturbances import FRICTION_SPREAD, MASS_SPREAD, friction_parameters, mass_parameters
from ocp.judge.referee import COST_SHARE, REFINEMENT, STATE_SHARE, outcome_findings, refined_replay, tolerance_sizes
from ocp.judge.step_size import step_size_kind, step_state
from ocp.mpc.linearised import project_psd
from ocp.mpc.plan_policies import linearised_plan
from ocp.mpc.stages import Plan, StageModel
from ocp.problem.evaluation import Evaluation
from ocp.problem.problem import Problem
from ocp.problem.rollout import Gains, Rollout, roll_on
from ocp.solve.shared_gains import Expansion, Merit


class HeldInputs:
    """Gains that are evaluated at every ``count``-th step; the input is held in between."""

    def __init__(self, gains: Gains, count: int) -> None:
        self.gains, self.count = gains, count
        self.held = gains.k[0]

    def input(self, step: int, x: np.ndarray) -> np.ndarray:
        """Return the input (nu,) at a step, which is computed from x (nx,) at the first step of its interval."""
        if step % self.count == 0:
            self.held = self.gains.input(step // self.count, x)
        return self.held


class ScenarioOutcomes:
    """Replays of a policy, along the plan of an ``evaluation``, in scenarios of changed parameters.

    The scenarios are the problem's own parameters, and both ends of the ranges from which the referee draws frictions
    and masses (:func:`end_values`). They are replayed at h/4 or, if the step size is part of the model, at h; the
    problem's own parameters are also replayed at h.
    """

    def __init__(self, evaluation: Evaluation, plan: Rollout) -> None:
        problem = evaluation.problem
        step_size = step_size_kind(problem.system)
        self.evaluation, self.plan, self.problem, self.step_size = evaluation, plan, problem, step_size
        self._step_state = step_state(problem.system)
        self.substeps = 1 if step_size.kind == "fixed" else REFINEMENT
        self.scenarios = [Evaluation(problem, values) for values in end_values(problem, evaluation.values)]
        self._refined_problem = replace(problem, N=self.substeps * problem.N)
        self._model = StageModel(problem, problem.exact_step)

    def merit(self, gains: Gains) -> Merit:
        """Return the failed replays at nominal parameters, by how much they fail, failures in all, and the mean cost.

        Other scenarios are replayed only if no replay at nominal parameters, at h/4 or h, fails.
        """
        replays = [self._replay(self.scenarios[0], gains)]
        if self.substeps > 1:
            replays.append(self._replay(self.evaluation, gains, substeps=1))
        failures, excess = self._failed(replays), sum(map(self._excess, replays))
        if not failures:
            replays += [self._replay(scenario, gains) for scenario in self.scenarios[1:]]
        costs = [replay.cost for replay in replays if np.isfinite(replay.cost)]
        return Merit(failures, excess, self._failed(replays), float(np.mean(costs)) if costs else np.inf)

    def _failed(self, replays: Sequence[Rollout]) -> int:
        return sum(bool(outcome_findings(self.evaluation, self.plan, replay)) for replay in replays)

    def _excess(self, replay: Rollout) -> float:
        """Return by how much a replay exceeds the limits of its cost, as a share, and of constraints, in sizes."""
        if not np.isfinite(replay.cost):
            return np.inf
        broken = broken_constraints(self.evaluation, replay, tolerance_sizes(self.problem, self.plan.x))
        share = self.evaluation.cost_share(replay.cost - self.plan.cost, self.plan.cost)
        return max(share - COST_SHARE, 0.0) + excess_violation(broken, STATE_SHARE)

    def _replay(self, scenario: Evaluation, gains: Gains, substeps: int | None = None) -> Rollout:
        x0, substeps = self.plan.x[:, 0], substeps or self.substeps
        if substeps == 1:
            return roll_on(scenario, gains, self.problem.referee_step, x0)[0]
        replay = refined_replay(scenario, gains, x0, substeps)[0]
        assert replay is not None
        return replay

    def expansions(self, gains: Gains, nominal: bool = False) -> list[Expansion]:
        """Return the expansions of scenarios, or of ``nominal`` parameters only.

        Closed loops that cannot be followed to the end under the exact law are left out.
        """
        scenarios = self.scenarios[:1] if nominal else self.scenarios
        expansions = (self._expansion(scenario, gains) for scenario in scenarios)
        return [expansion for expansion in expansions if expansion is not None]

    def _expansion(self, scenario: Evaluation, gains: Gains) -> Expansion | None:
        """Return the expansion of a scenario's closed loop; the inputs of its steps are held over the substeps."""
        model, N, substeps = self._model, self.problem.N, self.substeps
        nx, nu, limits = model.nx, model.nu, scenario.limits
        values, start = dict(scenario.values), self.plan.x[:, 0].copy()
        start[:, self._step_state] /= substeps
        if self.step_size.kind == "parameter":
            values[self.step_size.parameter] /= substeps
        refined, policy = Evaluation(self._refined_problem, values), HeldInputs(gains, substeps)
        rolled, unsolved = roll_on(refined, policy, self.problem.exact_step, start)
        if unsolved is not None or not np.isfinite(rolled.x).all():
            return None
        fine = Plan(rolled.x[0], rolled.u[0], rolled.lam[0], rolled.gap[0])
        evaluated = model.evaluate(fine, limits.u_before, self._rows(values, N * substeps))
        fine.gap = evaluated.gap
        x_next = linearised_plan(model, fine, evaluated).x_next
        A, B = x_next.by_x.reshape(N, substeps, nx, nx), x_next.by_u.reshape(N, substeps, nx, nu)
        AB = np.concatenate([A[:, 0], B[:, 0]], axis=2)
        for i in range(1, substeps):
            AB = A[:, i] @ AB
            AB[:, :, nx:] += B[:, i]
        lam, gap = fine.lam.reshape(N, substeps, model.n).sum(axis=1), fine.gap[substeps - 1 :: substeps]
        coarse = Plan(fine.x[::substeps].copy(), fine.u[::substeps], lam, gap)
        coarse.x[:, self._step_state] *= substeps
        costs = model.evaluate(coarse, limits.u_before, self._rows(scenario.values, N))
        xu, before = np.r_[:nx, nx + nu : nx + 2 * nu], slice(nx, nx + nu)
        gradient, hessian = costs.gradient[:, xu], costs.hessian[:, xu[:, None], xu]
        gradient[:-1, nx:] += costs.gradient[1:, before]
        hessian[:-1, nx:, nx:] += costs.hessian[1:, before, before]
        # Gains do not depend on the step size.
        coarse.x[:, self._step_state] = 0.0
        for matrix in (hessian, costs.end_hessian):
            matrix[..., self._step_state, :] = matrix[..., self._step_state] = 0.0
        return Expansion(
            x=coarse.x,
            u=coarse.u,
            free=(coarse.u > limits.u_lower) & (coarse.u < limits.u_upper),
            dynamics=AB,
            gradient=gradient,
            hessian=project_psd(hessian),
            end_gradient=costs.end_gradient,
            end_hessian=project_psd(costs.end_hessian),
        )

    def _rows(self, values: dict[str, float], N: int) -> np.ndarray:
        return np.tile([values.get(name, 0.0) for name in self._model.names], (N + 1, 1))


def end_values(problem: Problem, values: dict[str, float]) -> list[dict[str, float]]:
    """Return the values themselves, and values with all frictions, or all masses, at the ends of their ranges.

    The ends are both upper, both lower, or alternate from parameter to parameter.
    """
    scenarios = [values]
    for names, spread in ((friction_parameters(problem), FRICTION_SPREAD), (mass_parameters(problem), MASS_SPREAD)):
        alternating = (-1.0) ** np.arange(len(names))
        for signs in [np.ones(len(names)), alternating][: len(names)]:
            for end in (-spread, spread):
                changed = {name: values[name] * (1 + end * sign) for name, sign in zip(names, signs, strict=True)}
                scenarios.append(values | changed)
    return scenarios
