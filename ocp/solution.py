"""What a solve gives back: labelled trajectories, an audit, and a verdict in words."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

import xarray as xr

from dynamics.contact import ContactLaw
from ocp.problem import Problem
from ocp.rollout import Gains, Rollout, roll_out


class Status(Enum):
    """Outcome of a solve; the value is the sentence a person reads."""

    SOLVED = "solved: the audited residuals are below tolerance"
    INEXACT = "not solved: the solver stopped, but the audited residuals are above tolerance"
    NO_PROGRESS = (
        "no-progress: the contacts never act and the gradient of the task cost is zero there;"
        " start from a smoothing law and follow it (--contact exact -s homotopy=true)"
    )
    ITERATION_LIMIT = "not converged: the iteration limit was reached"
    INFEASIBLE = "not converged: the constraints could not be met from this guess"
    DIVERGED = "not converged: the iterates diverged or a function returned no number"
    STOPPED = "stopped by the user"
    FAILED = "not converged: the solver gave up"

    @property
    def label(self) -> str:
        """Short name, as in JSON."""
        return self.name.lower().replace("_", "-")


@dataclass(frozen=True)
class StageRecord:
    """One stage of a homotopy: where on the path, and what the solver needed and reached.

    ``evaluation_s`` of its ``seconds`` went into evaluating the NLP and its derivatives.
    """

    knob: str
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
class Violation:
    """One violated constraint by name, with scenario, step, and how far it is off."""

    name: str
    component: str
    scenario: int
    step: int
    amount: float


@dataclass(frozen=True)
class ContactSummary:
    """One contact over all scenarios and steps.

    ``steps`` in contact, of them ``slipping``; ``peak_force`` [N] of the normal force;
    ``slid`` [m] the way slid while in contact; ``weak`` the steps at which complementarity is not
    strict (impulse and gap both near zero), where gradients are not to be trusted; ``spans``
    (first, last) steps of the first scenario's contacts.
    """

    name: str
    steps: int
    slipping: int
    peak_force: float
    slid: float
    weak: int
    spans: list[tuple[int, int]] = field(default_factory=list)


@dataclass(frozen=True)
class Audit:
    """Residuals recomputed from the trajectories, and the replay under the exact law.

    ``complementarity`` is max lam gap [N s m], ``complementarity_min`` max min(lam, gap), both
    over all contacts and steps; ``dynamics_residual`` max |residual|, ``law_residual`` max
    |lam gap - mu|, ``constraint_violation`` of bounds, path and terminal constraints,
    ``penetration`` max(0, -phi) with phi the true signed distance, ``exact_cost`` the cost of the
    replay, ``state_gap`` max |x - x_replay|. ``active_steps`` counts (step, contact) pairs in
    contact; ``task_gradient`` is the largest change of the cost per unit input.

    With friction, largest over contacts and steps: ``cone_violation`` max(0, |tangential| -
    friction normal) [N s] and ``dissipation_residual`` [J], what friction misses of the most it
    could take. Where energy is known: ``energy_gain`` [J] the largest rise in one step beyond the
    work done, contact's and the integrator's, ``dissipated`` [J] what contact took in all,
    ``momentum_residual`` [N s]. ``contacts`` tells of each contact when it acts, how hard, and how
    far it slides.
    """

    complementarity: float
    complementarity_min: float
    dynamics_residual: float
    law_residual: float
    constraint_violation: float
    penetration: float
    exact_penetration: float
    exact_cost: float
    state_gap: float
    active_steps: int
    task_gradient: float
    worst: list[Violation] = field(default_factory=list)
    cone_violation: float = math.nan
    dissipation_residual: float = math.nan
    energy_gain: float = math.nan
    dissipated: float = math.nan
    momentum_residual: float = math.nan
    contacts: list[ContactSummary] = field(default_factory=list)


@dataclass(frozen=True)
class Solution:
    """A solved (or not) problem.

    ``data`` holds, labelled and with units, over dimensions scenario, node (N+1), interval (N),
    state, control, contact: ``x`` (scenario, node, state), ``u`` (scenario, interval, control),
    ``lam``, ``gap``, ``mu`` (scenario, interval, contact), their replay under the exact law
    ``x_replay``, ``u_replay``, ``lam_replay``, ``gap_replay`` (contact_exact: without branches),
    ``phi``, ``phi_replay`` (scenario, node, distance) where the system knows its signed distance,
    with friction ``normal_impulse``, ``friction_impulse``, ``slip``, ``friction_bound`` (friction
    times normal impulse) and, as 0 or 1, ``acts``, ``slides``, ``weak`` (scenario, interval, point)
    of every contact, and their ``_replay``, for feedback ``K`` (interval, control, state) and ``k``
    (interval, control), and the homotopy's stages: ``stage_value``, ``stage_cost``,
    ``stage_complementarity``, ``stage_residual``, ``stage_iterations`` (stage), and ``stage_x``,
    ``stage_u`` (accepted_stage, scenario or shared, interval, state or control) of those that
    succeeded. Coordinate ``time`` [s].

    Of ``solve_s`` [s], ``evaluation_s`` went into evaluating cost, constraints and derivatives;
    ``solver_s``, the rest, into the solver: linear algebra, line search, its own affairs. It is
    NaN where that was not measured.

    ``record`` is everything else, ready for JSON (:mod:`ocp.studies.store`): problem, contact,
    method, policy, solver, parameters, settings, seed.
    """

    data: xr.Dataset
    cost: float
    status: Status
    audit: Audit
    stages: list[StageRecord]
    iterations: int
    build_s: float
    solve_s: float
    record: dict[str, Any]
    problem: Problem
    values: dict[str, float]
    gains: Gains | None = None
    others: list[dict[str, Any]] = field(default_factory=list)
    evaluation_s: float = math.nan

    @property
    def solver_s(self) -> float:
        """Seconds of the solve that were no evaluation of functions."""
        return self.solve_s - self.evaluation_s

    @property
    def iteration_s(self) -> dict[str, float]:
        """Mean seconds an iteration, ``evaluation`` and ``solver``; NaN where there was none."""
        count = self.iterations or math.nan
        return {"evaluation": self.evaluation_s / count, "solver": self.solver_s / count}

    def replay(self, law: ContactLaw | None = None) -> Rollout:
        """Roll the plan out under another law (the exact one if not said).

        Open loop: the same inputs; feedback: the same policy from each scenario.
        """
        plan = self.gains if self.gains is not None else self.data["u"].values
        return roll_out(self.problem, plan, self.values, law, self.data["x"].values[:, 0])

    @property
    def success(self) -> bool:
        """Whether the audit, not the solver, says that this is an answer."""
        return self.status is Status.SOLVED

    @property
    def verdict(self) -> str:
        """One or two sentences: solved or not, and whether the plan survives exact physics."""
        if not self.success:
            return self.status.value.capitalize() + "."
        return f"Solved: cost {self.cost:.6g}; {self._survival()}."

    def _survival(self) -> str:
        exact, off = self.audit.exact_cost, self.audit.exact_cost - self.cost
        if not math.isfinite(exact):
            return "but under exact physics the motion runs away"
        if abs(off) <= 1e-5 * max(abs(self.cost), 1e-9):
            return "the plan survives exact physics unchanged"
        if off <= 0.1 * abs(self.cost):
            return f"the plan survives exact physics at cost {exact:.6g}"
        if self.record.get("contact") == "exact":
            return f"but its inputs, replayed, cost {exact:.6g}: the motion is unstable"
        return f"but under exact physics it costs {exact:.6g}: the plan leans on the smoothing"


class Interrupted(KeyboardInterrupt):
    """Ctrl-C after some of several starts: ``solution`` is the best one finished."""

    def __init__(self, solution: Solution) -> None:
        super().__init__("interrupted between starts")
        self.solution = solution
