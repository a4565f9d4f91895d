"""Judgement of a plan, and its verdict, in which certificate and referee precede the solver's status."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from dynamics.systems import LAW_PREFIX
from ocp.errors import NotConverged
from ocp.judge.audit import Audit
from ocp.judge.certificate import UNJUDGED, Certificate
from ocp.judge.constraints import violation_findings
from ocp.judge.findings import Finding, compose_lines, join_findings, make_finding
from ocp.judge.jumps import jump_findings
from ocp.judge.referee import PENETRATION_SHARE, RefereeReport, tolerance_gap
from ocp.judge.route_report import Ladder, RouteReport, StageRecord
from ocp.labelled import LabelledArrays
from ocp.problem.evaluation import Evaluation
from ocp.problem.problem import Problem
from ocp.problem.rollout import Gains, StateFeedback
from ocp.problem.sizes import describe_sizes, doubtful_sizes
from ocp.programs.solver import TIMED_OUT, Status

if TYPE_CHECKING:
    import xarray as xr

Grade = Literal["survives", "certified", "failed"]
"""Grade of a plan: "survives" if it is certified and survives, also at h/4; "certified" if it does not survive, or its
certificate holds only between jumps of the problem's functions; "failed" otherwise. Shown in green, amber and red."""
_SAME_COST = 1e-5
"""Change of the cost under the exact law, in characteristic costs, that counts as zero."""
_NOTABLE_SHARE = 0.1
"""Difference, as a fraction of the cost or of the characteristic gap, above which it is reported."""
_SAME_SHARE = 1e-3
"""Relative cost difference below which standing still costs "as much" as the plan."""
_REPORTED_DEPTH = 0.3
"""Penetration between nodes, as a fraction of the tolerated depth, above which it is reported."""
_FAR_ABOVE = 10.0
"""Difference, in multiples of the cost, from which it is written as a cost, and not in per cent."""
_LARGE_MU = 0.5
"""Smallest mu, as a fraction of the characteristic mu, that a verdict reports as large."""
_FEASIBLE_LABELS = ("not-optimal", "undecided")
"""Statuses of unsuccessful plans whose survival is reported."""
_MOST_REASONS = 3
"""Maximum number of reasons in a verdict for a plan that does not survive."""


@dataclass(frozen=True)
class Judgement:
    """A plan, solved or not, and its judgement by audit, certificate and referee.

    ``certificate`` says whether the point is stationary for the problem as posed, ``referee`` how it replays
    under the most exact contact model, ``idle_cost`` the cost of standing still under the same law
    (:func:`~ocp.judge.idling.idle_cost`), ``undone`` findings on bodies that it does not touch and states
    that it does not move. ``record`` is the request as a JSON-serialisable dict: problem, contact, method, policy,
    solver, parameters, settings, seed. ``route`` describes the route to the solution and other attempts.
    ``unbounded`` is a clause on a ray along which the cost decreases without bound, or "". ``simulator`` and
    ``sensitivities``, a mapping from parameters, are results computed after the solve, as dicts, each with a
    ``sentence`` for the verdict.
    """

    arrays: LabelledArrays
    cost: float
    status: Status
    audit: Audit
    certificate: Certificate
    referee: RefereeReport
    idle_cost: float
    stages: list[StageRecord]
    iterations: int
    build_s: float
    solve_s: float
    record: dict[str, Any]
    problem: Problem
    values: dict[str, float]
    gains: Gains | None = None
    controller: StateFeedback | None = None
    route: RouteReport = field(default_factory=RouteReport)
    unbounded: str = ""
    undone: list[Finding] = field(default_factory=list)
    simulator: dict[str, Any] | None = None
    sensitivities: dict[str, dict[str, Any]] = field(default_factory=dict)

    @property
    def data(self) -> xr.Dataset:
        """The arrays as an xarray.Dataset."""
        return self.arrays.dataset

    @property
    def inputs(self) -> np.ndarray | StateFeedback:
        """Inputs of the plan (S, N, nu), or its policy: gains or a controller."""
        policy = self.gains if self.controller is None else self.controller
        return self.arrays["u"] if policy is None else policy

    @property
    def success(self) -> bool:
        """Whether audit and certificate accept the plan, whatever the solver reports."""
        return self.status is Status.SOLVED

    @property
    def grade(self) -> Grade:
        """Grade of the plan, which determines the colour of the verdict."""
        if not self.success:
            return "failed"
        return "survives" if self.referee.survives and not jump_findings(self.problem) else "certified"

    @property
    def headline(self) -> str:
        """First line of the verdict: status, cost under the law, the exact law and the referee, and survival."""
        status_text = self.status.value.partition(":")[0]
        first = f"{status_text.capitalize()}: cost {self.cost:.6g}"
        if not math.isfinite(self.cost):
            return f"{first}."
        referee, ending = self.referee, self.referee.word
        feasible = self.success or self.status.label in _FEASIBLE_LABELS
        if referee.survives is None or (ending.startswith("survives") and not feasible):
            ending = ""
        elif self.route.ladder is not None and referee.survives:
            ending = survival_of(self.route.ladder)
        elif ending != "does not survive":
            ending = ": at h/4 ".join([ending, *referee.refined_reasons[:1]])
        return ", ".join([first, _exact_cost(self), _referee_cost(self)]) + (f"; {ending}." if ending else ".")

    @property
    def findings(self) -> list[Finding]:
        """Findings that explain the headline, with their codes and numbers."""
        return list(_findings(self))

    @property
    def verdict(self) -> str:
        """Headline, followed by the findings, one sentence per line."""
        return "\n".join([self.headline, *compose_lines(self.findings)])

    def cost_share(self, change: float, cost: float) -> float:
        """Return a change of ``cost`` relative to the part of the cost that a plan can change."""
        return Evaluation(self.problem, self.values).cost_share(change, cost)


