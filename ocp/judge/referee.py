"""Referee: replay of a plan under the most exact contact model, and the decision whether the plan survives."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from dynamics.contact import Step
from ocp.judge.constraints import (
    Broken,
    Violation,
    broken_constraints,
    noticeable_violations,
    tolerance_sizes,
    travelled_ranges,
    violation_findings,
)
from ocp.judge.findings import Finding, make_finding
from ocp.judge.measures import Physics, Worst, measure
from ocp.judge.step_size import step_size_kind
from ocp.judge.step_solutions import differing_contacts, find_nonuniqueness
from ocp.problem.evaluation import Evaluation
from ocp.problem.problem import Problem
from ocp.problem.rollout import Gains, Rollout, StateFeedback, Unsolved, roll_on

REFINEMENT = 4
"""Factor by which h is divided in the refined replay."""
COST_SHARE = 0.1
"""Largest cost excess of a replay that survives, as a fraction of the plan's cost."""
STATE_SHARE = 0.1
"""Largest distance between states of the plan and of a replay that survives, in characteristic sizes."""
PENETRATION_SHARE = 0.1
"""Largest penetration in a replay that survives, at or between nodes, as a fraction of the characteristic gap.

With true gaps, penetration at nodes is only rounding error. Between nodes, the straight line penetrates corners by a
hundredth of the gap in rolling contacts, and passes through a whole body in the case of tunnelling.
"""
_LEAST_GAP = 1e-4
"""Minimum gap for judging, as a share of the characteristic gap."""
NO_GEOMETRY = "no geometry"
"""Note of a report on a system without geometry, which has no referee."""


@dataclass(frozen=True)
class Referee:
    """Replay of a plan under the most exact contact model of its system, at the same h, and its cost.

    If a step was not solved, ``failed`` describes that step, and ``cost`` and the rest of
    ``replay`` are NaN. ``refined`` is the replay at h/4, in which every input is held over four steps;
    it has the problem's nodes, over which its cost is summed. If ``refined`` is None or ended
    early, ``refined_note`` says why. ``note`` names features that the referee's model has and the
    problem's model lacks; it is None for a system without geometry, whose own model is replayed.
    """

    replay: Rollout
    cost: float
    failed: Unsolved | None
    note: str | None
    refined: Rollout | None
    refined_note: str

    @property
    def refined_cost(self) -> float:
        """Cost at h/4, NaN if there is no replay at h/4."""
        return math.nan if self.refined is None else self.refined.cost


def referee_replay(evaluation: Evaluation, inputs: np.ndarray | StateFeedback, x0: np.ndarray) -> Referee:
    """Return the replay of ``inputs`` (S or 1, N, nu), or a policy, from x0 (S, nx) under the referee's model.

    A step without a solution is reported in ``failed``, not raised.
    """
    problem = evaluation.problem
    replay, failed = roll_on(evaluation, inputs, problem.referee_step, x0)
    refined, why = refined_replay(evaluation, inputs, x0)
    return Referee(replay, replay.cost, failed, problem.system.referee_note, refined, why)


def refined_replay(
    evaluation: Evaluation, inputs: np.ndarray | StateFeedback, x0: np.ndarray, factor: int = REFINEMENT
) -> tuple[Rollout | None, str]:
    """Return the replay at h / ``factor`` under the referee's model, at the problem's nodes, and a note.

    The note says why the replay ended early, and is "" otherwise. If h cannot be refined, the
    replay is None and the note says why.
    """
    problem = evaluation.problem
    step_size = step_size_kind(problem.system)
    if step_size.kind == "fixed":
        return None, step_size.reason
    start, finer = np.array(x0, dtype=float), dict(evaluation.values)
    if step_size.kind == "parameter":
        finer[step_size.parameter] /= factor
    else:
        start[:, step_size.state] /= factor
    rolled, failed = roll_on(Evaluation(problem, finer), inputs, problem.referee_step, start, substeps=factor)
    x = rolled.x.copy()
    if step_size.kind == "state":
        x[:, :, step_size.state] *= factor
    costs = evaluation.trajectory_costs(x, rolled.u, rolled.impulses)
    return replace(rolled, x=x, costs=costs), "" if failed is None else str(failed)


