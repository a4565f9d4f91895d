"""Gains along a plan, improved along their own motions in another simulator."""

from __future__ import annotations

import sys

import numpy as np

from ocp.errors import InputError, choose
from ocp.judge.constraints import broken_constraints, excess_violation, noticeable_violations
from ocp.judge.referee import STATE_SHARE, referee_replay, tolerance_sizes
from ocp.judge.step_size import step_state
from ocp.mpc.linearised import project_psd
from ocp.mpc.plan_policies import PlanRegulator
from ocp.mpc.stages import Plan, StageModel
from ocp.problem.evaluation import Evaluation
from ocp.problem.rollout import Gains, Rollout, StateFeedback
from ocp.simulators import SIMULATORS
from ocp.simulators.mujoco_world import MujocoWorld
from ocp.simulators.replay import simulated_motion
from ocp.solution import Solution
from ocp.solve.best_gains import SMOOTHING, WEIGHTS, plan_of, with_gains
from ocp.solve.scenario_gains import improved_gains
from ocp.solve.shared_gains import Expansion, Merit

DIFFERENCE = 1e-3
"""Change of states and inputs in finite differences, in characteristic sizes; it averages over contacts close by."""
MAX_STARTS = 6
"""Maximum number of gains from which passes start while constraints are violated.

On the half-cheetah the first three end at violations of periodic states, the fourth at none.
"""


def with_gains_in(solution: Solution, simulator: str = "mujoco") -> Solution:
    """Return the solution with :func:`gains_in_simulator` as its policy, replayed by the referee.

    Raises :class:`~ocp.errors.InputError` as :class:`~ocp.simulators.mujoco_world.MujocoWorld` does, and for a
    solution of several scenarios or with feedback.
    """
    choose("world", simulator, SIMULATORS)
    if solution.problem.scenarios.n > 1 or solution.gains is not None:
        raise InputError("gains follow a single plan of open-loop inputs; solve without --policy feedback")
    evaluation, plan = plan_of(solution, solution.problem.exact_step)
    gains = gains_in_simulator(evaluation, plan, MujocoWorld(solution.problem, solution.values))
    return with_gains(solution, gains, referee_replay(evaluation, gains, plan.x[:, 0]))


def gains_in_simulator(evaluation: Evaluation, plan: Rollout, simulator: MujocoWorld) -> Gains:
    """Return gains of lower cost in a simulator than the plan's inputs and a regulator's gains.

    The best of these start the passes of :func:`~ocp.solve.shared_gains.shared_gains` along the motion there; while
    the motion violates constraints, so do the next best, up to :data:`MAX_STARTS`. Raises
    ``numpy.linalg.LinAlgError`` if a step of the plan has no linearisation.
    """
    outcomes, regulator = SimulatorOutcomes(evaluation, plan, simulator), PlanRegulator(evaluation, plan)
    candidates = [Gains(np.zeros((*plan.u[0].shape, plan.x.shape[2])), plan.u[0])]
    candidates += [regulator.gains(weights, smoothing) for smoothing in SMOOTHING for weights in WEIGHTS]
    merits = [outcomes.merit(gains) for gains in candidates]
    order = sorted(range(len(candidates)), key=lambda i: (merits[i].excess, merits[i].cost))
    best, least = candidates[order[0]], merits[order[0]]
    for i in order[:MAX_STARTS]:
        gains, merit = improved_gains(outcomes, candidates[i], merits[i])
        if merit < least:
            best, least = gains, merit
        if least.excess == 0:
            break
    return best


class SimulatorOutcomes:
    """Motions of a policy in a simulator, along the plan of an ``evaluation``."""

    def __init__(self, evaluation: Evaluation, plan: Rollout, simulator: MujocoWorld) -> None:
        self.evaluation, self.plan, self.simulator = evaluation, plan, simulator
        self.problem = evaluation.problem
        self._model = StageModel(self.problem, self.problem.exact_step)
        self._step_state = step_state(self.problem.system)

    def merit(self, gains: np.ndarray | StateFeedback) -> Merit:
        """Return how many kinds of constraints the motion under inputs or a policy violates, and its cost."""
        x, u = simulated_motion(self.simulator, self.evaluation, gains, self.plan.x[:, 0])
        if not np.isfinite(x).all():
            return Merit(sys.maxsize, np.inf, 0, np.inf)
        empty = np.zeros((*u.shape[:2], self.problem.system.nlam))
        motion = Rollout.from_trajectories(self.evaluation, self.problem.exact_step, x, u, empty, empty)
        sizes = tolerance_sizes(self.problem, self.plan.x)
        broken = broken_constraints(self.evaluation, motion, sizes)
        violated = len(noticeable_violations(broken, STATE_SHARE))
        return Merit(violated, excess_violation(broken, STATE_SHARE), 0, motion.cost)

    def expansions(self, gains: Gains, nominal: bool = True) -> list[Expansion]:
        """Return the expansion of the motion, with dynamics by central differences; none if it diverges."""
        model, limits = self._model, self.evaluation.limits
        x, u = (v[0] for v in simulated_motion(self.simulator, self.evaluation, gains, self.plan.x[:, 0]))
        if not np.isfinite(x).all():
            return []
        zeros, nx, nu = np.zeros((model.N, model.n)), model.nx, model.nu
        rows = np.tile([self.evaluation.values.get(name, 0.0) for name in model.names], (model.N + 1, 1))
        costs = model.evaluate(Plan(x, u, zeros, zeros), limits.u_before, rows)
        xu, before = np.r_[:nx, nx + nu : nx + 2 * nu], slice(nx, nx + nu)
        gradient, hessian = costs.gradient[:, xu], costs.hessian[:, xu[:, None], xu]
        gradient[:-1, nx:] += costs.gradient[1:, before]
        hessian[:-1, nx:, nx:] += costs.hessian[1:, before, before]
        dynamics = np.stack([self._derivative(*pair) for pair in zip(x[:-1], u, strict=True)])
        x = x.copy()
        x[:, self._step_state] = 0.0
        for matrix in (hessian, costs.end_hessian):
            matrix[..., self._step_state, :] = matrix[..., self._step_state] = 0.0
        end = costs.end_gradient, project_psd(costs.end_hessian)
        free = (u > limits.u_lower) & (u < limits.u_upper)
        return [Expansion(x, u, free, dynamics, gradient, project_psd(hessian), *end)]

    def _derivative(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Return the derivative (nx, nx + nu) of the next state with respect to (x, u)."""
        scales, nx = self.problem.scales, x.size
        point, sizes = np.concatenate([x, u]), DIFFERENCE * np.concatenate([scales.x, scales.u])
        derivative = np.zeros((nx, point.size))
        for i, size in enumerate(sizes):
            ends = [point + sign * size * (np.arange(point.size) == i) for sign in (1, -1)]
            after = [self.simulator.step(end[:nx], end[nx:]) for end in ends]
            derivative[:, i] = (after[0] - after[1]) / (2 * size)
        derivative[:, self._step_state] = 0.0
        return derivative
