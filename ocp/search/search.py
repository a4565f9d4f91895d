"""Base class of searches for answers in addition to the usual route's."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field

from ocp.judge.route_report import SearchReport
from ocp.problem.policy import Feedback
from ocp.routes.homotopy import Progress, RouteResult
from ocp.routes.session import Session
from ocp.search.sampling import can_sample
from ocp.solution import Solution

SAMPLED = "sampling"
"""Route name of answers near sampled plans."""
Judge = Callable[[Session, RouteResult, int], Solution]
"""Function from a session, the outcome of its solve and the seed to a judged solution."""


@dataclass
class Search(ABC):
    """Search for answers to a session's problem; its random choices depend on ``seed`` alone.

    ``report`` counts what was rolled out and lists the plans solved; None before the search.
    """

    session: Session
    judge: Judge
    seed: int = 0
    progress: Progress | None = None
    report: SearchReport | None = field(default=None, init=False)

    def replacements(self) -> Iterable[Solution]:
        """Yield answers that replace the usual route, which is followed only where there are none."""
        return ()

    @abstractmethod
    def wanted(self, solution: Solution) -> bool:
        """Return whether to search further when ``solution`` is the best one so far."""

    @abstractmethod
    def solutions(self, answer: Solution) -> Iterator[Solution]:
        """Yield answers in addition to the best ``answer`` so far."""


def can_roll_out(session: Session) -> bool:
    """Return whether inputs alone determine a plan of a session's complementarity problem."""
    plain = session.complementary and session.step.branches == 1
    return plain and not isinstance(session.policy, Feedback) and can_sample(session.problem)
