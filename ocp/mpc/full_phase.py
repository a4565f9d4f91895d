"""Feedback phase that solves the whole problem at every sample, warm-started from the shifted solution."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ocp.errors import InputError
from ocp.mpc.newton_phase import NewtonPhase
from ocp.mpc.phase import Answer, Phase, Sample
from ocp.mpc.stages import Plan, StageModel
from ocp.programs.layout import Layout
from ocp.programs.solver import Point
from ocp.routes.homotopy import RouteResult
from ocp.routes.session import Session
from ocp.transcription.nlp import trajectories


class Full(Phase):
    """Phase that solves the whole problem with the method of ``solve``, warm-started from the last solution.

    If the solve fails, the phase ``softer`` is used instead, which solves quadratic programs with soft
    constraints. It is also used at the following samples as long as its plans violate constraints.
    """

    def __init__(self, session: Session, model: StageModel, first: RouteResult, softer: NewtonPhase) -> None:
        self.session, self.model, self.softer = session, model, softer
        self.nlp, self.point = first.nlp, first.result.point
        self.plan: Plan
        self.is_first, self.violated = True, False

    def prepare(self, plan: Plan, sample: Sample) -> None:
        """Store the shifted plan, from which the phase ``softer`` starts if the solve fails."""
        self.plan, self.programs, self.qp_iterations = plan, 0, 0

    def feedback(self, sample: Sample) -> Answer:
        """Solve from the shifted solution; if the solve fails, improve the shifted plan with the phase ``softer``."""
        result = self._solve_softened(sample) if self.violated else None
        if result is None or not result.violated:
            solved = self._solve(sample)
            unsolved = isinstance(solved, str)
            result = result or self._solve_softened(sample, solved) if unsolved else solved
        self.violated = result.violated
        return result

    def _solve_softened(self, sample: Sample, reason: str = "") -> Answer:
        self.softer.prepare(self.plan, sample)
        result = self.softer.feedback(sample)
        self.programs, self.qp_iterations = self.softer.programs, self.softer.qp_iterations
        return replace(result, note="; ".join(filter(None, (reason, result.note))))

    def _solve(self, sample: Sample) -> Answer | str:
        """Return the answer with hard constraints, or a sentence that says why the solve failed."""
        session, p = self.session, sample.p
        varying = [n for i, n in enumerate(self.model.names) if np.ptp(p[:, i]) > 0]
        session.values |= dict(zip(self.model.names, p[0], strict=True))
        try:
            result = session.solve(self._shift_solution())
        except InputError as error:
            return str(error)
        nlp = result.nlp
        solution = trajectories(nlp, result.result, nlp.parameter_vector(session.values))
        plan = Plan(solution.x[0], solution.u[0], solution.lam[0], solution.gap[0])
        if not (result.result.ok and plan.finite):
            return f"the solver ended with {result.result.status.value}"
        self.nlp, self.point = nlp, result.result.point
        note = f"the value of {', '.join(varying)} at the first step holds throughout" if varying else ""
        merit = self.model.merits(plan.x[None], plan.u[None], plan.lam[None], sample.u_before, p)[0][0]
        return Answer(plan.u[0], plan, "solved", note, float(merit))

    def _shift_solution(self) -> Point:
        """Return the last solution shifted by one step, or unshifted at the first sample."""
        if self.is_first:
            self.is_first = False
            return self.point
        variables, constraints, point = self.nlp.variables, self.nlp.constraints, self.point
        x = shift_one_step(variables, point.x)
        assert x is not None
        self.point = Point(x, shift_one_step(variables, point.lam_x), shift_one_step(constraints, point.lam_g))
        return self.point


def shift_one_step(layout: Layout, vector: np.ndarray | None) -> np.ndarray | None:
    """Return a program's vector shifted by one step, with the last step repeated; None if ``vector`` is None."""
    if vector is None:
        return None
    blocks = {}
    for name, values in layout.unpack(vector).items():
        over_steps = values.ndim >= 2 and values.shape[1] > 1
        shifted_values = np.concatenate([values[:, 1:], values[:, -1:]], axis=1) if over_steps else values
        blocks[name] = shifted_values
    return layout.pack(blocks)