@dataclass(frozen=True)
class RefereeReport:
    """Outcome of a plan under the referee's contact model, as runs store it.

    ``cost`` is the cost of the replay, and ``gap`` the largest difference of its states from the plan.
    ``note`` names features that the referee's model has and the problem's model lacks, and is
    :data:`NO_GEOMETRY` if there is no replay. ``refined_cost`` is the cost at h/4, or NaN for the reason
    in ``refined_note``. The largest penetration at nodes (``penetration``) and between them (``between``), and the
    largest true distance at which a normal force acts (``force_distance``), all [m], are those of the plan;
    ``replay_penetration`` and ``replay_between`` are those of the replay. ``broken`` are the constraints that the
    replay violates. ``nonuniqueness`` describes a step of the plan at which the model's contact has another
    solution ("" if none was found), and ``branch_cost`` is the cost of the plan's inputs with that solution.
    ``findings`` say why the replay at h fails, and ``refined_findings`` why the replay at h/4 fails; a list is empty if
    its replay succeeds.
    """

    cost: float = math.nan
    gap: float = math.nan
    note: str = NO_GEOMETRY
    refined_cost: float = math.nan
    refined_note: str = ""
    penetration: Worst | None = None
    between: Worst | None = None
    force_distance: Worst | None = None
    replay_penetration: Worst | None = None
    replay_between: Worst | None = None
    broken: list[Violation] = field(default_factory=list)
    nonuniqueness: str = ""
    branch_cost: float = math.nan
    findings: list[Finding] = field(default_factory=list)
    refined_findings: list[Finding] = field(default_factory=list)

    @classmethod
    def of_replay(
        cls, outcome: Referee, plan: Rollout, findings: list[Finding], refined_findings: list[Finding], **details: Any
    ) -> RefereeReport:
        """Return the report on a replay of ``plan``; ``details`` are the fields that ``outcome`` does not contain."""
        return cls(
            cost=outcome.cost,
            gap=float(np.abs(outcome.replay.x - plan.x).max()),
            note=outcome.note or NO_GEOMETRY,
            refined_cost=outcome.refined_cost,
            refined_note=outcome.refined_note,
            findings=findings,
            refined_findings=refined_findings,
            **details,
        )

    @property
    def survives_at_h(self) -> bool | None:
        """Whether the replay at h succeeds; None for a system without geometry."""
        return None if self.note == NO_GEOMETRY else not self.findings

    @property
    def survives(self) -> bool | None:
        """Whether the replays at h and, if h can be refined, at h/4 succeed; None for a system without geometry."""
        return self.survives_at_h and not self.refined_findings

    @property
    def reasons(self) -> list[str]:
        """Clauses that say why the replay at h fails."""
        return [finding.sentence for finding in self.findings]

    @property
    def refined_reasons(self) -> list[str]:
        """Clauses that say why the replay at h/4 fails."""
        return [finding.sentence for finding in self.refined_findings]

    @property
    def document(self) -> dict[str, Any]:
        """The report as a JSON-serialisable dict, with the values derived from its findings."""
        derived = ("survives", "survives_at_h", "reasons", "refined_reasons")
        return {**asdict(self), **{name: getattr(self, name) for name in derived}}

    @property
    def word(self) -> str:
        """Outcome as text: the plan survives, survives only at its step size, does not survive, or has no referee."""
        if self.survives_at_h and not self.survives:
            return "survives at this step only"
        return {True: "survives", False: "does not survive", None: "no referee"}[self.survives]


