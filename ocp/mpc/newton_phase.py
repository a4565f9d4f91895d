"""Phases that solve a quadratic program per sample and choose the step size by rollouts: base class, smoothed laws."""

from __future__ import annotations

import warnings
from abc import abstractmethod
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np

from dynamics.batch.arguments import BatchWarning
from dynamics.batch.engines.compiler import CompilerError
from ocp.judge.constraint_rows import MET_TOLERANCE, PENALTIES, PENALTY_FALL
from ocp.mpc.compiled_sample import Outcome, PhaseSample
from ocp.mpc.horizon_qp import MAX_QP_ITERATIONS, TIGHT, Direction, HorizonQP, Tolerance
from ocp.mpc.linearised import Affine, LinearClosure, Linearised, linearise
from ocp.mpc.phase import Answer, Phase, Sample
from ocp.mpc.riccati import regulator_gains
from ocp.mpc.rollouts import FULL_STEP, STEP_SHARES, CandidateRollouts, Rolled
from ocp.mpc.stages import MIN_PENALTY, Plan, StageModel, StageValues

MAX_WARM_UP_PROGRAMS = 30
"""Maximum number of additional programs at the first sample, when the plan belongs to another law or state."""
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

    def shifted(self) -> PairExchange:
        """Return the exchange of a plan that is shifted by a step; a step that is appended has none."""
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

    constants: ClassVar[dict[str, float]] = {"EXCHANGES": 0, "ACTIVE_TOLERANCE": 0.0, "MIN_EXCHANGE_GAIN": 0.0}
    """Constants of the phase by their names in C."""
    product: ClassVar[bool] = True
    """Whether the law ``lam gap = mu`` is linearised."""

    def __init__(
        self, model: StageModel, rollouts: CandidateRollouts, iterations: int = 1, budget: int | None = None
    ) -> None:
        self.model, self.rollouts, self.iterations, self.budget = model, rollouts, iterations, budget
        self.tolerance, self.violated = TIGHT, False
        self.exchange: PairExchange | None = None
        self.plan: Plan
        self.prepared: Prepared | None = None
        self.is_prepared = False
        self.gain = np.zeros((model.nu, model.nx))
        try:
            self.compiled = PhaseSample(model, rollouts, self.constants, product=self.product)
        except CompilerError as error:
            # Without any compiler the controller says so; here the compiler failed on the sample alone.
            if rollouts.compiled is not None:
                warnings.warn(f"{error}; samples run on the numpy backend", BatchWarning, stacklevel=2)

    @cached_property
    def qp(self) -> HorizonQP:
        """Quadratic program of the phase without a C compiler."""
        return HorizonQP(self.model, self.n_rows)

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
        self.programs = self.qp_iterations = best = 0
        if sample.shift and self.compiled is not None:
            self.compiled.shift_exchange()
        elif sample.shift and self.exchange is not None:
            self.exchange = self.exchange.shifted()
        if len(plans) > 1:
            best = int(np.argmin([self._start_merit(plan, sample) for plan in plans]))
        self._start_from(plans[best], sample)

    def _start_from(self, plan: Plan, sample: Sample) -> None:
        """Linearise the plan from which the next program starts; an exchange is tried only once."""
        self.plan = plan
        if self.compiled is not None:
            self.is_prepared = self.compiled.prepare(plan, sample)
        else:
            self.prepared, self.exchange = self._linearise(plan, sample), None
            self.is_prepared = self.prepared is not None

    def _start_merit(self, plan: Plan, sample: Sample) -> float:
        """Return the merit of a plan's rollout from the measured state, with or without feedback."""
        if self.compiled is not None:
            return self.compiled.start_merit() if self.compiled.prepare(plan, sample) else np.inf
        prepared = self._linearise(plan, sample)
        return np.inf if prepared is None else self._roll_out(prepared, None, sample).merit

    @property
    def gains(self) -> np.ndarray:
        """Gains (n, nu, nx) of the regulator along the prepared plan."""
        if self.compiled is not None:
            return self.compiled.gains
        assert self.prepared is not None
        return regulator_gains(self.prepared.lin)

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
            has_exchange = self.has_exchange
            self._start_from(answer.plan, sample)
            better = solve(sample)
            if better.merit < answer.merit - tolerance * abs(answer.merit):
                answer = better
            elif has_exchange or not self.has_exchange:
                break
        return answer

    @property
    def has_exchange(self) -> bool:
        """Whether the next program exchanges sides of pairs."""
        return self.exchange is not None if self.compiled is None else self.compiled.has_exchange

    def _solve_program(self, sample: Sample) -> Answer:
        if not self.is_prepared:
            return self._keep_plan(sample, "a step of the plan has no linearisation")
        outcome = self._outcome(sample) if self.compiled is None else self._compiled_outcome(self.compiled)
        if outcome is None:
            return self._keep_plan(sample, "no candidate could be rolled out under the law")
        status = "kept" if not outcome.usable else "solved" if outcome.best >= FULL_STEP else "not improved"
        exchanged = EXCHANGED if outcome.is_exchanged else ""
        note = exchanged if outcome.solved else UNFINISHED if outcome.usable else UNSOLVED
        notes = [note, *(f"the plan violates {c.name}" for c in outcome.violated)]
        note = "; ".join(filter(None, notes))
        return Answer(outcome.plan.u[0], outcome.plan, status, note, outcome.merit, bool(outcome.violated))

    def _compiled_outcome(self, compiled: PhaseSample) -> Outcome | None:
        """Return the outcome of the compiled sample, and count its programs and iterations."""
        outcome = compiled.answer(None if self.budget is None else self.budget - self.qp_iterations)
        programs, iterations = compiled.counts
        self.programs, self.qp_iterations = self.programs + programs, self.qp_iterations + iterations
        return outcome

    def _outcome(self, sample: Sample) -> Outcome | None:
        """Return the outcome of the programs at the prepared plan without a C compiler."""
        prepared = self.prepared
        assert prepared is not None
        step = self.solve(prepared, sample)
        rolled = self._roll_out(prepared, step, sample)
        if not np.isfinite(rolled.merit):
            return None
        self.gain = self.gains[-1]
        if step.solved:
            change = rolled.states[FULL_STEP] - prepared.plan.x - step.dx
            self.tolerance = Tolerance.of_error(float(np.abs(change / self.model.problem.scales.x).max()))
            self.choose_exchange(prepared, step)
        return Outcome(*rolled[:4], step.solved, step.usable, prepared.is_exchanged)

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

    def _roll_out(self, prepared: Prepared, step: Direction | None, sample: Sample) -> Rolled:
        """Roll out the plan without and with feedback, and with shares of the step if there is one."""
        plan, gains = prepared.plan, regulator_gains(prepared.lin)
        penalty = MIN_PENALTY if step is None else self._merit_penalty(step)
        if step is not None and step.usable:
            K, k = self.rollouts.steer(gains, plan.x, plan.u, step.dx, step.du, STEP_SHARES)
        else:
            K, k = self.rollouts.steer(gains, plan.x, plan.u, 0 * plan.x, 0 * plan.u, STEP_SHARES[:FULL_STEP])
        return self.rollouts.roll_out(sample.x, K, k, sample.u_before, sample.bounds, sample.p, penalty)


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
