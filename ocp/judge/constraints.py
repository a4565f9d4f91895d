"""Which of a problem's constraints a trajectory violates, and by how much."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from ocp.judge.findings import Finding, make_finding
from ocp.problem.evaluation import Evaluation
from ocp.problem.problem import Constraint, Problem
from ocp.problem.rollout import Rollout, at_steps
from ocp.transcription.common import constraint_names

CONSTRAINT_SHARE = 0.01
"""How far a replay may break a constraint, as a share of the characteristic size of what is
bounded.

A tenth of what the states may differ by: at the solver's tolerance no plan that rests on a bound
would survive another contact, however close its replay stays; a share of the size catches those
that leave the bound by something which can be seen.
"""
_FAR, _LEAST = 10.0, 1e-3
_KINDS = {
    "bound on x": "bound on",
    "bound on u": "bound on",
    "path": "constraint",
    "terminal": "terminal constraint",
    "periodic": "periodicity of",
}


@dataclass(frozen=True)
class Violation:
    """One violated constraint by name, with scenario, step, and how far it is off."""

    name: str
    component: str
    scenario: int
    step: int
    amount: float

    @property
    def title(self) -> str:
        """The constraint in words, as in "bound on v"."""
        return f"{_KINDS[self.name]} {self.component}"


@dataclass(frozen=True)
class Broken:
    """A violated constraint, and by how much of the characteristic size of what it bounds.

    For a bound or periodicity that size is that of states or inputs; for a path or
    terminal constraint what its expression changes by when state and input change by theirs, to
    first order. So the share does not depend on how the constraint is written.
    """

    violation: Violation
    share: float

    @property
    def name(self) -> str:
        """The constraint in words, as in "bound on v"."""
        return self.violation.title


def tolerance_sizes(problem: Problem, x: np.ndarray) -> np.ndarray:
    """Characteristic sizes of the states (nx,) for judging against a plan x (S, N+1, nx).

    A problem's own, or ten times the most that any state of the same unit moves, where that is
    less, down to a thousandth of its own: sizes that are stated for metres, or not at all, say
    nothing of millimetres.
    """
    sizes = problem.scales.x
    return np.clip(_FAR * travelled_ranges(problem, x), _LEAST * sizes, sizes)


def travelled_ranges(problem: Problem, x: np.ndarray) -> np.ndarray:
    """The most that any state of the same unit moves in x (S, N+1, nx), for every state (nx,).

    Infinite where nothing of that unit moves, or states are NaN.
    """
    units = np.array([signal.unit for signal in problem.system.states])
    with np.errstate(invalid="ignore"):
        ranges = np.ptp(x, axis=1).max(axis=0)
    most = np.array([ranges[units == unit].max() for unit in units])
    return np.where(most > 0, most, np.inf)


def broken_constraints(evaluation: Evaluation, rollout: Rollout, sizes: np.ndarray | None = None) -> list[Broken]:
    """Find what trajectories violate, each entry where it is worst.

    Bounds of states and inputs, path and
    terminal constraints, and the periodicity of a start that is chosen; the worst first. NaN is no
    violation: report that the replay failed. ``sizes`` (nx,) are those of the states, by default
    the problem's.
    """
    problem, (x, u, impulses) = evaluation.problem, (rollout.x, rollout.u, rollout.impulses)
    _, _, u_low, u_high, x_low, x_high = evaluation.limits
    system, of_x = problem.system, problem.scales.x if sizes is None else sizes
    states, inputs = ([signal.name for signal in part] for part in (system.states, system.inputs))
    after = x[:, 1:]
    found = [
        *_worst_entries("bound on x", states, _off(after, x_low, x_high), of_x, 1),
        *_worst_entries("bound on u", inputs, _off(u, u_low, u_high), problem.scales.u),
    ]
    for kind, constraints in (("path", problem.path), ("terminal", problem.terminal)):
        if constraints:
            at = (x[:, :-1], u, x[:, 1:], impulses)
            if kind == "terminal":
                at = (x[:, -1:], u[:, -1:], x[:, -1:], impulses[:, -1:])
            off, size = _constraints_off(evaluation, constraints, *at, of_x)
            first = 0 if kind == "path" else problem.N
            names = constraint_names(constraints)
            found += _worst_entries(kind, names, off, size, first)
    if problem.start is not None and problem.start.periodic:
        which = list(problem.start.periodic)
        off = np.abs(x[:, -1:, which] - x[:, :1, which])
        names = [states[i] for i in which]
        found += _worst_entries("periodic", names, off, of_x[which], problem.N)
    return sorted(found, key=lambda broken: -broken.share)


def noticeable_violations(broken: Sequence[Broken], share: float = CONSTRAINT_SHARE) -> list[Violation]:
    """Worst entry of every kind that is broken by more than a share of its size."""
    worst: dict[str, Violation] = {}
    for one in broken:
        if one.share > share:
            worst.setdefault(one.violation.name, one.violation)
    return list(worst.values())


def violation_findings(violations: Sequence[Violation]) -> list[Finding]:
    """Return a finding for every violation: which constraint, by how much, at which step."""
    return [
        make_finding("constraint-violated", constraint=violation.title, amount=violation.amount, step=violation.step)
        for violation in violations
    ]


def describe_violations(violations: Sequence[Violation]) -> list[str]:
    """Return half a sentence for every violation: "terminal constraint end is violated by 0.3 at step 20"."""
    return [finding.sentence.removeprefix("its ") for finding in violation_findings(violations)]


def _off(values: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    return np.maximum(low - values, values - high)


def _worst_entries(
    name: str, components: Sequence[str], off: np.ndarray, size: np.ndarray | float, first: int = 0
) -> list[Broken]:
    """Every component's worst violation of off (S, steps, n), the steps counted from ``first``."""
    amounts = np.maximum(np.nan_to_num(off, nan=0.0), 0.0)
    shares = amounts / size
    found = []
    for i, component in enumerate(components):
        s, k = (int(v) for v in np.unravel_index(int(shares[:, :, i].argmax()), shares.shape[:2]))
        if shares[s, k, i] > 0:
            violation = Violation(name, component, s, k + first, float(amounts[s, k, i]))
            found.append(Broken(violation, float(shares[s, k, i])))
    return found


