"""Report on the route to a solution: stages, attempts, searches and refinements, with their costs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field


@dataclass(frozen=True)
class StageRecord:
    """One stage of a homotopy: the varied parameter (``label``), its ``value``, and the solver's result.

    ``evaluation_s`` is the part of ``seconds`` spent on evaluating the NLP and its derivatives.
    """

    label: str
    value: float
    cost: float
    complementarity: float
    residual: float
    iterations: int
    seconds: float
    status: str
    accepted: bool = True
    evaluation_s: float = 0.0


@dataclass(frozen=True)
class Attempt:
    """Attempt of a solve from one start: its index ``start``, status, costs, and whether it was ``chosen``.

    ``route`` is the name of the route, and ``seconds`` is the time in the solver.
    """

    start: int
    status: str = ""
    cost: float = math.nan
    exact_cost: float = math.nan
    referee_cost: float = math.nan
    iterations: int = 0
    chosen: bool = False
    route: str = ""
    seconds: float = 0.0


NOT_BETTER = "not better"
"""Status of a searched plan that was solved but not judged, since another solution costs less."""


@dataclass(frozen=True)
class SearchedPlan:
    """A plan found by a search, after a local solve.

    ``rolled_cost`` is the cost of its rollout, ``cost`` the cost of its solution; ``pushers`` are the
    positions of the pushers in the rollout, (N+1, nu), empty for other searches.
    """

    rolled_cost: float
    cost: float
    status: str
    survives: bool | None
    pushers: list[list[float]] = field(default_factory=list)


@dataclass(frozen=True)
class SearchReport:
    """Work of a search by pushes or by samples, and the plans that it solved.

    ``motions`` is the number of input sequences that were rolled out, ``steps`` their number of time steps in all.
    """

    seed: int
    motions: int
    steps: int
    plans: list[SearchedPlan] = field(default_factory=list)

    @classmethod
    def joined(cls, reports: Sequence[SearchReport]) -> SearchReport | None:
        """Return the work of several searches as one report, None without any."""
        if not reports:
            return None
        motions, steps = (sum(getattr(report, name) for report in reports) for name in ("motions", "steps"))
        return cls(reports[0].seed, motions, steps, [plan for report in reports for plan in report.plans])

    def __str__(self) -> str:
        """Return a sentence with the numbers of rollouts and solves."""
        judged = [plan for plan in self.plans if plan.status != NOT_BETTER]
        count, survivors = len(self.plans), sum(bool(plan.survives) for plan in judged)
        outcome = f"{survivors} survive" if judged else "none better"
        return (
            f"Search: {self.motions} input sequences rolled out, {self.steps} steps in all;"
            f" {count} {'plan' if count == 1 else 'plans'} solved, {outcome}."
        )


@dataclass(frozen=True)
class Level:
    """A plan at step size ``h`` [s] and N steps, and its cost when the referee replays it at h/2.

    ``agreed`` says whether the two costs differ by at most :data:`ocp.solve.refinement.AGREED`.
    """

    h: float
    N: int
    status: str
    cost: float
    replayed: float
    agreed: bool


@dataclass(frozen=True)
class Refinement:
    """Levels of a refinement that halves the step size; ``stopped`` says why it ended early, or is ""."""

    levels: list[Level]
    stopped: str = ""


@dataclass(frozen=True)
class Rung:
    """One remedy for a plan that does not survive, and the referee's result for it.

    ``planned`` is the cost of the remedy's plan of N steps of ``h`` [s], whose solve ended with ``status``. ``cost``
    and ``refined_cost`` are the costs of its inputs or its policy under the most exact contact model at h and at h/4,
    NaN if a replay ended early. A cost that is a sum over nodes, not an integral, is summed over the nodes of the
    first plan, so that rungs are comparable. ``survives`` is None for a rung that was not tried; ``note`` gives the
    reason, or says that a rung costs more at its own step size.
    """

    name: str
    h: float = math.nan
    N: int = 0
    status: str = ""
    planned: float = math.nan
    cost: float = math.nan
    refined_cost: float = math.nan
    survives: bool | None = None
    iterations: int = 0
    note: str = ""

    @property
    def most_exact_cost(self) -> float:
        """Cost under the most exact contact model at h/4, or at h if the step size is part of the model."""
        return self.refined_cost if math.isfinite(self.refined_cost) else self.cost

    @property
    def excess(self) -> float:
        """Difference of the costs at h/4 and at h."""
        return self.refined_cost - self.cost


@dataclass(frozen=True)
class DisturbedSurvival:
    """Number of draws of one ``disturbance`` that a solution survives, and median and largest cost of all draws."""

    disturbance: str
    survived: int
    draws: int
    median_cost: float = math.nan
    largest_cost: float = math.nan


@dataclass(frozen=True)
class Ladder:
    """Remedies that were tried until a plan survived; the first rung is the plan itself.

    ``chosen`` is the index of the rung of the returned solution. ``stopped`` says why the search for a surviving plan
    ended early, or is "". ``disturbed`` counts the disturbances that this solution survives; they are
    tried in addition to the most exact contact model (:mod:`ocp.judge.disturbances`). ``largest_cost`` is the largest
    cost at which a remedy counts as surviving (:func:`ocp.solve.comparable_cost.largest_surviving_cost`).
    """

    rungs: list[Rung]
    chosen: int = 0
    stopped: str = ""
    disturbed: list[DisturbedSurvival] = field(default_factory=list)
    largest_cost: float = math.nan

    @property
    def answer(self) -> Rung:
        """Rung of the returned solution."""
        return self.rungs[self.chosen]


@dataclass(frozen=True)
class RouteReport:
    """Route to a solution: the ``name`` of the route that found it, and the other attempts.

    ``attempts`` are the starts, if there were several. ``started_from`` is the content hash of the solution that the
    solve started from, or None; ``resumed`` is False if the solver did not converge from that solution and started
    cold with its trajectories as the guess. ``swept`` marks a problem that also limits penetration between nodes,
    ``most_exact`` a problem that was solved under the most exact contact model of its system
    (:attr:`ocp.problem.problem.Problem.most_exact`), ``controller`` one whose policy is a controller. ``search``,
    ``refinement`` and ``ladder`` are None if there was none. ``failures`` are the errors that ended other attempts.
    ``idle_attempts`` is the number of certified attempts if the best of them stands still, and 0 otherwise.
    ``audit_s`` [s] is the time of audit, certificate and referee.
    """

    name: str = ""
    attempts: list[Attempt] = field(default_factory=list)
    started_from: str | None = None
    resumed: bool = True
    swept: bool = False
    search: SearchReport | None = None
    failures: list[str] = field(default_factory=list)
    idle_attempts: int = 0
    refinement: Refinement | None = None
    ladder: Ladder | None = None
    most_exact: bool = False
    controller: bool = False
    audit_s: float = math.nan
