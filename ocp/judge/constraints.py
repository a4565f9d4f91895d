"""Violations of a problem's constraints by trajectories, and their sizes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import casadi as ca
import numpy as np

from ocp.judge.findings import Finding, make_finding
from ocp.problem.evaluation import Evaluation
from ocp.problem.problem import Constraint, Problem
from ocp.problem.rollout import Rollout, at_steps
from ocp.transcription.common import constraint_names

CONSTRAINT_SHARE = 0.01
"""Maximum violation of a constraint by a replay, as a fraction of the characteristic size of the bounded quantity.

It is a tenth of the fraction by which states may differ. With the solver's tolerance as the limit, no plan with an
active bound would survive another contact law, even if its replay differed only by rounding errors.
"""
_TRAVEL_FACTOR = 10.0
"""Maximum size of a state for judging, as a multiple of the state's range of motion."""
_LEAST_SIZE = 1e-3
"""Minimum size of a state for judging, as a fraction of its characteristic size."""
ConstraintKind = Literal["path", "terminal"]
"""Kind of the constraints that a problem states as expressions."""
CONSTRAINT_KINDS = {
    "bound on x": "bound on",
    "bound on u": "bound on",
    "path": "constraint",
    "terminal": "terminal constraint",
    "periodic": "periodicity of",
}
"""Mapping from each kind of constraint to the words that precede the name of the bounded quantity."""


@dataclass(frozen=True)
class Violation:
    """Violation of a constraint: kind (``name``), ``component``, scenario, step, and ``amount`` in its unit."""

    name: str
    component: str
    scenario: int
    step: int
    amount: float

    @property
    def title(self) -> str:
        """The constraint in words, as in "bound on v"."""
        return f"{CONSTRAINT_KINDS[self.name]} {self.component}"


@dataclass(frozen=True)
class Broken:
    """Violated constraint, and the violation as a fraction of the characteristic size of the bounded quantity.

    For a bound or periodicity this is the size of the state or input; for a path or terminal
    constraint it is the first-order change of its expression as signals change by their sizes, so
    that the fraction does not depend on the scaling of the constraint.
    """

    violation: Violation
    share: float

    @property
    def name(self) -> str:
        """The constraint in words, as in "bound on v"."""
        return self.violation.title


def tolerance_sizes(problem: Problem, x: np.ndarray) -> np.ndarray:
    """Return characteristic sizes of the states (nx,) for judging against a plan x (S, N+1, nx).

    These are the problem's sizes, limited to ten times the largest range of motion of any state of the
    same unit, but at least a thousandth of the problem's sizes. The limit matters if a plan moves by millimetres and
    the problem's sizes are metres.
    """
    sizes = problem.scales.x
    return np.clip(_TRAVEL_FACTOR * travelled_ranges(problem, x), _LEAST_SIZE * sizes, sizes)


def travelled_ranges(problem: Problem, x: np.ndarray) -> np.ndarray:
    """Return for every state (nx,) the largest range in x (S, N+1, nx) of any state with the same unit.

    The range is infinite if no state with that unit moves, or if states are NaN.
    """
    units = np.array([signal.unit for signal in problem.system.states])
    with np.errstate(invalid="ignore"):
        ranges = np.ptp(x, axis=1).max(axis=0)
    unit_ranges = np.array([ranges[units == unit].max() for unit in units])
    return np.where(unit_ranges > 0, unit_ranges, np.inf)


def broken_constraints(evaluation: Evaluation, rollout: Rollout, sizes: np.ndarray | None = None) -> list[Broken]:
    """Return the constraints that trajectories violate, each component at its worst step, the worst violation first.

    These include bounds of states and inputs, path and terminal constraints, and the periodicity of
    an optimised start. NaN counts as no violation; a failed replay is reported separately.
    ``sizes`` (nx,) are those of the states, by default the problem's.
    """
    problem, (x, u, impulses) = evaluation.problem, (rollout.x, rollout.u, rollout.impulses)
    _, _, u_low, u_high, x_low, x_high = evaluation.limits
    system, x_sizes = problem.system, problem.scales.x if sizes is None else sizes
    states, inputs = ([signal.name for signal in signals] for signals in (system.states, system.inputs))
    x_next = x[:, 1:]
    broken = [
        *_worst_entries("bound on x", states, _off(x_next, x_low, x_high), x_sizes, 1),
        *_worst_entries("bound on u", inputs, _off(u, u_low, u_high), problem.scales.u),
    ]
    kinds: tuple[ConstraintKind, ...] = ("path", "terminal")
    for kind in kinds:
        if constraints := getattr(problem, kind):
            arrays = (x[:, :-1], u, x[:, 1:], impulses)
            if kind == "terminal":
                arrays = (x[:, -1:], u[:, -1:], x[:, -1:], impulses[:, -1:])
            violations, row_changes = _constraints_off(evaluation, kind, *arrays, x_sizes)
            first_step = 0 if kind == "path" else problem.N
            names = constraint_names(constraints)
            broken += _worst_entries(kind, names, violations, row_changes, first_step)
    if problem.start is not None and problem.start.periodic:
        indices = list(problem.start.periodic)
        violations = np.abs(x[:, -1:, indices] - x[:, :1, indices])
        names = [states[i] for i in indices]
        broken += _worst_entries("periodic", names, violations, x_sizes[indices], problem.N)
    return sorted(broken, key=lambda broken: -broken.share)


