"""Tree search over pushes, which needs no guess; each plan is then solved with its contacts fixed.

Samples alone do not replace it. For scenes of ``tests/benchmarks/ocp/world_scenes.py`` at seed 0, cost and processor
time of a solve with pushes, which samples follow where the answer is poor, and of one with samples alone are:

- a box that comes back, 40 pairs: 0.0566, certified (156 s); 0.927, without a certificate (174 s);
- a box past a block, 40 pairs: 1.823 (116 s), from pushes 1.884, which does not survive; 1.823 (68 s);
- a triangle to a wall, 36 pairs: 0.0519 (126 s); 0.0519 (53 s);
- a quarter turn, 4 pairs: 0.0215 (99 s); 0.0215 (77 s).

Samples need compiled rollouts, whose graph takes over two minutes to build at 112 pairs.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from ocp.errors import InputError
from ocp.judge.route_report import SearchReport
from ocp.problem.policy import Feedback
from ocp.programs.solver import Status
from ocp.routes.homotopy import StageRecord
from ocp.routes.session import Session
from ocp.search.plan_solver import PlanSolver
from ocp.search.push_tree import TouchSearch, searchable
from ocp.search.sampling import can_sample
from ocp.search.search import Search, falls_short, penetrates_between_nodes
from ocp.solution import Solution

CANDIDATES = 4
"""Maximum number of the tree's plans that are solved locally, each only if none before it survives the referee."""
_MANY = 24
"""Number of contact pairs above which a scene is searched before the usual route."""


def check_search(session: Session) -> None:
    """Raise :class:`~ocp.errors.InputError` if neither pushes nor sampled inputs can be searched."""
    problem = session.problem
    if not (searchable(problem) or can_sample(problem)):
        raise InputError(
            f"{problem.name}: the search needs inputs, one scenario, a given start and a fixed duration;"
            " leave --search out"
        )
    if isinstance(session.policy, Feedback):
        raise InputError("the search finds inputs, not feedback gains; leave --search out")


@dataclass
class PushSearch(Search):
    """Tree search over pushes for plans that also prevent penetration between nodes (``swept``)."""

    def replacements(self) -> Iterable[Solution]:
        """Yield solutions that replace the usual route, if the search was requested or a scene has many corners.

        In such scenes relaxations of the many pairs take minutes, and end in the nearest local minimum.
        """
        return self._solutions(None) if self._goes_first else ()

    def is_needed(self, solution: Solution) -> bool:
        """Return whether to search by default after a ``solution`` that falls short."""
        return not self._goes_first and self._by_default and falls_short(solution)

    def solutions(self, answer: Solution) -> Iterator[Solution]:
        """Yield solutions in addition to the ``answer`` of the usual route."""
        return self._solutions(answer)

    def _solutions(self, answer: Solution | None) -> Iterator[Solution]:
        """Yield the usual route's solution of the swept problem, then the solutions of pushes.

        The route starts at ``answer``. It is omitted if ``answer`` does not penetrate bodies between nodes and, without
        an ``answer``, in a scene with many corners. Pushes are omitted if the solution that starts at ``answer`` does
        not fall short. Under a law other than the exact law, or with another method, the plans of pushes are guesses
        for the law's own route.
        """
        swept, few = self.session.as_swept(), self.session.problem.system.nlam <= _MANY
        moving = answer is not None and answer.status is not Status.NO_PROGRESS and penetrates_between_nodes(answer)
        if moving or (answer is None and few):
            guess = None
            if answer is not None:
                guess = answer.arrays["x"][0], answer.arrays["u"][0]
            swept_solution = self.judge(swept, swept.solve(guess=guess, progress=self.progress), self.seed)
            yield swept_solution.with_route(swept=True)
            if answer is not None and not falls_short(swept_solution):
                return
        if searchable(swept.problem):
            yield from self._pushed(swept)

    @property
    def _goes_first(self) -> bool:
        has_many_pairs = self._by_default and self.session.problem.system.nlam > _MANY
        return bool(self.session.search or (has_many_pairs and searchable(self.session.problem)))

    @property
    def _by_default(self) -> bool:
        """Whether the search may start although the user did not request it."""
        session = self.session
        plain = session.problem.scenarios.n == 1 and not isinstance(session.policy, Feedback)
        return session.search is None and session.complementary and plain

    def _pushed(self, swept: Session) -> Iterator[Solution]:
        tree = TouchSearch(swept.problem, swept.values, self.seed)
        nodes = []
        for number, nodes in enumerate(tree.rounds(), 1):
            if self.progress is not None:
                cost, nan = nodes[0].resting, np.nan
                self.progress(StageRecord("pushes", number, cost, nan, nan, tree.tried, nan, "searched"))
        self.report = SearchReport(self.seed, tree.tried, tree.rolled)
        plans = [plan for node in nodes[:CANDIDATES] if (plan := tree.rollout(tree.padded_inputs(node))) is not None]
        plans.sort(key=lambda plan: plan.cost)
        solver = PlanSolver(
            swept,
            tree.rollout,
            self.judge,
            "push search",
            self.seed,
            self.progress,
            tried=self.report.plans,
            n_pushers=swept.problem.system.nu,
        )
        for plan in plans:
            for _, solution in solver.solve([plan]):
                yield solution.with_route(swept=True)
                if solution.certificate.certified and solution.referee.survives:
                    return
