"""Words for what three judges found: certificate and referee first, the solver's word last."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Literal

from dynamics.systems import LAW_PREFIX
from ocp.judges.jumps import jumps_of
from ocp.judges.referee import PENETRATION_SHARE, seen_gap
from ocp.physics.constraints import describe_violations
from ocp.programs.solver import TIMED_OUT

if TYPE_CHECKING:
    from ocp.solution import Solution

Grade = Literal["survives", "certified", "failed"]
"""Certified and surviving, at h/4 too; certified alone, or between jumps of cost or constraints
alone; neither. Shown green, amber and red."""
_SAME = 1e-5
_NOTABLE, _DEEP = 0.1, 0.3
_BLURRED, _CLEAR = 0.5, 1e-2
"""Shares of the characteristic mu from which on nothing is seen clearly, and at which most is."""
_FEASIBLE = ("not-optimal", "undecided")
"""Of plans that are no answers, those of which it is worth saying that they survive."""


def verdict(found: Solution) -> str:
    """Return the headline, with every cost in it, and below it one finding a line."""
    return "\n".join([headline(found), *findings(found)])


def headline(found: Solution) -> str:
    """Status, cost under the law, under the model's exact law and under the referee; survival."""
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
    return "exact law not replayed" if found.audit.replay_failed else "exact law without a number"


def _refereed(found: Solution) -> str:
    if found.referee.survives is None:
        return "no referee"
    cost, gap = found.referee.cost, found.referee.gap
    if math.isfinite(cost):
        return f"referee {cost:.6g}"
    return "referee without a number" if math.isfinite(gap) else "referee not replayed"


def findings(found: Solution) -> list[str]:
    """What stands behind the headline, each in a sentence."""
    explained = found.status.value.partition(": ")[2]
    if not math.isfinite(found.cost):
        return [
            "The cost is no number where the solver stopped: give a guess at which it is one, and"
            " bounds that keep the states where it stays one."
        ]
    lines = [] if found.success or not explained else [_sentence(explained)]
    forceless = math.isnan(found.audit.complementarity)
    if found.status.label == "no-progress" and found.audit.active_steps == 0 and not forceless:
        lines = [_sentence(f"the contacts never act; {explained}")]
    if found.certificate.reason != UNJUDGED:
        lines.append(_sentence(found.certificate.sentence))
        if jumps := jumps_of(found.problem):
            lines.append(
                f"Derivatives do not see jumps ({', '.join(jumps)}): the certificate holds only"
                " between them."
            )
    if ways := found.record.get("ways"):
        lines.append(f"Standing still is the best that was found by {ways} ways.")
    gaps = found.problem.system.gaps
    model = "" if gaps is None else f"the model's gaps are {gaps}"
    if forceless:
        model = "the law is learned from data and knows no forces" + (model and f"; {model}")
    others = found.record.get("learned_at", {}).items()
    differs = ", ".join(f"{name} = {then:g}, not {now:g}" for name, (then, now) in others)
    model += f"; its data were taken at {differs}" if differs else ""
    said = (model, _referee(found), _replay(found), _broken(found), found.referee.nonuniqueness)
    lines += [_sentence(line) for line in said if line]
    if steps := found.record.get("refined"):
        lines.append(_refined(steps["levels"], steps["stopped"]))
    if cut := sum(stage.status in TIMED_OUT for stage in found.stages):
        runs = f"{cut} of {len(found.stages)} runs of the solver"
        lines.append(f"The time limit that was set cut {runs}: without one the answer may differ.")
    if not found.record.get("resumed", True):
        lines.append(
            "The solver did not converge from the run it started at; this is a cold solve with"
            " that run's trajectories as the guess."
        )
    solver = found.record.get("solver", "ipopt")
    if not found.success and solver != "ipopt":
        lines.append(f"The solver was {solver}; ipopt, the default, solves more: --solver ipopt.")
    return lines


