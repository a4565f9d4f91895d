"""The verdict in sentences: certificate and referee first, the solver's status last."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal

import numpy as np

from dynamics.systems import LAW_PREFIX
from ocp.judge.constraints import describe_violations
from ocp.judge.jumps import jump_findings
from ocp.judge.referee import PENETRATION_SHARE, tolerance_gap
from ocp.judge.route_report import Refinement
from ocp.problem.evaluation import Evaluation
from ocp.problem.sizes import describe_sizes, doubtful_sizes
from ocp.programs.solver import TIMED_OUT

if TYPE_CHECKING:
    from ocp.solution import Solution


Grade = Literal["survives", "certified", "failed"]
"""Certified and surviving, at h/4 too; certified only, or only between jumps of the problem's
functions; neither. Shown green, amber and red."""
_SAME = 1e-5
_NOTABLE, _DEEP = 0.1, 0.3
_BLURRED = 0.5
"""Share of the characteristic mu from which mu is as large."""
_FEASIBLE = ("not-optimal", "undecided")
"""Statuses of unsuccessful plans whose survival is reported."""


def verdict(found: Solution) -> str:
    """Return the headline, with every cost in it, and below it one finding a line."""
    return "\n".join([headline(found), *findings(found)])


def headline(found: Solution) -> str:
    """Status, cost under the law, the exact law and the referee, and survival."""
    word = found.status.value.partition(":")[0]
    first = f"{word.capitalize()}: cost {found.cost:.6g}"
    if not math.isfinite(found.cost):
        return f"{first}."
    parts = [first, _exact(found), _refereed(found)]
    referee, ending = found.referee, found.referee.word
    feasible = found.success or found.status.label in _FEASIBLE
    if referee.survives is None or (ending.startswith("survives") and not feasible):
        ending = ""
    elif ending != "does not survive":
        ending = ": at h/4 ".join([ending, *referee.refined_reasons[:1]])
    return ", ".join(part for part in parts if part) + (f"; {ending}." if ending else ".")


def _exact(found: Solution) -> str:
    cost = found.audit.exact_cost
    if math.isfinite(cost):
        return f"exact law {cost:.6g}"
    return "exact law not replayed" if found.audit.replay_failed else "exact law cost not finite"


def _refereed(found: Solution) -> str:
    if found.referee.survives is None:
        return "no referee"
    cost, gap = found.referee.cost, found.referee.gap
    if math.isfinite(cost):
        return f"referee {cost:.6g}"
    return "referee cost not finite" if math.isfinite(gap) else "referee not replayed"


def findings(found: Solution) -> list[str]:
    """Explain the headline, one sentence a finding."""
    unbounded = found.unbounded
    explained = unbounded or found.status.value.partition(": ")[2]
    if not math.isfinite(found.cost) and not unbounded:
        return [
            "The cost is NaN or infinite at the last iterate: give a guess with a finite cost, and"
            " bounds that keep the states where the cost is finite."
        ]
    forceless = math.isnan(found.audit.complementarity)
    if found.status.label == "no-progress":
        if found.audit.active_steps == 0 and not forceless:
            explained = f"the contacts never act; {explained}"
        if len(found.stages) < 2:
            explained += "; no homotopy was followed, whose smoothing feels contact from afar"
    lines = [] if found.success or not explained else [_sentence(explained)]
    if found.certificate.reason != UNJUDGED and not unbounded:
        lines.append(_sentence(found.certificate.sentence))
        lines += jump_findings(found.problem)
    if ways := found.route.idle_attempts:
        lines.append(f"Standing still is the best of {ways} solution attempts.")
    gaps = found.problem.system.gaps
    model = "" if gaps is None else f"the model's gaps are {gaps}"
    if forceless:
        model = "the law is learned from data and has no contact forces" + (model and f"; {model}")
    others = found.record.get("learned_at", {}).items()
    differs = ", ".join(f"{name} = {then:g}, not {now:g}" for name, (then, now) in others)
    model += f"; its training data have {differs}" if differs else ""
    parts = (model, _referee(found), _replay(found), _broken(found), found.referee.nonuniqueness)
    lines += [_sentence(line) for line in parts if line]
    if sizes := _derived_sizes(found):
        lines.append(sizes)
    if not found.certificate.certified and (doubts := doubtful_sizes(found.problem)):
        listed = ", ".join(doubts)
        lines.append(f"Of the stated sizes {listed}; leave them out of Scaling to derive them.")
    if found.route.refinement is not None:
        lines.append(_refined(found.route.refinement))
    if cut := sum(stage.status in TIMED_OUT for stage in found.stages):
        runs = f"{cut} of {len(found.stages)} runs of the solver"
        lines.append(f"The time limit stopped {runs}: without it the answer may differ.")
    if not found.route.resumed:
        lines.append(
            "The solver did not converge from the stored run; this is a cold solve with that run's"
            " trajectories as the guess."
        )
    if failures := found.route.failures:
        lines.append(
            f"{len(failures)} other solution attempt{'s' * (len(failures) > 1)} ended in an error"
            f" of the program ({failures[0]}); -v shows where."
        )
    if found.simulator is not None:
        lines.append(found.simulator["sentence"])
    slopes = found.sensitivities.values()
    lines += [_sentence(slope["sentence"]) for slope in slopes]
    solver = found.record.get("solver", "ipopt")
    if not found.success and solver != "ipopt":
        lines.append(f"The solver was {solver}, and not the default, ipopt.")
    return lines


UNJUDGED = "the point is not feasible"
"""The certificate's reason for a point that is not feasible."""


