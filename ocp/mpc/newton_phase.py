"""What the phases of one quadratic program a sample share: direction, then exact rollouts."""

from __future__ import annotations

from abc import ABC, abstractmethod
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ocp.mpc.constraint_rows import FALL, MET, PENALTIES
from ocp.mpc.horizon_qp import Direction, HorizonQP
from ocp.mpc.linearised import Affine, Closure, Linearised, linearise
from ocp.mpc.phase import Answer, Sample
from ocp.mpc.riccati import Regulator
from ocp.mpc.rollouts import Roller
from ocp.mpc.stages import LEAST_PENALTY, Evaluated, Plan, StageModel

_SHARES = (1.0, 0.5, 0.25, 0.06)
"""Parts of a step that are rolled out, each with the regulator's gains around it."""


UNSOLVED = "the quadratic program was not solved"


@dataclass(frozen=True)
class Proposal:
    """A step of the plan, and the linearisation that its program had."""

    step: Direction
    lin: Linearised


@dataclass
class Prepared:
    """A plan with its steps evaluated, and linearised under the closure of its active set."""

    plan: Plan
    at: Evaluated
    closed: np.ndarray
    lin: Linearised


class NewtonPhase(ABC):
    """One quadratic program from the plan before, its step chosen among exact rollouts.

    A program gives dx, du. Of the candidates ``u + s du + K (x - x_plan - s dx)`` with s = 1, 1/2,
    1/4, 0.06 and 0, K the gains of the linear-quadratic regulator along the plan or zero, that of
    lowest merit under the law is the next plan. So every plan is a rollout of the law, and no
    sample is answered by a worse plan than the one before, shifted.
    """

    def __init__(self, model: StageModel, roller: Roller, iterations: int = 1) -> None:
        self.model, self.roller, self.iterations = model, roller, iterations
        self.qp, self.penalty = HorizonQP(model, self.n_rows), 0.0
        self.regulator = Regulator(model.nx, model.nu, model.N)
        self.plan: Plan
        self.prepared: Prepared | None = None
        self.gain = np.zeros((model.nu, model.nx))

    @property
    @abstractmethod
    def n_rows(self) -> int:
        """Rows of the program at every step."""

    def active(self, plan: Plan) -> np.ndarray:
        """The active set (N, n) of a plan; smoothed laws have none."""
        return np.zeros(plan.lam.shape, dtype=bool)

    @abstractmethod
    def closure(self, plan: Plan, at: Evaluated, closed: np.ndarray) -> Closure:
        """The linear closure of the contact at a plan."""

    @abstractmethod
    def rows(self, lin: Linearised, closed: np.ndarray) -> Affine:
        """Rows that stay at 0 or above, (N, n_rows)."""

    @abstractmethod
    def proposals(self, prepared: Prepared, sample: Sample) -> tuple[list[Proposal], str]:
        """Steps to roll out, those of solved programs, the best last; and what is to be told."""

    def prepare(self, plan: Plan, sample: Sample) -> None:
        """Evaluate and linearise ``plan``."""
        self.plan, self.prepared, self.penalty = plan, None, 0.0
        at = self.model.evaluate(plan, sample.u_before, sample.p)
        plan.gap = at.gap
        closed = self.active(plan)
        with suppress(np.linalg.LinAlgError):
            self.prepared = Prepared(plan, at, closed, self.linearised(plan, at, closed))

    def linearised(self, plan: Plan, at: Evaluated, closed: np.ndarray) -> Linearised:
        """The plan's steps with the contact eliminated."""
        return linearise(self.model, plan, at, self.closure(plan, at, closed))

    @cached_property
    def softer(self) -> HorizonQP:
        """The same program with a slack for each constraint."""
        return HorizonQP(self.model, self.n_rows, separate=True)

    def solve(self, lin: Linearised, rows: Affine, sample: Sample) -> Direction:
        """Return the program's step, with slacks and penalty of their own where it violates rows.

        These then hold for the sample's other programs, so that their optima compare.
        """
        given = (lin, rows, sample.x - self.plan.x[0], self.bounds_of_step(self.plan, sample))
        if self.penalty:
            return self.softer.solve(*given, self.penalty)
        best = self.qp.solve(*given)
        if not self.model.m or (best.solved and best.violation < MET):
            return best
        least = np.inf
        for penalty in PENALTIES:
            found = self.softer.solve(*given, penalty)
            if not found.solved or not found.violation < FALL * least:
                break
            best, least, self.penalty = found, found.violation, penalty
        return best

    def feedback(self, sample: Sample) -> Answer:
        """Solve the program from the measured state, and roll the candidates out."""
        answer = self._once(sample)
        for _ in range(self.iterations - 1):
            if answer.plan is None or answer.status == "kept":
                break
            self.prepare(answer.plan, sample)
            better = self._once(sample)
            if not better.merit < answer.merit - 1e-9 * abs(answer.merit):
                break
            answer = better
        return answer

    def _once(self, sample: Sample) -> Answer:
        prepared, plan = self.prepared, self.plan
        if prepared is None:
            return self._kept(sample, "a step of the plan has no linearisation")
        try:
            proposals, why = self.proposals(prepared, sample)
        except np.linalg.LinAlgError:
            proposals, why = [], "a step has no linearisation after an exchange of contacts"
        K, k = self._candidates(plan, proposals, proposals[-1].lin if proposals else prepared.lin)
        found, merit, which, off = self.roller.roll(
            sample.x, K, k, sample.u_before, sample.bounds, sample.p, self._price(proposals)
        )
        if not np.isfinite(merit):
            return self._kept(sample, "no candidate could be rolled out under the law")
        self.gain = K[1, -1]
        status = "kept" if not proposals else "solved" if which > 1 else "plan before"
        told = [*filter(None, [why]), *(f"the plan violates {one.name}" for one in off)]
        return Answer(found.u[0], found, status, "; ".join(told), merit, bool(off))

    def _price(self, proposals: list[Proposal]) -> float:
        """Penalty of the merit: twice the largest multiplier of a constraint, at least 100."""
        m, cost = self.model.m, self.model.problem.scales.cost
        largest = max((abs(one.step.rows[:, -m:]).max() for one in proposals if m), default=0.0)
        return max(LEAST_PENALTY, 2 * float(largest) / cost)

    def _kept(self, sample: Sample, reason: str) -> Answer:
        u = np.clip(self.plan.u[0], *sample.bounds)
        return Answer(u, self.plan, "kept", f"{reason}; the plan before goes on")

    def _candidates(self, plan: Plan, proposals: list[Proposal], lin: Linearised) -> tuple[np.ndarray, np.ndarray]:
        """Gains K (S, N, nu, nx) and k (S, N, nu): the plan without and with gains come first."""
        x, u = plan.x[:-1], plan.u
        regulator = self.regulator.gains(lin)
        gains, centres, inputs = [0 * regulator, regulator], [x, x], [u, u]
        for one in proposals:
            own = regulator if one.lin is lin else self.regulator.gains(one.lin)
            for share in _SHARES:
                gains.append(own)
                centres.append(x + share * one.step.dx[:-1])
                inputs.append(u + share * one.step.du)
        K = np.array(gains)
        return K, np.array(inputs) - np.einsum("skij,skj->ski", K, np.array(centres))

    def bounds_of_step(self, plan: Plan, sample: Sample) -> tuple[np.ndarray, np.ndarray]:
        """Bounds (N, nu) of du."""
        return sample.bounds[0] - plan.u, sample.bounds[1] - plan.u
