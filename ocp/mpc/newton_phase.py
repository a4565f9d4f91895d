"""Phases that solve a quadratic program per sample and choose the step size by rollouts: base class, smoothed laws."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ocp.mpc.constraint_rows import MET_TOLERANCE, PENALTIES, PENALTY_FALL
from ocp.mpc.horizon_qp import Direction, HorizonQP
from ocp.mpc.linearised import Affine, LinearClosure, Linearised, linearise
from ocp.mpc.phase import Answer, Phase, Sample
from ocp.mpc.riccati import Regulator
from ocp.mpc.rollouts import CandidateRollouts
from ocp.mpc.stages import MIN_PENALTY, Plan, StageModel, StageValues

STEP_SHARES = (1.0, 0.5, 0.25, 0.06)
"""Step sizes of the candidates that are rolled out, each with the regulator's feedback."""

MAX_WARM_UP_PROGRAMS = 30
"""Maximum number of additional programs at the first sample, when the plan belongs to another law or state."""
UNSOLVED = "the quadratic program was not solved"
"""Note on a sample whose quadratic program was not solved."""


class Proposal(NamedTuple):
    """An active set (N, n), the horizon linearised with this set, the program's rows, and its solution."""

    closed: np.ndarray
    lin: Linearised
    rows: Affine
    step: Direction


@dataclass
class Prepared:
    """A plan with the values and derivatives of its steps, its active set (N, n), and its linearisation."""

    plan: Plan
    evaluated: StageValues
    closed: np.ndarray
    lin: Linearised


