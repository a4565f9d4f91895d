"""From a smoothed plan to the exact law in shooting: roll it out, then solve its branch."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dynamics.contact import Step
from ocp.errors import NotConverged
from ocp.programs.program import Program
from ocp.programs.solver import Point, Result
from ocp.programs.status import Status
from ocp.rollout import Gains, roll_out
from ocp.routes.branches import Branches, polish
from ocp.routes.complementarity import improved
from ocp.routes.homotopy import Homotopy, HomotopyPath
from ocp.routes.outcome import Outcome, lower
from ocp.routes.rollout_starts import pack_rollout
from ocp.transcription.nlp import NLP


def plan_of(nlp: NLP, x: np.ndarray) -> tuple[np.ndarray | Gains, np.ndarray | None]:
    """Inputs or gains, and the start where that is chosen, out of an NLP's variables."""
    blocks = nlp.variables.unpack(x)
    plan = Gains(blocks["K"], blocks["k"]) if "K" in blocks else blocks["u"]
    return plan, blocks["x0"][:, 0] if "x0" in blocks else None


@dataclass(frozen=True)
class RolloutPolish:
    """Rolls plans out in ``target`` and solves their branches in ``direct``, by its own follower.

    The limit of smoothed optima is short of the exact one by the square root of the last mu. Hence
    the rolled-out point is put into ``direct``, whose contacts are fixed as they are and whose rest
    is solved (:func:`~ocp.routes.branches.polish`).
    """

    target: NLP
    direct: NLP
    step: Step
    follower: Homotopy

    def polish(self, source: NLP, plan: Result) -> tuple[Result, Result | None]:
        """Roll a plan of ``source`` out under the exact ``step`` and solve its branch.

        A plan that was solved in ``direct`` is on a branch already.

        The solved point's inputs, rolled out, are the answer where they cost no more. Then it is
        returned beside them: the same plan, with contacts that are exactly open or closed, which a
        rollout's are to the step solver's tolerance.
        """
        first, there = self._rolled_out(source, plan.point.x)
        if source is self.direct and plan.ok:
            return first, plan
        solved, _, worked = polish(
            self.follower, self.direct, replace(first, point=there), improving=False
        )
        if not worked:
            return first, None
        second, _ = self._rolled_out(self.direct, solved.point.x)
        return (second, solved) if second.f <= first.f + 1e-9 * abs(first.f) else (first, None)

    def along(self, follower: Homotopy, path: HomotopyPath, start: Point) -> Outcome:
        """Follow a path, solve the branches of its points, and improve the cheapest.

        Near a wide stage another branch may be cheaper than near the last one. The path ends where
        two of its points in turn end at one cost.
        """
        found: list[Result] = []

        def repeated(source: Program, result: Result) -> bool:
            assert isinstance(source, NLP)
            if not result.ok:
                return False
            try:
                solved = self.polish(source, result)[1]
            except NotConverged:
                return False
            if solved is None:
                return False
            found.append(solved)
            one, other = found[-2:] if len(found) > 1 else (solved, None)
            return other is not None and not (lower(one, other) or lower(other, one))

        result, program, finished = follower.follow(replace(path, complete=repeated), start)
        if not found:
            return Outcome(result, program, finished, follower.trace)
        best = improved(Branches(self.follower), min(found, key=lambda one: one.f))
        return Outcome(best, self.direct, True, follower.trace)

    def _rolled_out(self, nlp: NLP, x: np.ndarray) -> tuple[Result, Point]:
        values = self.follower.values
        plan, start = plan_of(nlp, x)
        gains = plan if isinstance(plan, Gains) else None
        rolled = roll_out(self.target.problem, plan, values, self.step, start)
        there = Point(pack_rollout(self.target, rolled, gains))
        p = self.target.parameter_vector(values)
        answer = Result.at(self.target, there, p, Status.SOLVED, "rolled out")
        return answer, Point(pack_rollout(self.direct, rolled, gains))
