"""Findings of the judges: each has a code, numbers, and a clause from a table."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any

SENTENCES = {
    # Parts of the task that a solved plan leaves undone.
    "never-touches": "{bodies} never touch{plural} {others}",
    "contact-never-acts": "the {contacts} never act{plural}",
    "nothing-moves": "nothing moves that the cost depends on",
    "holding-still": "holding still costs {difference}",
    # The status of a plan that is not solved.
    "status": "{explanation}",
    "cost-not-finite": (
        "the cost is NaN or infinite at the last iterate: give a guess with a finite cost, and"
        " bounds that keep the states where the cost is finite"
    ),
    "contacts-never-act": "the contacts never act",
    "no-homotopy": "no homotopy was followed, whose smoothing gives contact forces at a distance",
    "unbounded": "the cost {fall}: add a bound, or a cost on it",
    "iterates-ran-away": "the solver's iterates diverged along {variables}: add a bound, or a cost on it",
    # The certificate.
    "B-stationary": "B-stationary: no first-order move, with any change of contact, lowers the cost",
    "stationary": "stationary: no first-order move lowers the cost",
    "stationarity-undecided": "stationarity undecided: {reason}",
    "not-stationary": (
        "not stationary: {moves} would lower the cost by about {gain:.2g} within a hundredth of the"
        " characteristic sizes"
    ),
    "moves-not-made": "{reason}",
    "problem-jumps": (
        "the problem jumps ({operations}), which derivatives do not show: the certificate holds only between jumps"
    ),
    "functions-not-inspected": (
        "external functions are not examined for jumps ({functions}): the certificate holds only where they are smooth"
    ),
    "standing-still": "standing still is the best of {attempts} solution attempts",
    # The model.
    "no-contact-forces": "the law is learned from data and has no contact forces",
    "gaps": "the model's gaps are {gaps}",
    "training-data-differ": "its training data have {differences}",
    # The referee.
    "no-referee": "no referee: the system has no geometry",
    "referee": "referee: {note}",
    "does-not-survive": "the plan does not survive",
    "step-not-solved": "{step}",
    "states-not-finite": "the replay has NaN or infinite states",
    "replay-cost-not-finite": "the cost of the replay is NaN or infinite",
    "costs-more": "it costs {cost:.6g} instead of {planned:.6g}",
    "state-differs": "{state} is {amount:.2g} {unit} off at node {node}",
    "constraint-violated": "its {constraint} is violated by {amount:.2g} at step {step}",
    "contact-penetrated": "{contact} is penetrated by {amount:.2g} at {place} {step}",
    "acts-at-a-distance": "in the plan {contact} acts at a distance of {amount:.2g} m at step {step}",
    "plan-penetrates": "in the plan {contact} is penetrated by {amount:.2g} m within step {step}",
    "cuts-through": (
        "straight motion between nodes penetrates {contact} by {amount:.2g} m in step {step},"
        " within the tolerance of {tolerance:.2g} m"
    ),
    # The referee at a quarter of the step size.
    "fails-at-quarter-step": "at a quarter of the step size",
    "quarter-step-cost": "at a quarter of the step size it costs {cost:.6g}",
    "replay-stops": "the replay stops: {note}",
    "quarter-step-cost-not-finite": "the cost is NaN or infinite",
    "costs-more-at-quarter-step": "it costs {cost:.6g}",
    "bodies-penetrate": "bodies penetrate by {amount:.2g}",
    # The replay under the exact law.
    "not-replayed": "not replayed under the exact law: {step}",
    "exact-cost-not-finite": "under the exact law the cost of the replay is NaN or infinite",
    "unstable-motion": "the motion is unstable: the replay diverges from the plan",
    "relies-on-smoothing": (
        "the plan relies on the smoothing: under the exact law it costs {cost:.6g} instead of {planned:.6g}"
    ),
    "mu-is-large": "mu = {mu:g} is as large as the problem's typical impulse times gap, {typical:.0e} N s m",
    "exact-replay-violates": "replayed under the exact law",
    "forces-not-unique": (
        "the contact forces at step {step} are not unique ({contacts}): from the same state and input, {state} can"
        " also end {distance} away, as the replay does{negation}, and the motion from there {consequence}"
        " instead of {planned:.6g}"
    ),
    "more-steps-not-unique": "{count} more steps have another solution",
    # Sizes, the route to the solution, and results computed after the solve.
    "derived-sizes": "sizes derived from the problem's data (Scaling states others): {sizes}",
    "doubtful-sizes": "of the stated sizes {sizes}; leave them out of Scaling to derive them",
    "step-refined": ("refined to h = {h:.6g}: planned {cost:.6g}, replayed at half the step {replayed:.6g}; {ending}"),
    "survives-by": "it survives with {remedy} (cost {cost:.6g}, {difference} the plan)",
    "remedy-costs-too-much": (
        "it costs {cost:.6g}, and a remedy for the plan of cost {planned:.6g} survives only up to {limit:.6g}"
    ),
    "no-rung-survives": "no rung survives; the best is {remedy} (cost {cost:.6g}, {difference} the plan)",
    "ladder-stopped": "{reason}",
    "disturbed-survival": "it survives {counts}",
    "time-limit": ("the time limit stopped {count} of {runs} runs of the solver: without it the answer may differ"),
    "not-resumed": (
        "the solver did not converge from the stored run; this is a cold solve with that run's"
        " trajectories as the guess"
    ),
    "attempts-failed": (
        "{count} other solution attempt{plural} ended in an error of the program ({error}); -v shows where"
    ),
    "attempts-without-answer": "{count} other solution attempt{plural} found no answer: {reason}",
    "simulator": "{sentence}",
    "sensitivity": "{sentence}",
    # A closed loop.
    "reached-the-end": "{cost}; {survivors} of {seeds} reached the end",
    "plant-diverged": "the plant diverged in {count} of {seeds}, seed {seed} at sample {sample}",
    "stopped-by-the-user": "stopped by the user at seed {seed}, sample {sample} of {samples}, cost so far {cost:.5g}",
    "plans-missing": "a new plan was made in {count} of {samples} samples",
    "stage-cost-not-finite": (
        "the stage cost is NaN or infinite in {count} of {samples} samples, first at sample {sample} of seed {seed}"
    ),
    "plant-violates": "the plant violates {constraint} by up to {amount:.3g}, at sample {sample} of seed {seed}",
    "more-constraints-violated": "it violates {count} more constraint{plural}",
    "other-solver": "the solver was {solver}, and not the default, ipopt",
    # The gradient of a simulator.
    "gradient-right": "right: the slope is {slope:.4g}, the exact slope {truth:.4g}",
    "gradient-consistent": (
        "consistent: the slope is {slope:.4g}, secants up to the largest amplitude give {truth:.4g}; the exact"
        " slope is not known"
    ),
    "gradient-of-the-discrete-map": (
        "right for the discrete map but not for the exact output: the slope is {slope:.4g}, {factor} ({truth:.4g}), and"
        " {low:.3g} to {high:.3g} nearby; {vanishes}"
    ),
    "gradient-wrong-sign": (
        "wrong sign: the slope is {slope:.4g}, and {low:.3g} to {high:.3g} nearby, the exact slope {truth:.4g};"
        " {vanishes}"
    ),
    "gradient-zero": "zero: the slope vanishes, the exact slope is {truth:.4g} here, {wide:.4g} over a finite change",
    "gradient-exploding": (
        "exploding: the slope is {slope:.4g}, and {low:.3g} to {high:.3g} nearby, the exact slope {truth:.4g}; {growth}"
    ),
    "gradient-undefined": (
        "undefined: the output jumps by {size:.3g} at {place:.6g}, within the largest amplitude; a local slope such as"
        " {slope:.4g} does not contain the jump"
    ),
    "gradient-noise": (
        "noise: rounding errors of {noise:.2g} in the output leave an error of {error:.2g} in the best secant"
        " (slope {truth:.4g})"
    ),
    "gradient-not-finite": "not finite: the slope is {slope:.4g} here, or not a number nearby",
    "gradient-not-the-derivative": (
        "not the derivative of the discrete map: the slope is {slope:.4g}, differences of the same rollouts give"
        " {difference:.4g} (exact slope {truth:.4g})"
    ),
    "gradient-differs-from-secant": (
        "right for the discrete map but not over a finite change: the slope is {slope:.4g}, {low:.3g} to {high:.3g}"
        " nearby, and the secant over the largest amplitude {truth:.4g}"
    ),
    "gradient-biased-at-sigma": (
        "biased at sigma = {sigma:.3g}: the local slope {slope:.4g} is right, but {estimator} gives {mean:.4g} with a"
        " standard error of {standard_error:.2g}, the exact smoothed slope is {reference:.4g}"
    ),
    "truth-has-a-kink": "the exact output has a kink here, with slopes from {low:.4g} to {high:.4g}",
    "gradient-by-all-inputs": (
        "gradients by all {count} inputs have the length {length:.4g} nearby, those of the exact law {truth:.4g}, and"
        " the cosine of their angle is {cosine:.3g}"
    ),
    "use-secant": "use secants over amplitudes from {low:.2g} to {high:.2g}, which agree with {agreement}",
    "use-smoothed": (
        "use {estimator} at sigma = {sigma:.3g}: {mean:.4g} with a standard error of {standard_error:.2g}, the exact"
        " smoothed slope is {reference:.4g}"
    ),
    "use-more-samples": (
        "use {estimator} at sigma = {sigma:.3g} with about {count} samples: {mean:.4g} with a standard error of"
        " {standard_error:.2g} agrees with the exact smoothed slope, {reference:.4g}"
    ),
    "use-estimate": (
        "{estimator} at sigma = {sigma:.3g} estimates the slope over a finite change: {mean:.4g} with a standard error"
        " of {standard_error:.2g}"
    ),
    "use-finite-outputs": (
        "{count} samples at sigma = {sigma:.3g} are not finite, so that no smoothed gradient can be estimated; return"
        " finite numbers there, or state a smaller size"
    ),
    "use-finer": "use finer settings ({settings}), with which the error decreases",
    "use-other-law": (
        "use another simulator: neither a secant nor a smoothed gradient of this one agrees with the exact slope"
    ),
}
"""Mapping from the code of a finding to the template of its clause, with named numbers and words."""


@dataclass(frozen=True)
class Finding:
    """Result of a judge: a ``code`` of :data:`SENTENCES`, its ``numbers``, and its clause as ``sentence``.

    ``joint`` is the text between this finding and the previous one in a line of a verdict, "" at the beginning of a
    line.
    """

    code: str
    numbers: dict[str, Any] = field(default_factory=dict)
    sentence: str = ""
    joint: str = ""

    @property
    def document(self) -> dict[str, Any]:
        """The finding as a JSON-serialisable dict, without its joint."""
        return {"code": self.code, "numbers": self.numbers, "sentence": self.sentence}

    def joined(self, joint: str) -> Finding:
        """Return the finding as a continuation of the previous finding's line, after the text ``joint``."""
        return replace(self, joint=joint)


def make_finding(code: str, joint: str = "", **numbers: Any) -> Finding:
    """Return the finding of a code; ``numbers`` fill the template of its clause."""
    return Finding(code, numbers, SENTENCES[code].format(**numbers), joint)


def join_findings(findings: Iterable[Finding], joint: str = "; ", first: str = "") -> list[Finding]:
    """Return findings as parts of one line: the text ``first`` precedes the first, ``joint`` each of the others."""
    return [finding.joined(joint if index else first) for index, finding in enumerate(findings)]


def compose_lines(findings: Iterable[Finding]) -> list[str]:
    """Return the lines of a verdict; each line is a sentence made of a finding and the findings joined to it."""
    lines: list[str] = []
    for finding in findings:
        if finding.joint and lines:
            lines[-1] += finding.joint + finding.sentence
        else:
            lines.append(finding.sentence)
    return [line[:1].upper() + line[1:] + "." for line in lines]