class NewtonPhase(Phase):
    """Phase that solves a quadratic program at the last plan and chooses the step size by exact rollouts.

    The program gives dx, du. Candidates are ``u + s du + K (x - x_plan - s dx)`` with s = 1, 1/2, 1/4, 0.06 and
    0, where K are the gains of the linear-quadratic regulator along the plan; for s = 0 there is also a
    candidate with K = 0. The candidate of lowest merit under the contact law is the next plan. So every plan is
    a rollout under the law, and no plan is worse than the shifted plan.
    """

    def __init__(self, model: StageModel, rollouts: CandidateRollouts, iterations: int = 1) -> None:
        self.model, self.rollouts, self.iterations = model, rollouts, iterations
        self.qp, self.penalty = HorizonQP(model, self.n_rows), 0.0
        self.regulator = Regulator(model.nx, model.nu, model.N)
        self.plan: Plan
        self.prepared: Prepared | None = None
        self.gain = np.zeros((model.nu, model.nx))

    @property
    @abstractmethod
    def n_rows(self) -> int:
        """Number of rows of the quadratic program at every step."""

    def active_set(self, plan: Plan) -> np.ndarray:
        """Return the active set (N, n) of a plan. By default no pair is closed, as needed for smoothed laws."""
        return np.zeros(plan.lam.shape, dtype=bool)

    @abstractmethod
    def closure(self, plan: Plan, evaluated: StageValues, closed: np.ndarray) -> LinearClosure:
        """Return the contact law, linearised at a plan."""

    @abstractmethod
    def rows(self, lin: Linearised, closed: np.ndarray) -> Affine:
        """Return the rows (N, n_rows) that the program constrains to 0 or above."""

    def proposals(self, prepared: Prepared, sample: Sample) -> tuple[list[Proposal], str]:
        """Return the proposals to simulate, the best last (none if no program was solved), and a note."""
        proposal = self.propose(prepared.lin, prepared.closed, sample)
        return ([proposal], "") if proposal.step.solved else ([], UNSOLVED)

    def propose(self, lin: Linearised, closed: np.ndarray, sample: Sample) -> Proposal:
        """Solve the quadratic program with the active set ``closed`` (N, n)."""
        rows = self.rows(lin, closed)
        return Proposal(closed, lin, rows, self.solve(lin, rows, sample))

    def prepare(self, plan: Plan, sample: Sample) -> None:
        """Evaluate and linearise ``plan``."""
        self.plan, self.prepared, self.penalty = plan, None, 0.0
        evaluated = self.model.evaluate(plan, sample.u_before, sample.p)
        plan.gap = evaluated.gap
        closed = self.active_set(plan)
        with suppress(np.linalg.LinAlgError):
            self.prepared = Prepared(plan, evaluated, closed, self.linearise_plan(plan, evaluated, closed))

    def prepare_best(self, plans: Sequence[Plan], sample: Sample) -> None:
        """Prepare the plan whose rollout from the measured state, with or without feedback, has the lowest merit."""
        merits: list[tuple[float, Prepared]] = []
        for plan in plans:
            self.prepare(plan, sample)
            if self.prepared is not None and len(plans) > 1:
                K, k = self._candidates(plan, [], self.prepared.lin)
                rollout = self.rollouts.roll_out(sample.x, K, k, sample.u_before, sample.bounds, sample.p)
                merits.append((rollout[1], self.prepared))
        if merits:
            self.prepared = min(merits, key=lambda entry: entry[0])[1]
            self.plan = self.prepared.plan

    def linearise_plan(self, plan: Plan, evaluated: StageValues, closed: np.ndarray) -> Linearised:
        """Return the plan's linearisation with the contact eliminated by the active set ``closed``."""
        return linearise(self.model, plan, evaluated, self.closure(plan, evaluated, closed))

    @cached_property
    def separate_slack_qp(self) -> HorizonQP:
        """Quadratic program with a slack for each constraint, built on first use."""
        return HorizonQP(self.model, self.n_rows, separate=True)

    def solve(self, lin: Linearised, rows: Affine, sample: Sample) -> Direction:
        """Solve the quadratic program; if rows are violated, solve it with separate slacks and larger penalties.

        The chosen penalty is then used for all further programs of the sample, so that their optima are
        comparable.
        """
        step_bounds = (sample.bounds[0] - self.plan.u, sample.bounds[1] - self.plan.u)
        arguments = (lin, rows, sample.x - self.plan.x[0], step_bounds)
        if self.penalty:
            return self.separate_slack_qp.solve(*arguments, self.penalty)
        best = self.qp.solve(*arguments)
        if not self.model.m or (best.solved and best.violation < MET_TOLERANCE):
            return best
        smallest_violation = np.inf
        for penalty in PENALTIES:
            direction = self.separate_slack_qp.solve(*arguments, penalty)
            if not direction.solved or not direction.violation < PENALTY_FALL * smallest_violation:
                break
            best, smallest_violation, self.penalty = direction, direction.violation, penalty
        return best

    def feedback(self, sample: Sample) -> Answer:
        """Solve the program from the measured state, and return the best candidate among the rollouts."""
        return self._iterate(self._solve_program, sample, self.iterations - 1, 1e-9)

    def warm_up(self, sample: Sample) -> Answer:
        """Answer the first measurement: solve programs repeatedly, as long as they improve the plan."""
        return self._iterate(self.feedback, sample, MAX_WARM_UP_PROGRAMS, 1e-6)

    def _iterate(
        self, solve: Callable[[Sample], Answer], sample: Sample, max_iterations: int, tolerance: float
    ) -> Answer:
        """Solve; repeat up to ``max_iterations`` times from the new plan while the merit decreases by ``tolerance``."""
        answer = solve(sample)
        for _ in range(max_iterations):
            if answer.plan is None or answer.status == "kept":
                break
            self.prepare(answer.plan, sample)
            better = solve(sample)
            if not better.merit < answer.merit - tolerance * abs(answer.merit):
                break
            answer = better
        return answer

    def _solve_program(self, sample: Sample) -> Answer:
        prepared, plan = self.prepared, self.plan
        if prepared is None:
            return self._keep_plan(sample, "a step of the plan has no linearisation")
        try:
            proposals, note = self.proposals(prepared, sample)
        except np.linalg.LinAlgError:
            proposals, note = [], "a step has no linearisation after an exchange of contacts"
        K, k = self._candidates(plan, proposals, proposals[-1].lin if proposals else prepared.lin)
        best_plan, merit, index, violated = self.rollouts.roll_out(
            sample.x, K, k, sample.u_before, sample.bounds, sample.p, self._merit_penalty(proposals)
        )
        if not np.isfinite(merit):
            return self._keep_plan(sample, "no candidate could be rolled out under the law")
        self.gain = K[1, -1]
        status = "kept" if not proposals else "solved" if index > 1 else "not improved"
        notes = [*filter(None, [note]), *(f"the plan violates {constraint.name}" for constraint in violated)]
        return Answer(best_plan.u[0], best_plan, status, "; ".join(notes), merit, bool(violated))

    def _merit_penalty(self, proposals: list[Proposal]) -> float:
        """Return the penalty in the merit function: twice the largest multiplier of a constraint, but at least 100."""
        m, cost = self.model.m, self.model.problem.scales.cost
        largest = max((abs(proposal.step.rows[:, -m:]).max() for proposal in proposals if m), default=0.0)
        return max(MIN_PENALTY, 2 * float(largest) / cost)

    def _keep_plan(self, sample: Sample, reason: str) -> Answer:
        u = np.clip(self.plan.u[0], *sample.bounds)
        return Answer(u, self.plan, "kept", f"{reason}; the previous plan is used")

    def _candidates(self, plan: Plan, proposals: list[Proposal], lin: Linearised) -> tuple[np.ndarray, np.ndarray]:
        """Return K (S, N, nu, nx) and k (S, N, nu) of S candidates; the first two are the plan without and with K."""
        x, u = plan.x[:-1], plan.u
        regulator = self.regulator.gains(lin)
        gains, centres, inputs = [0 * regulator, regulator], [x, x], [u, u]
        for proposal in proposals:
            gains_of_proposal = regulator if proposal.lin is lin else self.regulator.gains(proposal.lin)
            for share in STEP_SHARES:
                gains.append(gains_of_proposal)
                centres.append(x + share * proposal.step.dx[:-1])
                inputs.append(u + share * proposal.step.du)
        K = np.array(gains)
        return K, np.array(inputs) - np.einsum("skij,skj->ski", K, np.array(centres))


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