def _exact_cost(plan: Judgement) -> str:
    cost = plan.audit.exact_cost
    if math.isfinite(cost):
        return f"exact law {cost:.6g}"
    return "exact law not replayed" if plan.audit.replay_failed else "exact law cost not finite"


def _referee_cost(plan: Judgement) -> str:
    if plan.referee.survives is None:
        return "no referee"
    cost, gap = plan.referee.cost, plan.referee.gap
    if math.isfinite(cost):
        return f"referee {cost:.6g}"
    return "referee cost not finite" if math.isfinite(gap) else "referee not replayed"


def _findings(plan: Judgement) -> Iterator[Finding]:
    """Yield the findings in the order of their lines."""
    if not math.isfinite(plan.cost) and not plan.unbounded:
        yield make_finding("cost-not-finite")
        return
    yield from join_findings(_undone_findings(plan) if plan.success else _status_findings(plan))
    if plan.certificate.reason != UNJUDGED and not plan.unbounded:
        yield from plan.certificate.findings
        yield from jump_findings(plan.problem)
    if plan.route.idle_attempts:
        yield make_finding("standing-still", attempts=plan.route.idle_attempts)
    yield from join_findings(_model_findings(plan))
    yield from _ladder_findings(plan)
    yield from _referee_findings(plan)
    yield from join_findings(_replay_findings(plan))
    # The constraints that the exact replay violates are listed unless the referee lists violations.
    if plan.referee.word != "does not survive" and plan.audit.replay_broken:
        yield make_finding("exact-replay-violates")
        yield from join_findings(violation_findings(plan.audit.replay_broken), ", ", ", ")
    if plan.referee.nonuniqueness:
        yield Finding("forces-not-unique", sentence=plan.referee.nonuniqueness)
    yield from _size_findings(plan)
    yield from _route_findings(plan)
    if plan.simulator is not None:
        yield make_finding("simulator", sentence=plan.simulator["sentence"].removesuffix("."))
    for slope in plan.sensitivities.values():
        numbers = {name: number for name, number in slope.items() if name != "sentence"}
        yield Finding("sensitivity", numbers, slope["sentence"])
    solver = plan.record.get("solver", "ipopt")
    if not plan.success and solver != "ipopt":
        yield make_finding("other-solver", solver=solver)


def _has_no_forces(plan: Judgement) -> bool:
    return math.isnan(plan.audit.complementarity)


