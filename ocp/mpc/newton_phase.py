"""Phases that solve a quadratic program per sample and choose the step size by rollouts: base class, smoothed laws."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from ocp.mpc.constraint_rows import MET_TOLERANCE, PENALTIES, PENALTY_FALL
from ocp.mpc.horizon_qp import MAX_QP_ITERATIONS, TIGHT, Direction, HorizonQP, Tolerance
from ocp.mpc.linearised import Affine, LinearClosure, Linearised, linearise
from ocp.mpc.phase import Answer, Phase, Sample
from ocp.mpc.riccati import Regulator
from ocp.mpc.rollouts import CandidateRollouts
from ocp.mpc.stages import MIN_PENALTY, Plan, StageModel, StageValues

STEP_SHARES = (1.0, 0.5, 0.25, 0.06)
"""Step sizes of the candidates that are rolled out, each with the regulator's feedback."""

MAX_WARM_UP_PROGRAMS = 30
"""Maximum number of additional programs at the first sample, when the plan belongs to another law or state."""
FULL_STEP = 2
"""Index of the candidate with step size 1, after the plan without and with the regulator's feedback."""
ALL_SHARES = np.array([0.0] * FULL_STEP + [*STEP_SHARES])
"""Step sizes of all candidates."""
EXCHANGED = "contacts were exchanged"
"""Note on a sample whose quadratic program has sides exchanged, as the last program asked."""
UNFINISHED = "the quadratic program was stopped at the maximum number of iterations"
"""Note on a sample whose quadratic program was not finished."""
UNSOLVED = "the quadratic program was not solved"
"""Note on a sample whose quadratic program was not solved."""


class Prepared(NamedTuple):
    """A plan of n steps, its active set (n, pairs), its linearisation with this set, and the rows of the program.

    ``is_exchanged`` tells whether the set has sides exchanged, as the last program asked.
    """

    plan: Plan
    closed: np.ndarray
    lin: Linearised
    rows: Affine
    is_exchanged: bool


class PairExchange(NamedTuple):
    """Pairs (n, pairs) whose sides the next program exchanges, and the active set ``closed`` of the last program."""

    closed: np.ndarray
    pairs: np.ndarray

    def shifted(self, steps: int) -> PairExchange:
        """Return the exchange of a plan that is shifted by 0 or 1 steps; a step that is appended has none."""
        if not steps:
            return self
        closed, pairs = (np.concatenate([v[1:], v[-1:]]) for v in self)
        pairs[-1] = False
        return PairExchange(closed, pairs)


