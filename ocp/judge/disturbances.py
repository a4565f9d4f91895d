"""Survival of inputs and policies under noise, changed parameters and delay, counted over seeded draws.

A draw is replayed under the most exact contact model, at h/4 or, if the step size is part of the model, at h. It
survives if it costs at most 10 % more than the plan, and violates constraints and penetrates bodies by at most a
tenth of their sizes (:func:`ocp.judge.referee.outcome_findings`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from ocp.judge.referee import REFINEMENT, outcome_findings, refined_replay
from ocp.judge.route_report import DisturbedSurvival
from ocp.judge.step_size import step_size_kind
from ocp.problem.evaluation import Evaluation
from ocp.problem.problem import Problem
from ocp.problem.rollout import Gains, Rollout, StateFeedback, roll_on

DRAWS = 20
"""Number of draws of every disturbance."""
NOISE_SHARE = 0.01
"""Standard deviation of the noise on the measured state, in characteristic sizes."""
FRICTION_SPREAD = 0.2
"""Largest relative change of every friction coefficient."""
MASS_SPREAD = 0.1
"""Largest relative change of every mass and inertia."""
ROBUST_DRAWS = 18
"""Smallest number of draws of friction, and of masses, that a robust policy survives."""
_MASS_UNITS = ("kg", "kg m^2")
"""Units of parameters that are masses."""
_FRICTION_ROW, _MASS_ROW = f"friction ±{FRICTION_SPREAD:.0%}", f"masses ±{MASS_SPREAD:.0%}"
"""Names of the disturbances that change parameters."""


@dataclass
class DisturbedPolicy:
    """Policy whose measured state has ``noise`` (N, nx) added, and whose inputs are applied late.

    ``waiting`` are the inputs (nu,) that are applied before the policy's next one, as many as the steps of the delay.
    """

    policy: StateFeedback
    noise: np.ndarray
    waiting: list[np.ndarray] = field(default_factory=list)

    def input(self, step: int, x: np.ndarray) -> np.ndarray:
        """Return the input at a step and a state."""
        self.waiting.append(self.policy.input(step, x + self.noise[step]))
        return self.waiting.pop(0)


@dataclass(frozen=True)
class Draw:
    """Dict of parameter values, noise on the measured state (N, nx), and the ``delay`` of inputs in steps."""

    values: dict[str, float]
    noise: np.ndarray
    delay: int = 0


def disturbed_survival(
    evaluation: Evaluation,
    plan: Rollout,
    inputs: np.ndarray | StateFeedback,
    seed: int = 0,
    factors: Sequence[int] = (),
    delay: int = 1,
) -> list[DisturbedSurvival]:
    """Count the draws that inputs (S, N, nu), or a policy, survive; one row for every disturbance.

    Costs and states are compared with those of ``plan``, and draws start at its first states. ``factors`` are divisors
    of the step size, such as 16, with one row each. ``delay`` is the number of steps by which inputs are late in the
    row "inputs one step late": 1, or as many as are one step of a coarser plan. There is no row for noise if open-loop
    inputs are replayed, and no row for friction or masses if the problem has no such parameters.
    """
    rows = []
    for factor in factors if step_size_kind(evaluation.problem.system).kind != "fixed" else ():
        rolled = refined_replay(evaluation, inputs, plan.x[:, 0], factor)[0]
        assert rolled is not None
        rows.append(_counted(f"h/{factor}", [rolled], evaluation, plan))
    draws_by_name = _draws(evaluation, not isinstance(inputs, np.ndarray), seed)
    draws_by_name["inputs one step late"] = [Draw(evaluation.values, np.zeros(plan.x[0, 1:].shape), delay)]
    for name, draws in draws_by_name.items():
        rolled_draws = [_rolled(evaluation, plan, inputs, draw) for draw in draws]
        rows.append(_counted(name, rolled_draws, evaluation, plan))
    return rows


def parameter_draws(rows: Sequence[DisturbedSurvival]) -> list[int]:
    """Return the numbers of draws of friction and of masses that are survived; empty if nothing can be changed."""
    return [row.survived for row in rows if row.disturbance in (_FRICTION_ROW, _MASS_ROW)]


def _counted(name: str, replays: list[Rollout], evaluation: Evaluation, plan: Rollout) -> DisturbedSurvival:
    costs = [replay.cost if np.isfinite(replay.cost) else np.inf for replay in replays]
    survived = sum(not outcome_findings(evaluation, plan, replay) for replay in replays)
    return DisturbedSurvival(name, survived, len(replays), float(np.median(costs)), max(costs))


def _draws(evaluation: Evaluation, reads_state: bool, seed: int) -> dict[str, list[Draw]]:
    """Return a dict from disturbances to their draws; each draw has its own random stream."""
    problem, values = evaluation.problem, evaluation.values
    streams = np.random.SeedSequence(seed).spawn(3)
    rngs = [[np.random.default_rng(stream) for stream in streams_of.spawn(DRAWS)] for streams_of in streams]
    none = np.zeros((problem.N, problem.system.nx))
    draws: dict[str, list[Draw]] = {}
    if reads_state:
        sizes = NOISE_SHARE * measured_sizes(problem)
        draws[f"noise of {NOISE_SHARE:.0%} on the state"] = [
            Draw(values, sizes * rng.standard_normal(none.shape)) for rng in rngs[0]
        ]
    spreads = {
        _FRICTION_ROW: (friction_parameters(problem), FRICTION_SPREAD, rngs[1]),
        _MASS_ROW: (mass_parameters(problem), MASS_SPREAD, rngs[2]),
    }
    for name, (parameters, spread, streams_of) in spreads.items():
        if parameters:
            draws[name] = [Draw(values | _spread(values, parameters, spread, rng), none) for rng in streams_of]
    return draws


def _spread(values: dict[str, float], names: list[str], spread: float, rng: np.random.Generator) -> dict[str, float]:
    factors = rng.uniform(1 - spread, 1 + spread, len(names))
    return {name: values[name] * factor for name, factor in zip(names, factors, strict=True)}


def measured_sizes(problem: Problem) -> np.ndarray:
    """Return characteristic sizes (nx,) of the states for noise; zero for a step size and for quaternions."""
    sizes, step_size = problem.scales.x.copy(), step_size_kind(problem.system)
    sizes[list(problem.system.rotating_entries)] = 0.0
    if step_size.kind == "state":
        sizes[step_size.state] = 0.0
    return sizes


def friction_parameters(problem: Problem) -> list[str]:
    """Return the names of the parameters that friction coefficients depend on."""
    forces = problem.system.forces
    if forces is None:
        return []
    symbols = ca.vertsplit(problem.parameters.vector)
    return [
        name
        for name, symbol in zip(problem.parameters.names, symbols, strict=True)
        if ca.depends_on(forces.friction, symbol)
    ]


def mass_parameters(problem: Problem) -> list[str]:
    """Return the names of the parameters that are masses or inertias."""
    return [parameter.name for parameter in problem.parameters if parameter.unit in _MASS_UNITS]


def _rolled(evaluation: Evaluation, plan: Rollout, inputs: np.ndarray | StateFeedback, draw: Draw) -> Rollout:
    """Return the rollout of a draw under the most exact contact model, at h/4, or at h if h cannot be refined."""
    problem = evaluation.problem
    drawn = Evaluation(problem, draw.values)
    parts = [_replayed(drawn, start[None], policy) for start, policy in _policies(plan, inputs, draw, drawn)]
    names = ("x", "u", "lam", "gap", "impulses", "costs")
    return Rollout(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def _policies(
    plan: Rollout, inputs: np.ndarray | StateFeedback, draw: Draw, drawn: Evaluation
) -> Iterator[tuple[np.ndarray, StateFeedback]]:
    """Yield the first state and the disturbed policy of every scenario; inputs become a policy with zero gains."""
    S, N, nu = plan.u.shape
    for s in range(S):
        policy = inputs
        if isinstance(policy, np.ndarray):
            row = policy[min(s, len(policy) - 1)]
            policy = Gains(np.zeros((N, nu, plan.x.shape[2])), row)
        yield plan.x[s, 0], DisturbedPolicy(policy, draw.noise, draw.delay * [drawn.limits.u_before])


def _replayed(evaluation: Evaluation, x0: np.ndarray, policy: StateFeedback) -> Rollout:
    replay = refined_replay(evaluation, policy, x0, REFINEMENT)[0]
    return roll_on(evaluation, policy, evaluation.problem.referee_step, x0)[0] if replay is None else replay
