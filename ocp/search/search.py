"""Base class of searches for answers in addition to the usual route's, and tests that decide whether to search on."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from ocp.judge.referee import PENETRATION_SHARE
from ocp.judge.route_report import SearchReport
from ocp.problem.evaluation import Evaluation
from ocp.problem.policy import Feedback
from ocp.programs.solver import Status
from ocp.routes.branches import ACTIVE_SET
from ocp.routes.homotopy import Progress, RouteResult
from ocp.routes.session import Session
from ocp.search.sampling import can_sample
from ocp.solution import Solution

FEW_PAIRS = 20
"""Number of contact pairs up to which searches go on after one of them found a better answer."""
DIVERGED_SHARE = 0.5
"""Relative difference of costs above which a replay diverges from its plan, or two minima differ much."""
IDLE_SHARE = 0.9
"""Share of the cost of standing still above which an answer idles."""
SAMPLED = "sampling"
"""Route name of solutions near sampled plans."""
OTHER_ROUTES = ("scholtes", "barrier start", "barrier contacts")
"""Route names of solutions by Scholtes's relaxation, from the barrier law's plan, and near its rollout."""
Judge = Callable[[Session, RouteResult, int], Solution]
"""Function from a session, the outcome of its solve and the seed to a judged solution."""


@dataclass
class Search(ABC):
    """Search for solutions of a session's problem; random choices depend only on ``seed``.

    ``report`` counts the rollouts and lists the solved plans; it is None before the search.
    """

    session: Session
    judge: Judge
    seed: int = 0
    progress: Progress | None = None
    report: SearchReport | None = field(default=None, init=False)

    def replacements(self) -> Iterable[Solution]:
        """Yield solutions that replace the usual route, which is followed only if there are none."""
        return ()

    @abstractmethod
    def is_needed(self, solution: Solution) -> bool:
        """Return whether to continue the search when ``solution`` is the best so far."""

    @abstractmethod
    def solutions(self, answer: Solution) -> Iterator[Solution]:
        """Yield solutions in addition to the best ``answer`` so far."""


def can_roll_out(session: Session) -> bool:
    """Return whether inputs alone determine a plan of a session's complementarity problem."""
    has_single_branch = session.complementary and session.step.branches == 1
    return has_single_branch and not isinstance(session.policy, Feedback) and can_sample(session.problem)


def idles(solution: Solution, share: float = IDLE_SHARE) -> bool:
    """Return whether an answer idles: it costs more than ``share`` times the cost of standing still.

    Both costs exclude constant terms.
    """
    constant = Evaluation(solution.problem, solution.values).least_cost
    idling = solution.idle_cost - constant
    return bool(idling > 0 and solution.cost - constant > share * idling)


def diverges(solution: Solution) -> bool:
    """Return whether an answer's exact replay costs much more than planned, as in an unstable motion."""
    if solution.record["contact"] != "exact":
        return False
    excess = replay_cost(solution) - solution.cost
    return bool(solution.cost_share(excess, solution.cost) > DIVERGED_SHARE)


def has_many_minima(solution: Solution) -> bool:
    """Return whether an answer costs much less than the first branch that its route solved.

    Samples then often find a still cheaper minimum.
    """
    branches = [stage.cost for stage in solution.stages if stage.label == ACTIVE_SET and stage.accepted]
    return bool(branches) and solution.cost_share(branches[0] - solution.cost, solution.cost) > DIVERGED_SHARE


def replay_cost(solution: Solution) -> float:
    """Return the cost of an answer's exact replay, or infinity if the replay failed."""
    cost = solution.audit.exact_cost
    return cost if np.isfinite(cost) else np.inf


def replay_limit(solution: Solution) -> float:
    """Return the cost below which another answer's replay is better.

    It is infinite for a plan in a scene that fails the referee at its own step, since any other plan precedes it.
    """
    return np.inf if solution.fails_at_its_step else replay_cost(solution)


def cost_to_beat(solution: Solution) -> float:
    """Return the cost below which another answer is better, or infinity if this answer has no certificate."""
    return replay_limit(solution) if solution.certificate.certified else np.inf


def is_poor(solution: Solution) -> bool:
    """Return whether an answer has no certificate, idles, diverges or, in a scene, fails the referee at its step."""
    return solution.fails_at_its_step or idles(solution) or diverges(solution) or not solution.certificate.certified


def is_doubtful(solution: Solution) -> bool:
    """Return whether a cheaper answer is likely: the answer is poor, stands still, or has many minima above it."""
    return is_poor(solution) or solution.status is Status.NO_PROGRESS or has_many_minima(solution)


def falls_short(solution: Solution) -> bool:
    """Return whether an answer has no certificate, does not survive the referee, or idles."""
    return is_poor(solution) or solution.referee.survives is False


def penetrates_between_nodes(solution: Solution) -> bool:
    """Return whether the plan penetrates anything between nodes by more than the referee tolerates."""
    deepest, depth = solution.referee.between, PENETRATION_SHARE * solution.problem.scales.gap
    return deepest is not None and deepest.amount > depth