class NewtonPhase(Phase):
    """Phase that solves a quadratic program at the last plan and chooses the step size by exact rollouts.

    The program gives dx, du. Candidates are ``u + s du + K (x - x_plan - s dx)`` with s = 1, 1/2, 1/4, 0.06 and
    0, where K are the gains of the linear-quadratic regulator along the plan; for s = 0 there is also a
    candidate with K = 0. The candidate of lowest merit under the contact law is the next plan. So every plan is
    a rollout under the law, and no plan is worse than the shifted plan.
    """

    def __init__(
        self, model: StageModel, rollouts: CandidateRollouts, iterations: int = 1, budget: int | None = None
    ) -> None:
        self.model, self.rollouts, self.iterations, self.budget = model, rollouts, iterations, budget
        self.qp = HorizonQP(model, self.n_rows)
        self.tolerance, self.violated = TIGHT, False
        self.exchange: PairExchange | None = None
        self.regulator = Regulator(model.nx, model.nu, model.N)
        self.plan: Plan
        self.prepared: Prepared | None = None
        self.gain = np.zeros((model.nu, model.nx))

    @property
    @abstractmethod
    def n_rows(self) -> int:
        """Number of rows of the quadratic program at every step."""

    def active_set(self, plan: Plan) -> tuple[np.ndarray, bool]:
        """Return the active set (n, pairs) of a plan, and whether it is exchanged. Smoothed laws close no pair."""
        return np.zeros(plan.lam.shape, dtype=bool), False

    @abstractmethod
    def closure(self, plan: Plan, evaluated: StageValues, closed: np.ndarray) -> LinearClosure:
        """Return the contact law, linearised at a plan."""

    @abstractmethod
    def rows(self, lin: Linearised, closed: np.ndarray) -> Affine:
        """Return the rows (N, n_rows) that the program constrains to 0 or above."""

    def prepare(self, plan: Plan, sample: Sample) -> None:
        """Evaluate and linearise ``plan``, the last plan shifted to the time of the sample."""
        self.prepare_best([plan], sample)

    def prepare_best(self, plans: Sequence[Plan], sample: Sample) -> None:
        """Prepare the plan whose rollout from the measured state, with or without feedback, has the lowest merit."""
        self.programs = self.qp_iterations = 0
        if self.exchange is not None:
            self.exchange = self.exchange.shifted(sample.shift)
        starts = [one for one in (self._linearise(plan, sample) for plan in plans) if one is not None]
        best = 0
        if len(starts) > 1:
            candidates = [self._candidates(one.plan, None, one.lin) for one in starts]
            K, k = (np.concatenate(parts) for parts in zip(*candidates, strict=True))
            best = self.rollouts.roll_out(sample.x, K, k, sample.u_before, sample.bounds, sample.p).best // FULL_STEP
        self._start_from(starts[best] if starts else None, plans[0])

    def _start_from(self, prepared: Prepared | None, plan: Plan) -> None:
        """Store the start of the next program, or ``plan`` without linearisation; its exchange is tried only once."""
        self.prepared, self.exchange = prepared, None
        self.plan = plan if prepared is None else prepared.plan

    def _linearise(self, plan: Plan, sample: Sample) -> Prepared | None:
        """Return the linearisation of a plan of n <= N steps; None if one of its steps has none."""
        evaluated = self.model.evaluate(plan, sample.u_before, sample.p)
        plan.gap = evaluated.gap
        closed, is_exchanged = self.active_set(plan)
        with suppress(np.linalg.LinAlgError):
            lin = linearise(self.model, plan, evaluated, self.closure(plan, evaluated, closed))
            return Prepared(plan, closed, lin, self.rows(lin, closed), is_exchanged)
        return None

    def solve(self, prepared: Prepared, sample: Sample) -> Direction:
        """Solve the quadratic program; if rows are violated, solve it with separate slacks and larger penalties.

        After a violation the next sample begins with separate slacks, which have the same optimum without one.
        """
        best, smallest_violation = None, np.inf
        if not self.violated:
            best = self._run(prepared, sample, PENALTIES[0], self.tolerance)
            is_met = best.violation < max(MET_TOLERANCE, self.tolerance.residual)
            if not self.model.m or (best.solved and is_met):
                return best
        for penalty in PENALTIES:
            if self.is_spent:
                break
            direction = self._run(prepared, sample, penalty, TIGHT, separate=True)
            best = best if best is not None else direction
            if not direction.solved or not direction.violation < PENALTY_FALL * smallest_violation:
                break
            best, smallest_violation = direction, direction.violation
            if smallest_violation < MET_TOLERANCE:
                break
        self.violated = MET_TOLERANCE <= smallest_violation < np.inf
        assert best is not None
        return best

    @property
    def is_spent(self) -> bool:
        """Whether the sample's iterations have reached the budget."""
        return self.budget is not None and self.qp_iterations >= self.budget

    def _run(
        self, prepared: Prepared, sample: Sample, penalty: float, tolerance: Tolerance, *, separate: bool = False
    ) -> Direction:
        """Solve a quadratic program within the iterations that are left, and count both."""
        left = MAX_QP_ITERATIONS if self.budget is None else min(MAX_QP_ITERATIONS, self.budget - self.qp_iterations)
        step_bounds = (sample.bounds[0] - self.plan.u, sample.bounds[1] - self.plan.u)
        dx0 = sample.x - self.plan.x[0]
        accuracy = tolerance, left
        direction = self.qp.solve(prepared.lin, prepared.rows, dx0, step_bounds, penalty, accuracy, separate=separate)
        self.programs, self.qp_iterations = self.programs + 1, self.qp_iterations + direction.iterations
        return direction

    def feedback(self, sample: Sample) -> Answer:
        """Solve the program from the measured state, and return the best candidate among the rollouts."""
        return self._iterate(self._solve_program, sample, self.iterations - 1, 1e-9)

    def warm_up(self, sample: Sample) -> Answer:
        """Answer the first measurement: solve programs repeatedly, as long as they improve the plan."""
        return self._iterate(self.feedback, sample, MAX_WARM_UP_PROGRAMS, 1e-6)

    def _iterate(
        self, solve: Callable[[Sample], Answer], sample: Sample, max_iterations: int, tolerance: float
    ) -> Answer:
        """Solve; repeat up to ``max_iterations`` times from the new plan while the merit decreases by ``tolerance``.

        A program without a decrease is repeated once if an exchange of contacts remains to be tried.
        """
        answer = solve(sample)
        for _ in range(max_iterations):
            if answer.plan is None or answer.status == "kept" or self.is_spent:
                break
            has_exchange = self.exchange is not None
            self._start_from(self._linearise(answer.plan, sample), answer.plan)
            better = solve(sample)
            if better.merit < answer.merit - tolerance * abs(answer.merit):
                answer = better
            elif has_exchange or self.exchange is None:
                break
        return answer

    def _solve_program(self, sample: Sample) -> Answer:
        prepared, plan = self.prepared, self.plan
        if prepared is None:
            return self._keep_plan(sample, "a step of the plan has no linearisation")
        step = self.solve(prepared, sample)
        K, k = self._candidates(plan, step, prepared.lin)
        penalty = self._merit_penalty(step)
        rolled = self.rollouts.roll_out(sample.x, K, k, sample.u_before, sample.bounds, sample.p, penalty)
        if not np.isfinite(rolled.merit):
            return self._keep_plan(sample, "no candidate could be rolled out under the law")
        self.gain = K[1, -1]
        if step.solved:
            change = rolled.states[FULL_STEP] - plan.x - step.dx
            self.tolerance = Tolerance.of_error(float(np.abs(change / self.model.problem.scales.x).max()))
            self.choose_exchange(prepared, step)
        status = "kept" if not step.usable else "solved" if rolled.best >= FULL_STEP else "not improved"
        exchanged = EXCHANGED if prepared.is_exchanged else ""
        note = exchanged if step.solved else UNFINISHED if step.usable else UNSOLVED
        notes = [note, *(f"the plan violates {c.name}" for c in rolled.violated)]
        note = "; ".join(filter(None, notes))
        return Answer(rolled.plan.u[0], rolled.plan, status, note, rolled.merit, bool(rolled.violated))

    def choose_exchange(self, prepared: Prepared, step: Direction) -> None:
        """Choose the pairs whose sides the next program exchanges; by default none."""

    def _merit_penalty(self, step: Direction) -> float:
        """Return the penalty in the merit function: twice the largest multiplier of a constraint, but at least 100."""
        m, cost = self.model.m, self.model.problem.scales.cost
        largest = abs(step.rows[:, -m:]).max() if m and step.usable else 0.0
        return max(MIN_PENALTY, 2 * float(largest) / cost)

    def _keep_plan(self, sample: Sample, reason: str) -> Answer:
        u = np.clip(self.plan.u[0], *sample.bounds)
        return Answer(u, self.plan, "kept", f"{reason}; the previous plan is used")

    def _candidates(self, plan: Plan, step: Direction | None, lin: Linearised) -> tuple[np.ndarray, np.ndarray]:
        """Return K (S, n, nu, nx) and k (S, n, nu) of S candidates; the first two are the plan without and with K."""
        gains = self.regulator.gains(lin)
        if step is not None and step.usable:
            return self.rollouts.steer(gains, plan.x, plan.u, step.dx, step.du, ALL_SHARES)
        return self.rollouts.steer(gains, plan.x, plan.u, 0 * plan.x, 0 * plan.u, ALL_SHARES[:FULL_STEP])


class Relaxed(NewtonPhase):
    """Phase of Newton steps on the smoothed problem, with ``lam gap = mu`` linearised at the plan."""

    @property
    def n_rows(self) -> int:
        """Number of rows per step: the constraints only, since the law keeps forces and gaps positive."""
        return self.model.m

    def closure(self, plan: Plan, evaluated: StageValues, closed: np.ndarray) -> LinearClosure:
        """Return the closure ``lam gap = mu``, linearised at the plan."""
        return LinearClosure.from_product(plan, evaluated.mu, self.model.sizes)

    def rows(self, lin: Linearised, closed: np.ndarray) -> Affine:
        """Return the rows of path constraints and bounds, which must be 0 or above."""
        return lin.rows
