"""An episode of a task as an optimal control problem, and the search for its best plan from one start."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from dynamics.batch import BatchFunction, constant_policy
from ocp.errors import InputError
from ocp.learning.experiment import EXACT, Experiment
from ocp.learning.protocol import TrainedPolicy
from ocp.learning.rollouts import TaskRollouts
from ocp.learning.training import evaluate_from
from ocp.problem.problem import Constraint, Guess, Problem, Scaling
from ocp.problem.rollout import InitialGuess, roll_on
from ocp.problem.task import Task
from ocp.programs.solver import Point
from ocp.routes.branches import Branches
from ocp.routes.homotopy import Homotopy, RouteResult
from ocp.routes.rollouts import pack_rollout
from ocp.routes.session import Session
from ocp.solution import Solution
from ocp.solve.judging import judge_outcome
from ocp.solve.solve import new_session
from ocp.solve.starts import best_of


def guess_from_policy(experiment: Experiment, trained: TrainedPolicy) -> Guess:
    """Return a guess function: states and inputs of a policy's episode under the exact law.

    After an early end of the episode the last state is repeated, with zero inputs.
    """

    def guess(problem: Problem, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        evaluation = evaluate_from(experiment, trained, EXACT, problem.initial_states(p))
        return _hold_last_state(evaluation.states[0]), evaluation.inputs[0]

    return guess


def guess_from_constant_inputs(task: Task, n: int = 64, seed: int = 0) -> Guess:
    """Return a guess function: the episode under the best of ``n`` random constant inputs."""

    def guess(problem: Problem, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        share = np.random.default_rng(seed).uniform(-1.0, 1.0, (n, task.system.nu))
        policy = constant_policy(task.system.nx, task.lower, task.upper)
        rollouts = TaskRollouts(task, EXACT, policy, task.horizon)
        start = np.repeat(problem.initial_states(p), n, axis=0)
        episodes = rollouts(start, np.arctanh(share), n_samples=n, model_params=p, states=True)
        best_episode = int(np.argmax(np.where(np.isfinite(episodes.value), episodes.value, -np.inf)))
        constant_input = task.mid_range + share[best_episode] * task.half_range
        return _hold_last_state(episodes.states[best_episode]), np.tile(constant_input, (problem.N, 1))

    return guess


def _hold_last_state(states: np.ndarray) -> np.ndarray:
    """Return ``states`` (N+1, nx), with states from the first non-finite state on replaced by the state before it."""
    finite = np.isfinite(states).all(axis=1)
    last = len(states) - 1 if finite.all() else int(np.argmin(finite)) - 1
    return states[np.minimum(np.arange(len(states)), last)]


MOTION_TOLERANCE = 1e-4
"""Largest difference between a guess and the rollout of its inputs, in sizes of states, that counts as zero."""


@dataclass(frozen=True)
class BestPlan:
    """The best plan found for an episode from one start, under the exact law.

    ``planned_return`` is the return of the planned trajectories. ``replayed_return`` is the return of an
    episode in which the planned inputs are applied step by step under the exact law, until the episode ends
    after ``lived`` steps. ``solution`` contains the trajectories, the certificate, the referee's verdict and,
    in ``others``, the results of all guesses. A certified plan is a local optimum, which only bounds the returns
    of nearby plans. Another guess may lead to a better plan, and a policy may be better.
    """

    solution: Solution
    replayed_return: float
    lived: int

    @property
    def planned_return(self) -> float:
        """Return of the planned trajectories, which is minus the cost of the solution."""
        return -self.solution.cost

    @property
    def certified(self) -> bool:
        """Whether the plan is certified stationary (:mod:`ocp.judge.certificate`)."""
        return self.solution.success

    @property
    def description(self) -> str:
        """Sentence with the plan's return, its certificate, the replay's return, and the referee's verdict."""
        solution, steps = self.solution, self.solution.problem.N
        certificate_words = ", ".join(
            word for word in (solution.certificate.stationarity, solution.certificate.kind) if word
        )
        status_words = (
            f"certified stationary ({certificate_words}), which is a local optimum at most"
            if self.certified
            else f"not certified ({solution.status.value})"
        )
        return (
            f"best plan found: return {self.planned_return:.6g}, {status_words}; replayed under the exact law"
            f" {self.replayed_return:.6g} over {self.lived} of {steps} steps; before the referee, with"
            f" {-solution.referee.cost:.6g}: {solution.referee.word}"
        )