def _undone_findings(plan: Judgement) -> Iterator[Finding]:
    """Yield findings on parts of the task that a solved plan leaves undone, and on standing still at a similar cost."""
    yield from plan.undone
    gain = plan.idle_cost - plan.cost
    if plan.route.idle_attempts or not plan.cost_share(gain, plan.idle_cost) < _NOTABLE_SHARE:
        return
    share = plan.cost_share(gain, plan.cost)
    amount = f"{100 * abs(share):.2g} % {'more' if share > 0 else 'less'}"
    difference = amount if abs(share) >= _SAME_SHARE else "as much"
    yield make_finding("holding-still", difference=difference, cost=plan.idle_cost)


def _status_findings(plan: Judgement) -> Iterator[Finding]:
    """Yield findings on why a plan is not solved."""
    stuck = plan.status.label == "no-progress"
    if stuck and plan.audit.active_steps == 0 and not _has_no_forces(plan):
        yield make_finding("contacts-never-act")
    if plan.unbounded:
        yield Finding("unbounded", sentence=plan.unbounded)
    elif explanation := plan.status.value.partition(": ")[2]:
        yield make_finding("status", explanation=explanation)
    if stuck and len(plan.stages) < 2:
        yield make_finding("no-homotopy")


def _model_findings(plan: Judgement) -> Iterator[Finding]:
    """Yield findings on features that the model lacks, and on differences from its training data."""
    if _has_no_forces(plan):
        yield make_finding("no-contact-forces")
    if (gaps := plan.problem.system.gap_kind) is not None:
        yield make_finding("gaps", gaps=gaps)
    if learned_at := plan.record.get("learned_at"):
        differences = ", ".join(
            f"{name} = {trained:g}, not {current:g}" for name, (trained, current) in learned_at.items()
        )
        yield make_finding("training-data-differ", differences=differences)


def _referee_findings(plan: Judgement) -> Iterator[Finding]:
    """Yield findings on the referee's model, and on why the plan does not survive, at h or at h/4."""
    referee = plan.referee
    if referee.survives is None:
        yield make_finding("no-referee")
        return
    yield make_finding("referee", note=referee.note)
    if referee.word == "does not survive":
        yield make_finding("does-not-survive", "; ")
        yield from join_findings(referee.findings[:_MOST_REASONS], first=": ")
        yield from _reliance_findings(plan)
    difference = abs(referee.refined_cost - referee.cost)
    if referee.refined_reasons and referee.survives_at_h:
        yield make_finding("fails-at-quarter-step", "; ")
        yield from join_findings(referee.refined_findings[:_MOST_REASONS], first=" ")
    elif plan.cost_share(difference, referee.cost) > _NOTABLE_SHARE:
        yield make_finding("quarter-step-cost", "; ", cost=referee.refined_cost)
    penetration = referee.replay_between
    if referee.survives_at_h and penetration is not None:
        tolerance = PENETRATION_SHARE * tolerance_gap(plan.problem, plan.arrays["x"])
        if penetration.amount > _REPORTED_DEPTH * tolerance:
            numbers = {"contact": penetration.contact, "amount": penetration.amount, "step": penetration.step}
            yield make_finding("cuts-through", "; ", **numbers, tolerance=tolerance)


def survival_of(ladder: Ladder) -> str:
    """Return text on the rung by which a solution survives, such as "survives as planned"."""
    return f"survives with {ladder.answer.name}" if ladder.chosen else "survives as planned"


def _ladder_findings(plan: Judgement) -> Iterator[Finding]:
    """Yield findings on the remedy that made the solution survive, its cost, and disturbances that it also survives."""
    ladder = plan.route.ladder
    if ladder is None:
        return
    answer, first = ladder.answer, ladder.rungs[0]
    excess = answer.most_exact_cost - first.planned
    share = plan.cost_share(excess, first.planned)
    per_cent = float(f"{100 * abs(share):.2g}")
    amount = f"{abs(excess):.4g}" if abs(share) > _FAR_ABOVE else f"{per_cent:g} %"
    level = "as much as" if abs(share) < _SAME_SHARE else f"{amount} {'above' if share > 0 else 'below'}"
    remedy = answer.name if math.isnan(answer.refined_cost) else f"{answer.name} at h/4"
    if answer.survives and ladder.chosen:
        yield make_finding("survives-by", remedy=remedy, cost=answer.most_exact_cost, difference=level)
    elif not answer.survives:
        yield make_finding("no-rung-survives", remedy=remedy, cost=answer.most_exact_cost, difference=level)
    if ladder.stopped:
        yield make_finding("ladder-stopped", reason=ladder.stopped)
    if answer.survives and ladder.disturbed:
        counts = ", ".join(f"{row.survived} of {row.draws} under {row.disturbance}" for row in ladder.disturbed)
        yield make_finding("disturbed-survival", counts=counts)