def noticeable_violations(broken: Sequence[Broken], share: float = CONSTRAINT_SHARE) -> list[Violation]:
    """Return the worst violation of every kind of constraint, if it exceeds ``share`` characteristic sizes."""
    worst: dict[str, Violation] = {}
    for entry in broken:
        if entry.share > share:
            worst.setdefault(entry.violation.name, entry.violation)
    return list(worst.values())


def excess_violation(broken: Sequence[Broken], share: float = CONSTRAINT_SHARE) -> float:
    """Return the sum of all violations above ``share``, in characteristic sizes."""
    return float(sum(max(entry.share - share, 0.0) for entry in broken))


def violation_findings(violations: Sequence[Violation]) -> list[Finding]:
    """Return a finding for every violation, with the constraint, the amount and the step."""
    return [
        make_finding("constraint-violated", constraint=violation.title, amount=violation.amount, step=violation.step)
        for violation in violations
    ]


def describe_violations(violations: Sequence[Violation]) -> list[str]:
    """Return a clause for every violation, such as "terminal constraint end is violated by 0.3 at step 20"."""
    return [finding.sentence.removeprefix("its ") for finding in violation_findings(violations)]


def _off(values: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    return np.maximum(low - values, values - high)


def _worst_entries(
    name: str, components: Sequence[str], violations: np.ndarray, sizes: np.ndarray | float, first_step: int = 0
) -> list[Broken]:
    """Return the worst of ``violations`` (S, steps, n) of every component; steps count from ``first_step``."""
    amounts = np.maximum(np.nan_to_num(violations, nan=0.0), 0.0)
    shares = amounts / sizes
    broken = []
    for i, component in enumerate(components):
        s, k = (int(v) for v in np.unravel_index(int(shares[:, :, i].argmax()), shares.shape[:2]))
        if shares[s, k, i] > 0:
            violation = Violation(name, component, s, k + first_step, float(amounts[s, k, i]))
            broken.append(Broken(violation, float(shares[s, k, i])))
    return broken


def _constraints_off(
    evaluation: Evaluation,
    kind: ConstraintKind,
    x: np.ndarray,
    u: np.ndarray,
    x_next: np.ndarray,
    lam: np.ndarray,
    x_sizes: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return violations of constraints, and first-order changes of their expressions, (S, steps, n) each."""
    function = _constraint_function(evaluation.problem, kind, tuple(np.broadcast_to(x_sizes, x.shape[2]).tolist()))
    violations, changes = at_steps(function, x, u, x_next, lam, p=evaluation.p)
    # If no signal changes a constraint to first order, any violation of the constraint counts as large.
    return violations, np.fmax(changes, 1e-12)


@lru_cache(maxsize=16)
def _constraint_function(problem: Problem, kind: ConstraintKind, x_sizes: tuple[float, ...]) -> ca.Function:
    """Return the function from a step to violations of constraints, and first-order changes of their expressions."""
    constraints: Sequence[Constraint] = getattr(problem, kind)
    expressions = ca.vertcat(*(c.expression for c in constraints))
    lower = ca.vertcat(*(c.lower for c in constraints))
    upper = ca.vertcat(*(c.upper for c in constraints))
    changes = row_sizes(problem, expressions, np.array(x_sizes))
    outputs = [ca.densify(ca.fmax(lower - expressions, expressions - upper)), ca.densify(changes)]
    return ca.Function("constraints", problem.step_symbols, outputs)


def row_sizes(problem: Problem, expressions: ca.SX, x_sizes: np.ndarray) -> ca.SX:
    """Return the first-order changes (n, 1) of expressions as signals change by their characteristic sizes.

    ``x_sizes`` (nx,) are the sizes of the states. The largest change by a single entry is taken for
    each of x, u, x_next and lam, and these four changes are summed.
    """
    system, scales = problem.system, problem.scales
    impulses = np.full(system.nlam, scales.impulse)
    sized_symbols = ((system.x, x_sizes), (system.u, scales.u), (system.x_next, x_sizes), (system.lam, impulses))
    changes = ca.SX.zeros(expressions.numel())
    for symbols, sizes in sized_symbols:
        J = ca.fabs(ca.densify(ca.jacobian(expressions, symbols))) @ ca.diag(ca.DM(sizes))
        changes += ca.vertcat(*(ca.mmax(ca.horzcat(0, J[i, :])) for i in range(expressions.numel())))
    return changes