def _constraints_off(
    evaluation: Evaluation,
    constraints: Sequence[Constraint],
    x: np.ndarray,
    u: np.ndarray,
    x_next: np.ndarray,
    lam: np.ndarray,
    of_x: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Violation of every entry, (S, steps, n), and the size of a change of it."""
    problem = evaluation.problem
    system = problem.system
    value = ca.vertcat(*(c.expression for c in constraints))
    low = ca.vertcat(*(c.lower for c in constraints))
    high = ca.vertcat(*(c.upper for c in constraints))
    size = row_sizes(problem, value, of_x)
    function = ca.Function(
        "constraints",
        [system.x, system.u, system.x_next, system.lam, problem.parameters.vector],
        [ca.densify(part) for part in (ca.fmax(low - value, value - high), size)],
    )
    off, size = at_steps(function, x, u, x_next, lam, p=evaluation.p)
    # Where nothing changes a constraint to first order, any violation of it is a large one.
    return off, np.fmax(size, 1e-12)


def row_sizes(problem: Problem, value: ca.SX, of_x: np.ndarray) -> ca.SX:
    """What entries (n, 1) change by, to first order, as each signal moves by its size, (n, 1).

    ``of_x`` (nx,) are the sizes of the states; x and x_next, inputs and impulses each count once.
    """
    system, scales = problem.system, problem.scales
    impulses = np.full(system.nlam, scales.impulse)
    parts = ((system.x, of_x), (system.u, scales.u), (system.x_next, of_x), (system.lam, impulses))
    total = ca.SX.zeros(value.numel())
    for symbols, sizes in parts:
        J = ca.fabs(ca.densify(ca.jacobian(value, symbols))) @ ca.diag(ca.DM(sizes))
        total += ca.vertcat(*(ca.mmax(ca.horzcat(0, J[i, :])) for i in range(value.numel())))
    return total