def _reliance_findings(plan: Judgement) -> Iterator[Finding]:
    """Yield findings on forces at a distance and penetration that a plan which does not survive relies on."""
    least_distance = _NOTABLE_SHARE * plan.problem.scales.gap
    exact = plan.record.get("contact") == "exact"
    worst_places = {
        "acts-at-a-distance": plan.referee.force_distance if exact else None,
        "plan-penetrates": plan.referee.between,
    }
    for code, worst in worst_places.items():
        if worst is not None and worst.amount > least_distance:
            yield make_finding(code, "; ", contact=worst.contact, amount=worst.amount, step=worst.step)


def _replay_findings(plan: Judgement) -> Iterator[Finding]:
    """Yield findings on differences between the plan and its replay under the model's exact law, if noticeable."""
    exact_cost = plan.audit.exact_cost
    if plan.audit.replay_failed:
        yield make_finding("not-replayed", step=plan.audit.replay_failed)
        return
    if not math.isfinite(exact_cost):
        yield make_finding("exact-cost-not-finite")
        return
    change = abs(exact_cost - plan.cost)
    same = change <= _SAME_COST * plan.problem.scales.cost or plan.cost_share(change, plan.cost) <= _NOTABLE_SHARE
    other_branch = plan.cost_share(abs(plan.referee.branch_cost - exact_cost), exact_cost) <= _NOTABLE_SHARE
    if plan.certificate.reason == UNJUDGED or other_branch or same:
        return
    if plan.record.get("contact") == "exact":
        yield make_finding("unstable-motion")
        return
    yield make_finding("relies-on-smoothing", cost=exact_cost, planned=plan.cost)
    mu, typical_mu = plan.values.get(f"{LAW_PREFIX}mu", 0.0), plan.problem.scales.mu
    if mu >= _LARGE_MU * typical_mu:
        yield make_finding("mu-is-large", mu=mu, typical=typical_mu)


def _size_findings(plan: Judgement) -> Iterator[Finding]:
    """Yield findings on derived sizes that may affect the verdict, and on doubtful stated sizes."""
    problem = plan.problem
    ordinary = all(np.all(np.asarray(unit) == 1) for unit in vars(problem.natural).values())
    decided = plan.certificate.certified and plan.referee.survives is not False
    if not (ordinary and decided) and (sizes := describe_sizes(problem)):
        yield make_finding("derived-sizes", sizes=sizes)
    if not plan.certificate.certified and (doubts := doubtful_sizes(problem)):
        yield make_finding("doubtful-sizes", sizes=", ".join(doubts))


def _route_findings(plan: Judgement) -> Iterator[Finding]:
    """Yield findings on the route to the solution: refinement, time limits, warm start, failed attempts."""
    route = plan.route
    if route.refinement is not None:
        last, ending = route.refinement.levels[-1], route.refinement.stopped or "they agree"
        yield make_finding("step-refined", h=last.h, cost=last.cost, replayed=last.replayed, ending=ending)
    if count := sum(stage.status in TIMED_OUT for stage in plan.stages):
        yield make_finding("time-limit", count=count, runs=len(plan.stages))
    if not route.resumed:
        yield make_finding("not-resumed")
    without_answer = [failure for failure in route.failures if failure.startswith(NotConverged.__name__)]
    if count := len(without_answer):
        reason = without_answer[0].partition(": ")[2].strip("'")
        yield make_finding("attempts-without-answer", count=count, plural="s" * (count > 1), reason=reason)
    errors = [failure for failure in route.failures if failure not in without_answer]
    if count := len(errors):
        yield make_finding("attempts-failed", count=count, plural="s" * (count > 1), error=errors[0])
