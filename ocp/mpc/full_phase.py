"""The exact route at every sample: the complementarity problem, from the shifted solution."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ocp.errors import InputError
from ocp.mpc.newton_phase import NewtonPhase
from ocp.mpc.phase import Answer, Sample
from ocp.mpc.stages import Plan, StageModel
from ocp.programs.program import Layout
from ocp.programs.solver import Point
from ocp.routes.homotopy import RouteResult
from ocp.routes.session import Session
from ocp.transcription.nlp import trajectories


class Full:
    """Solve the whole problem, warm from the solution before, by the route that ``solve`` takes.

    Where that fails, ``softer`` answers, a phase of quadratic programs whose constraints are soft,
    and goes on as long as its plans violate any.
    """

    def __init__(self, session: Session, model: StageModel, first: RouteResult, softer: NewtonPhase) -> None:
        self.session, self.model, self.softer = session, model, softer
        self.nlp, self.point = first.nlp, first.result.point
        self.plan: Plan
        self.fresh, self.violated = True, False

    def prepare(self, plan: Plan, sample: Sample) -> None:
        """Keep the shifted plan for a solve that fails."""
        self.plan = plan

    def feedback(self, sample: Sample) -> Answer:
        """Solve from the shifted solution; where that fails, improve the shifted plan."""
        answer = self._softened(sample) if self.violated else None
        if answer is None or not answer.violated:
            solved = self._solved(sample)
            unsolved = isinstance(solved, str)
            answer = answer or self._softened(sample, solved) if unsolved else solved
        self.violated = answer.violated
        return answer

    def _softened(self, sample: Sample, reason: str = "") -> Answer:
        self.softer.prepare(self.plan, sample)
        answer = self.softer.feedback(sample)
        return replace(answer, why="; ".join(filter(None, (reason, answer.why))))

    def _solved(self, sample: Sample) -> Answer | str:
        """Answer by the problem with hard constraints, or say why it has none."""
        session, p = self.session, sample.p
        held = [n for i, n in enumerate(self.model.names) if np.ptp(p[:, i]) > 0]
        session.values |= dict(zip(self.model.names, p[0], strict=True))
        try:
            result = session.solve(self._shifted())
        except InputError as error:
            return str(error)
        nlp = result.nlp
        found = trajectories(nlp, result.result, nlp.parameter_vector(session.values))
        plan = Plan(found.x[0], found.u[0], found.lam[0], found.gap[0])
        if not (result.result.ok and plan.finite):
            return f"the solver ended with {result.result.status.value}"
        self.nlp, self.point = nlp, result.result.point
        why = f"the value of {', '.join(held)} at the first step holds throughout" if held else ""
        merit = self.model.merits(plan.x[None], plan.u[None], plan.lam[None], sample.u_before, p)[0][0]
        return Answer(plan.u[0], plan, "solved", why, float(merit))

    def _shifted(self) -> Point:
        """The solution before, one step later; itself at the first sample."""
        if self.fresh:
            self.fresh = False
            return self.point
        variables, constraints, point = self.nlp.variables, self.nlp.constraints, self.point
        x = shifted(variables, point.x)
        assert x is not None
        self.point = Point(x, shifted(variables, point.lam_x), shifted(constraints, point.lam_g))
        return self.point


def shifted(layout: Layout, vector: np.ndarray | None) -> np.ndarray | None:
    """Values of a program's blocks one step later; those of the last step are repeated."""
    if vector is None:
        return None
    blocks = {}
    for name, values in layout.unpack(vector).items():
        along = values.ndim >= 2 and values.shape[1] > 1
        moved = np.concatenate([values[:, 1:], values[:, -1:]], axis=1) if along else values
        blocks[name] = moved
    return layout.pack(blocks)