def referee_plan(
    evaluation: Evaluation, step: Step, plan: Rollout, gains: Gains | None = None
) -> tuple[RefereeReport, Referee]:
    """Return the referee's report on a plan that was made with ``step``, and the referee's replay.

    The plan's inputs, or its policy if it has one, are replayed from the plan's starts. Without geometry there is no
    referee, and the report has no costs.
    """
    problem = evaluation.problem
    refereed = referee_replay(evaluation, plan.u if gains is None else gains, plan.x[:, 0])
    other_solution, branch_cost = _other_solution(evaluation, plan, gains)
    if refereed.note is None:
        return RefereeReport(nonuniqueness=other_solution, branch_cost=branch_cost), refereed
    replay = refereed.replay
    planned = measure(evaluation, step, plan)
    replayed = measure(evaluation, problem.referee_step, replay)
    broken = broken_constraints(evaluation, replay, tolerance_sizes(problem, plan.x))
    report = RefereeReport.of_replay(
        refereed,
        plan,
        survival_findings(evaluation, plan, refereed, replayed, broken),
        quarter_step_findings(evaluation, plan, refereed),
        penetration=planned.penetration,
        between=planned.between,
        force_distance=planned.force_distance,
        replay_penetration=replayed.penetration,
        replay_between=replayed.between,
        broken=[entry.violation for entry in broken],
        nonuniqueness=other_solution,
        branch_cost=branch_cost,
    )
    return report, refereed


def _other_solution(evaluation: Evaluation, plan: Rollout, gains: Gains | None) -> tuple[str, float]:
    """Return a clause on a step at which contact has another solution, and the plan's cost with that solution.

    Of several other solutions, the solution of the replay is reported, or else the solution of highest cost. The
    result is ``("", nan)`` if no step has another solution; the cost is NaN if the motion cannot be simulated
    to the end.
    """
    problem, nonuniqueness = evaluation.problem, find_nonuniqueness(evaluation, plan)
    if nonuniqueness is None:
        return "", math.nan
    k, s, step = nonuniqueness.step, nonuniqueness.scenario, problem.exact_step
    inputs = plan.u[[s]] if gains is None else gains
    rolled, _ = roll_on(evaluation, inputs, step, nonuniqueness.x_next, first=k + 1)
    x, u, lam = rolled.x, rolled.u, rolled.lam
    x[:, : k + 1], u[:, : k + 1] = plan.x[s, : k + 1], plan.u[s, : k + 1]
    lam[:, :k], lam[:, k] = plan.lam[s, :k], nonuniqueness.lam
    costs = Rollout.from_trajectories(evaluation, step, x, u, lam, rolled.gap).costs
    solution = 0 if nonuniqueness.replayed else int(np.nan_to_num(costs, nan=-np.inf).argmax())
    distances = np.abs(nonuniqueness.x_next[solution] - plan.x[s, k + 1])
    i = int((distances / problem.scales.x).argmax())
    signal, cost = problem.system.states[i], float(costs[solution])
    contacts = ", ".join(differing_contacts(problem, plan.lam[s, k], nonuniqueness.lam[solution]))
    main = make_finding(
        "forces-not-unique",
        step=k,
        contacts=contacts,
        state=signal.name,
        distance=f"{distances[i]:.2g} {signal.unit.removeprefix('1')}".rstrip(),
        negation="" if nonuniqueness.replayed else " not",
        consequence=f"costs {cost:.6g}" if math.isfinite(cost) else "cannot be followed to the end",
        planned=plan.costs[s],
    )
    if nonuniqueness.steps <= 1:
        return main.sentence, cost
    return f"{main.sentence}; {make_finding('more-steps-not-unique', count=nonuniqueness.steps - 1).sentence}", cost


def tolerance_gap(problem: Problem, x: np.ndarray) -> float:
    """Return the characteristic gap [m] for judging a plan x (S, N+1, nx), at most a third of its range of lengths."""
    ranges = travelled_ranges(problem, x)
    lengths = [size for size, signal in zip(ranges, problem.system.states, strict=True) if signal.unit == "m"]
    gap = problem.scales.gap
    return float(np.clip(min(lengths, default=np.inf) / 3, _LEAST_GAP * gap, gap))