def best_plan(
    task: Task,
    x0: np.ndarray,
    *guesses: Guess,
    settings: dict[str, Any] | None = None,
) -> BestPlan:
    """Plan an episode from ``x0`` (nx,) by direct transcription under the exact law.

    The search starts at each of ``guesses``, by default at the problem's initial guess. From a guess that is a
    motion under the exact law, the problem is solved with the contact modes of the guess fixed, and the
    solution is then improved locally. From other guesses, or if this fails, it is solved by the default route.
    The best certified plan is returned or, if none is certified, the best uncertified plan. ``settings`` are passed
    to :func:`ocp.solve`.

    Raises the errors of :func:`~ocp.learning.planned.planned_problem`.
    """
    problem = planned_problem(task, x0)
    session = new_session(problem, EXACT, settings=settings)
    p = problem.parameters.values
    initial_guesses = [guess(problem, p) for guess in guesses] or [problem.initial_guess(p)]
    solutions = []
    for number, guess in enumerate(initial_guesses):
        outcome = _polished_motion(session, guess)
        if outcome is None:
            outcome = session.solve(guess=guess, number=number)
        solutions.append(judge_outcome(session, outcome, seed=0))
    best_solution = best_of(session, solutions)
    replay = (best_solution.data[name].values[0] for name in ("x_replay", "u_replay"))
    return BestPlan(best_solution, *episode_return(task, *replay))


def _polished_motion(session: Session, guess: InitialGuess) -> RouteResult | None:
    """Return a plan improved from a guess that is a motion; None if it is no motion or no solution was found."""
    states, inputs = guess
    problem = session.problem
    rollout, unsolved = roll_on(session.evaluation, inputs[None], session.step)
    differences = np.abs(rollout.x[0] - states) / problem.scales.x
    if unsolved is not None or not np.all(differences <= MOTION_TOLERANCE):
        return None
    homotopy = Homotopy(session.nlp_of, session.solver, session.values)
    branches, nlp = Branches(homotopy), session.judging_nlp()
    branch_solution = branches.solve_branch(Point(pack_rollout(nlp, rollout, None)))
    if branch_solution is None:
        return None
    return RouteResult(branches.improve(branch_solution), nlp, True, homotopy.trace)


def episode_return(task: Task, states: np.ndarray, inputs: np.ndarray) -> tuple[float, int]:
    """Return the return of an episode with ``states`` (N+1, nx) and ``inputs`` (N, nu), and its number of steps.

    The episode ends at the first state in which ``Task.done`` holds, or before the first non-finite state;
    later rewards do not count. The task's own parameters are used.
    """
    p, n = task.parameters.values, len(inputs)
    finite = np.isfinite(states).all(axis=1)
    solved = n if finite.all() else max(int(np.argmin(finite)) - 1, 0)
    has_ended = BatchFunction(task.ends, "numpy", 1)(states[: solved + 1], p)[:, 0] != 0
    lived = int(np.argmax(has_ended)) if has_ended.any() else solved
    if not lived:
        return 0.0, 0
    counted = states[:lived], inputs[:lived], states[1 : lived + 1]
    total = float(BatchFunction(task.rewards, "numpy", 1)(*counted, p).sum())
    if lived == n and not has_ended.any():
        total += float(task.finals(states[-1], p))
    return total, lived


MARGIN = 1e-6
"""Lower bound of ``Task.lasts`` in a plan, in its units. An episode ends at a value of 0, and a solver satisfies
constraints only to within 1e-8."""