def _derived_sizes(found: Solution) -> str:
    """Name the sizes that no one stated, where they set the solver's units or decide a verdict."""
    problem = found.problem
    ordinary = all(np.all(np.asarray(unit) == 1) for unit in vars(problem.natural).values())
    decided = found.certificate.certified and found.referee.survives is not False
    sizes = "" if ordinary and decided else describe_sizes(problem)
    return sizes and f"Sizes derived from the problem's data (Scaling states others): {sizes}."


def _referee(found: Solution) -> str:
    referee = found.referee
    if referee.survives is None:
        return "no referee: the system has no geometry"
    who = f"referee: {referee.note}"
    if referee.word == "does not survive":
        who += "; the plan does not survive: " + "; ".join(referee.reasons[:3])
        who += _planned(found)
    off = abs(referee.refined_cost - referee.cost)
    if referee.refined_reasons and referee.survives_at_h:
        who += "; at a quarter of the step size " + "; ".join(referee.refined_reasons[:3])
    elif _share(found, off, referee.cost) > _NOTABLE:
        who += f"; at a quarter of the step size it costs {referee.refined_cost:.6g}"
    return who + (_cut(found) if referee.survives_at_h else "")


def _share(found: Solution, change: float, cost: float) -> float:
    return Evaluation(found.problem, found.values).cost_share(change, cost)


def _cut(found: Solution) -> str:
    """How deep the replay penetrates between nodes, from 30 % of the tolerance on."""
    cut, gap = found.referee.replay_between, tolerance_gap(found.problem, found.data["x"].values)
    tolerance = PENETRATION_SHARE * gap
    if cut is None or cut.amount <= _DEEP * tolerance:
        return ""
    return (
        f"; straight motion between nodes penetrates {cut.contact} by {cut.amount:.2g} m in step"
        f" {cut.step}, within the tolerance of {tolerance:.2g} m"
    )


def _refined(refinement: Refinement) -> str:
    """Say where refinement of the step ended, and why where costs do not agree."""
    last = refinement.levels[-1]
    end = refinement.stopped or "they agree"
    return (
        f"Refined to h = {last.h:.6g}: planned {last.cost:.6g}, replayed at half the step {last.replayed:.6g}; {end}."
    )


def _planned(found: Solution) -> str:
    """Lengths of the plan itself that no body has: what a plan that does not survive relies on."""
    far, through = found.referee.force_distance, found.referee.between
    least, text = _NOTABLE * found.problem.scales.gap, ""
    if found.record.get("contact") == "exact" and far is not None and far.amount > least:
        text += f"; in the plan {far.contact} acts at a distance of {far.amount:.2g} m"
        text += f" at step {far.step}"
    if through is not None and through.amount > least:
        text += f"; in the plan {through.contact} is penetrated by {through.amount:.2g} m"
        text += f" within step {through.step}"
    return text


def _replay(found: Solution) -> str:
    """How the model's own exact law changes the plan, if it does noticeably."""
    audit, off = found.audit, found.audit.exact_cost - found.cost
    if audit.replay_failed:
        return f"not replayed under the exact law: {audit.replay_failed}"
    if not math.isfinite(audit.exact_cost):
        return "under the exact law the cost of the replay is NaN or infinite"
    infeasible = found.certificate.reason == UNJUDGED
    small = abs(off) <= _SAME * found.problem.scales.cost
    small |= _share(found, abs(off), found.cost) <= _NOTABLE
    apart = abs(found.referee.branch_cost - audit.exact_cost)
    branch = _share(found, apart, audit.exact_cost) <= _NOTABLE
    if infeasible or branch or small:
        return ""
    if found.record.get("contact") == "exact":
        return "the motion is unstable: the replay diverges from the plan"
    return (
        f"the plan relies on the smoothing: under the exact law it costs {audit.exact_cost:.6g}"
        f" instead of {found.cost:.6g}{_blurred(found)}"
    )


def _blurred(found: Solution) -> str:
    """Say where mu is as large as typical impulse times gap."""
    mu, own = found.values.get(f"{LAW_PREFIX}mu", 0.0), found.problem.scales.mu
    if mu < _BLURRED * own:
        return ""
    return f"; mu = {mu:g} is as large as the problem's typical impulse times gap, {own:.0e} N s m"


def _broken(found: Solution) -> str:
    """Constraints that the exact replay violates, unless the referee lists its own."""
    if found.referee.word == "does not survive" or not found.audit.replay_broken:
        return ""
    return "replayed under the exact law, its " + ", its ".join(describe_violations(found.audit.replay_broken))


def grade(found: Solution) -> Grade:
    """The grade that colours the verdict."""
    if not found.success:
        return "failed"
    return "survives" if found.referee.survives and not jump_findings(found.problem) else "certified"


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:] + "."