def survival_findings(
    evaluation: Evaluation, plan: Rollout, outcome: Referee, physics: Physics, broken: Sequence[Broken]
) -> list[Finding]:
    """Return findings on why a refereed plan does not survive; the list is empty if it survives.

    The plan survives if every step of the replay was solved, and the replay costs at most :data:`COST_SHARE` more
    than the plan, keeps every state within :data:`STATE_SHARE`, every constraint within
    :data:`~ocp.judge.constraints.CONSTRAINT_SHARE` and penetration within :data:`PENETRATION_SHARE` of the problem's
    characteristic sizes, which are limited by the plan's own motion (:func:`~ocp.judge.constraints.tolerance_sizes`,
    :func:`tolerance_gap`). ``physics`` and ``broken`` are those of the replay. Constant terms of the cost do not
    count (:meth:`~ocp.problem.evaluation.Evaluation.cost_share`).
    """
    problem, cost_excess = evaluation.problem, evaluation.cost_share(outcome.cost - plan.cost, plan.cost)
    differences = np.abs(outcome.replay.x - plan.x)
    shares = differences / tolerance_sizes(problem, plan.x)
    largest_share = float(shares.max())
    reasons = []
    if outcome.failed is not None:
        reasons.append(make_finding("step-not-solved", step=outcome.failed.brief))
    elif not math.isfinite(largest_share):
        reasons.append(make_finding("states-not-finite"))
    elif not math.isfinite(outcome.cost):
        reasons.append(make_finding("replay-cost-not-finite"))
    if cost_excess > COST_SHARE:
        reasons.append(make_finding("costs-more", cost=outcome.cost, planned=plan.cost))
    if largest_share > STATE_SHARE:
        s, k, i = (int(v) for v in np.unravel_index(int(shares.argmax()), differences.shape))
        signal = problem.system.states[i]
        amount = float(differences[s, k, i])
        reasons.append(make_finding("state-differs", state=signal.name, amount=amount, unit=signal.unit, node=k))
    reasons += violation_findings(noticeable_violations(broken))
    tolerance = PENETRATION_SHARE * tolerance_gap(problem, plan.x)
    for deepest, location in ((physics.penetration, "node"), (physics.between, "step")):
        if deepest is not None and deepest.amount > tolerance:
            numbers = {"contact": deepest.contact, "amount": deepest.amount, "place": location, "step": deepest.step}
            reasons.append(make_finding("contact-penetrated", **numbers))
            break
    return reasons


def quarter_step_findings(evaluation: Evaluation, plan: Rollout, outcome: Referee) -> list[Finding]:
    """Return findings on why the replay at h/4 fails; the list is empty if it succeeds or is missing.

    The replay succeeds if every step was solved, and it costs at most :data:`COST_SHARE` more than the plan, and keeps
    constraints within :data:`STATE_SHARE` and penetration within :data:`PENETRATION_SHARE`. States
    are not compared node by node: an impact that is a fraction of a step earlier changes a velocity completely, but
    the cost only slightly.
    """
    if outcome.refined is None:
        return []
    if outcome.refined_note:
        return [make_finding("replay-stops", note=outcome.refined_note)]
    return outcome_findings(evaluation, plan, outcome.refined)


def outcome_findings(evaluation: Evaluation, plan: Rollout, replay: Rollout) -> list[Finding]:
    """Return findings on why a replay, at any step size, fails by its cost, constraints or penetration.

    The limits are those of :func:`quarter_step_findings`. ``evaluation`` is that of the plan.
    """
    problem = evaluation.problem
    if not math.isfinite(replay.cost):
        return [make_finding("quarter-step-cost-not-finite")]
    reasons = []
    if evaluation.cost_share(replay.cost - plan.cost, plan.cost) > COST_SHARE:
        reasons.append(make_finding("costs-more-at-quarter-step", cost=replay.cost))
    broken = broken_constraints(evaluation, replay, tolerance_sizes(problem, plan.x))
    reasons += violation_findings(noticeable_violations(broken, STATE_SHARE))
    if (phi := evaluation.signed_distances(replay.x)) is not None:
        depth = -float(np.nanmin(phi, initial=0.0))
        if depth > PENETRATION_SHARE * tolerance_gap(problem, plan.x):
            reasons.append(make_finding("bodies-penetrate", amount=depth))
    return reasons
