"""What a solve gives back: labelled trajectories, an audit, and a verdict in words."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from dynamics.contact import ContactLaw
from ocp.errors import InputError
from ocp.judges.findings import Audit, Refereed
from ocp.judges.verdict import Grade, grade, verdict
from ocp.problem import Problem
from ocp.programs.status import Status
from ocp.rollout import Gains, Rollout, roll_out
from ocp.stationarity.certificate import Certificate

if TYPE_CHECKING:
    import xarray as xr


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
class Solution:
    """A solved (or not) problem.

    ``certificate`` says whether the point is stationary for the problem that was asked,
    ``referee`` what the sharpest contact makes of it,
    ``idle_cost`` what standing still would cost under the same law
    (:func:`~ocp.judgement.idle_cost`).

    ``data`` holds, labelled and with units, over dimensions scenario, node (N+1), interval (N),
    state, control, contact: ``x`` (scenario, node, state), ``u`` (scenario, interval, control),
    ``lam``, ``gap``, ``mu`` (scenario, interval, contact), their replay under the exact law
    ``x_replay``, ``u_replay``, ``lam_replay``, ``gap_replay`` (contact_exact: without branches),
    under the referee ``x_referee``, ``u_referee``,
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

    ``record`` is everything else, ready for JSON (:mod:`ocp.store.runs`): problem, contact,
    method, policy, solver, parameters, settings, seed.
    """

    data: xr.Dataset
    cost: float
    status: Status
    audit: Audit
    certificate: Certificate
    referee: Refereed
    idle_cost: float
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
    derivative: Callable[[str], xr.Dataset] | None = None

    def sensitivity(self, name: str) -> xr.Dataset:
        """How the solution changes per unit of a parameter: x, u and cost.

        See :mod:`ocp.stationarity.sensitivity`.
        Raises :class:`~ocp.errors.InputError` for an unknown name, for a point that is no solution,
        and where there is no derivative.
        """
        if self.derivative is None:
            raise InputError("a point that was not solved has no sensitivity; solve it first")
        return self.derivative(name)

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
        """Headline with costs and survival, then a line a finding (:mod:`ocp.judges.verdict`)."""
        return verdict(self)

    @property
    def grade(self) -> Grade:
        """``survives``, ``certified`` (and no more) or ``failed``: what the verdict's colour is."""
        return grade(self)


class Interrupted(KeyboardInterrupt):
    """Ctrl-C after some of several starts: ``solution`` is the best one finished."""

    def __init__(self, solution: Solution) -> None:
        super().__init__("interrupted between starts")
        self.solution = solution