UNJUDGED = "the point is not feasible"
"""The certificate's reason where there was nothing to certify."""


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
    elif off > _NOTABLE * abs(referee.cost):
        who += f"; at a quarter of the step size it costs {referee.refined_cost:.6g}"
    return who + (_cut(found) if referee.survives_at_h else "")


def _cut(found: Solution) -> str:
    """How deep the replay cuts into a body between nodes, from 30 % of the tolerance on."""
    cut, gap = found.referee.replay_between, seen_gap(found.problem, found.data["x"].values)
    tolerance = PENETRATION_SHARE * gap
    if cut is None or cut.amount <= _DEEP * tolerance:
        return ""
    return (
        f"; straight motion between nodes cuts {cut.amount:.2g} m into {cut.contact} in step"
        f" {cut.step}, within the tolerance of {tolerance:.2g} m"
    )


def _refined(levels: list[dict[str, Any]], stopped: str) -> str:
    """Where refining the step ended, and why where that was no agreement."""
    last = levels[-1]
    end = stopped or "they agree"
    return (
        f"Refined to h = {last['h']:.6g}: planned {last['cost']:.6g}, replayed at half the step"
        f" {last['replayed']:.6g}; {end}."
    )


def _planned(found: Solution) -> str:
    """Lengths of the plan itself that no body has: what a plan that does not survive leans on."""
    far, through = found.referee.force_distance, found.referee.between
    least, said = _NOTABLE * found.problem.sizes.gap, ""
    if found.record.get("contact") == "exact" and far is not None and far.amount > least:
        said += f"; planned, {far.contact} acts from {far.amount:.2g} m away at step {far.step}"
    if through is not None and through.amount > least:
        said += f"; planned, {through.contact} is passed through by {through.amount:.2g} m"
        said += f" in step {through.step}"
    return said


def _replay(found: Solution) -> str:
    """What the model's own exact law makes of the plan, where that is worth a sentence."""
    audit, off = found.audit, found.audit.exact_cost - found.cost
    if audit.replay_failed:
        return f"not replayed under the exact law: {audit.replay_failed}"
    if not math.isfinite(audit.exact_cost):
        return "replayed under the exact law, the cost is no number"
    infeasible = found.certificate.reason == UNJUDGED
    least = max(_NOTABLE * abs(found.cost), _SAME * found.problem.sizes.cost)
    if infeasible or found.referee.nonuniqueness or abs(off) <= least:
        return ""
    if found.record.get("contact") == "exact":
        remedy = "" if found.record.get("policy") == "feedback" else (
            "; feedback gains may hold it (--policy feedback)"
        )  # fmt: skip
        return f"the motion is unstable: replayed, it parts from the plan{remedy}"
    return (
        f"the plan leans on the smoothing: under the exact law it costs {audit.exact_cost:.6g}"
        f" instead of {found.cost:.6g}{_narrower(found)}"
    )


def _narrower(found: Solution) -> str:
    """Which mu to take where the one given is as large as impulse times distance themselves."""
    mu, own = found.values.get(f"{LAW_PREFIX}mu", 0.0), found.problem.sizes.mu
    if mu < _BLURRED * own:
        return ""
    return (
        f"; mu = {mu:g} blurs all there is, impulses and distances being about {own:.0e} N s m"
        f" together: take -c mu={_CLEAR * own:.0e}"
    )


def _broken(found: Solution) -> str:
    """Constraints that the exact replay breaks, where the referee has not told of its own."""
    if found.referee.word == "does not survive" or not found.audit.replay_broken:
        return ""
    return "replayed under the exact law, its " + ", its ".join(
        describe_violations(found.audit.replay_broken)
    )


def grade(found: Solution) -> Grade:
    """What the verdict is coloured by."""
    if not found.success:
        return "failed"
    return "survives" if found.referee.survives and not jumps_of(found.problem) else "certified"


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:] + "."