def planned_problem(task: Task, x0: np.ndarray, scaling: Scaling | None = None) -> Problem:
    """Build the optimal control problem of an episode of full length that starts at ``x0`` (nx,).

    The cost is minus the return ``sum_t reward(x_t, u_t, x_{t+1}) + final(x_N)``, t < N. A reward ``a(x_{t+1})
    + b(x_t, u_t)`` becomes the stage cost ``-a(x_t) - b(x_t, u_t)`` and the terminal cost ``-a(x_N) -
    final(x_N) + a(x_0)``, which have the same sum. The constraints ``Task.lasts``, which keep the episode
    running, apply to all states before the last, and to the last if there is a final reward. Plans therefore
    never end early.

    Raises :class:`~ocp.errors.InputError` if x0 is not of size nx or the episode ends at x0, if the reward is not a
    sum of this form, and if ``done`` depends on x but ``lasts`` is not given.
    """
    system = task.system
    start = np.asarray(x0, dtype=float)
    if start.shape != (system.nx,) or not np.isfinite(start).all():
        raise InputError(
            f"{task.name}: a plan starts at {system.nx} finite numbers, one a state, got"
            f" {np.array2string(start, threshold=8)}"
        )
    if bool(task.ends(start, task.parameters.values)):
        raise InputError(f"{task.name}: an episode from this start ends before its first step; give another")
    next_state_reward, step_reward = _split_reward(task, start)
    final = ca.SX(task.final)
    lasting = _survival_constraint(task)
    return Problem(
        name=task.name,
        system=system,
        N=task.horizon,
        stage_cost=-(next_state_reward + step_reward),
        terminal_cost=ca.substitute(next_state_reward, system.x, ca.DM(start)) - next_state_reward - final,
        x0=ca.SX(ca.DM(start)),
        parameters=task.parameters,
        u_lower=ca.SX(ca.DM(task.lower)),
        u_upper=ca.SX(ca.DM(task.upper)),
        path=lasting,
        terminal=() if final.is_zero() else lasting,
        scaling=scaling or Scaling(),
    )


def _split_reward(task: Task, start: np.ndarray) -> tuple[ca.SX, ca.SX]:
    """Split a task's ``reward = a(x_next) + b(x, u)`` into ``a(x)`` and ``b(x, u)``."""
    system, reward = task.system, ca.SX(task.reward)
    state_and_input = ca.vertcat(system.x, system.u)
    slope = ca.jacobian(reward, system.x_next)
    if ca.depends_on(slope, state_and_input):
        symbols = {str(symbol) for symbol in ca.symvar(slope)}
        mixed = ", ".join(str(symbol) for symbol in ca.symvar(state_and_input) if str(symbol) in symbols)
        raise InputError(
            f"{task.name}: the reward's term in x_next also depends on {mixed}, which a stage cost"
            " in (x, u) cannot express; write the reward as a(x_next) + b(x, u)"
        )
    reference_point = ca.vertcat(ca.DM(start), ca.DM(task.mid_range))
    next_state_reward = ca.substitute(reward, state_and_input, reference_point)
    constant = ca.substitute(next_state_reward, system.x_next, ca.DM(start))
    step_reward = ca.substitute(reward, system.x_next, ca.DM(start)) - constant
    return ca.substitute(next_state_reward, system.x_next, system.x), step_reward


def _survival_constraint(task: Task) -> tuple[Constraint, ...]:
    """Return the constraint that keeps an episode running, or an empty tuple if the task never ends early."""
    if task.lasts is None:
        if ca.depends_on(ca.SX(task.done), task.system.x):
            raise InputError(
                f"{task.name}: done depends on the state: give Task.lasts, the constraints that keep an episode running"
            )
        return ()
    margins = ca.SX(task.lasts)
    return (Constraint("episode goes on", margins, MARGIN, ca.inf),) if margins.numel() else ()
