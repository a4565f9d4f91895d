"""Homotopies: strategies for exact complementarity, and the path of a smoothing law's parameter.

The strategies need a direct transcription, whose pairs ``lam, gap >= 0`` are variables. All except those
with equalities or smoothing admit the exact solution, so that plans do not rely on smoothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from dynamics.contact.law import Schedule
from dynamics.systems import LAW_PREFIX
from ocp.programs.program import PENALTY, RELAXATION, Program
from ocp.programs.solver import Point, Result
from ocp.routes.homotopy import IPOPT_PRIMAL_WARM_START, Homotopy, HomotopyPath, HomotopyStage, geometric

T_SHARP = 1e-8
"""Relaxation t, in natural units, at which the textbook paths end."""
_RELAXATION_ITERATIONS = 300
"""Iteration limit of a stage, after which the stage is retried at a larger t."""
_COLD_ITERATIONS = 128
"""Iteration limit of a stage of a cold path, whose last point starts the next stage."""
LOOSE_OPTIONS = {"bound_relax_factor": 1e-8, "constr_viol_tol": 1e-8, "max_iter": _RELAXATION_ITERATIONS}
"""IPOPT options of a stage that is not the last."""
_SHORT_HORIZON = 60
"""Maximum number of steps of a short horizon; no named problem has more by default."""
_FLAT_VALLEY_OPTIONS = {
    "acceptable_tol": 1.0,
    "acceptable_constr_viol_tol": 1e-4,
    "acceptable_obj_change_tol": 1e-5,
    "acceptable_iter": 10,
}
"""IPOPT options that end a nearly feasible stage in a flat valley of the cost."""
T_LOOSE = 1e-4
"""Fraction of characteristic impulse times gap at which the active set is identified and polishing may begin."""


class Strategy(Protocol):
    """Strategy of a relaxation: consecutive paths, starting at ``mu``, characteristic impulse times gap."""

    def paths(self, mu: float) -> list[HomotopyPath]:
        """Return the paths, the easiest one first."""
        ...


def inexact(t: float) -> dict[str, float]:
    """Return IPOPT options for a stage that is solved no more tightly than it is relaxed."""
    tolerance = min(1e-4, max(t, 1e-9))
    return {"tol": tolerance, "mu_target": t / 10, "compl_inf_tol": tolerance, "mu_init": max(t / 10, 1e-11)}


def relaxed(t: float, options: dict[str, Any]) -> HomotopyStage:
    """Return the stage ``lam gap <= t`` (Scholtes 2001)."""
    return HomotopyStage("t", t, contact=(-np.inf, t), options=options)


@dataclass(frozen=True)
class CentralPath:
    """Strategy ``lam gap = t`` with t falling fast, in inexact stages, until the active set is identified.

    Every stage is a point on the central path, so that all contacts have forces in the first stages;
    polishing makes the last point exact. If this fails, :meth:`extend` continues the path. With
    ``start_below`` the first stage is ``lam gap <= t``, which halves its iterations from a cold start on
    systems with many contacts.

    With ``lam gap <= t`` IPOPT's barrier acts on the product of every pair at every step, while a cost is
    mostly terminal or a mean. Above sixty ``steps`` the barrier is reduced in proportion to 1 / ``steps``;
    otherwise it would outweigh the cost, and the stage would not converge. If a cost does not determine all
    of a long plan, a stage ends after ten iterations that gain less than 1e-5, since it only prepares the next.
    """

    factor: float = 0.03
    start_factor: float = 1.0
    start_below: bool = True
    steps: int = 0
    max_iterations: int = _RELAXATION_ITERATIONS

    def for_horizon(self, steps: int) -> CentralPath:
        """Return the strategy for a horizon of ``steps`` steps, 0 for a problem without time."""
        return replace(self, steps=steps)

    def paths(self, mu: float) -> list[HomotopyPath]:
        """Return one path of t, from ``start_factor * mu`` to ``1e-4 * mu``."""
        start = self.start_factor * mu
        values = geometric(start, T_LOOSE * mu, self.factor)
        return [HomotopyPath(values, lambda t: self._stage(t, t >= start))]

    def extend(self, mu: float) -> list[HomotopyPath]:
        """Return the continuation of the path, from ``1e-4 * mu`` to 1e-8."""
        values = geometric(T_LOOSE * mu, T_SHARP, 0.1)
        return [HomotopyPath(values, lambda t: self._stage(t, False))]

    def _stage(self, t: float, first: bool) -> HomotopyStage:
        options = {
            **inexact(t),
            "max_iter": self.max_iterations,
            **(_FLAT_VALLEY_OPTIONS if self.steps > _SHORT_HORIZON else {}),
        }
        if not (first and self.start_below):
            return HomotopyStage("t", t, contact=(t, t), options=options)
        options["mu_target"] *= _SHORT_HORIZON / max(self.steps, _SHORT_HORIZON)
        return HomotopyStage("t", t, contact=(-np.inf, t), options=options)


@dataclass(frozen=True)
class ScholtesAdaptive(CentralPath):
    """Strategy ``lam gap <= t`` with t falling fast, and IPOPT's adaptive barrier after the first stage.

    It suits laws that average exact steps over noise: each of their many nodes has separate contacts,
    and keeping all of them on the central path is not worth the cost. It is also the second attempt if the
    central path was not followed to its end. The first stage starts far from the solution, where the
    monotone barrier is more robust.
    """

    def _stage(self, t: float, first: bool) -> HomotopyStage:
        barrier = "monotone" if first else "adaptive"
        return relaxed(t, {**inexact(t), "mu_strategy": barrier, "max_iter": self.max_iterations})


@dataclass(frozen=True)
class Falling:
    """Strategy with one path of t, from ``mu**power`` down to ``1e-8**power`` by ``factor``.

    ``stage`` maps t, and whether t is the first value, to a stage. If stages are solved tightly, values of t that the
    last solution satisfies are skipped.
    """

    stage: Callable[[float, bool], HomotopyStage]
    factor: float = 0.1
    power: float = 1.0
    tight: bool = False

    def paths(self, mu: float) -> list[HomotopyPath]:
        """Return a list with one path of t, which starts at ``mu**power``."""
        start = mu**self.power
        values = geometric(start, T_SHARP**self.power, self.factor)
        solved_to = smallest_relaxation if self.tight else None
        return [HomotopyPath(values, lambda t: self.stage(t, t >= start), solved_to=solved_to)]


def _quick(t: float, first: bool) -> HomotopyStage:
    """Return the stage ``lam gap <= t`` with a tolerance of t/100.

    The first stage has IPOPT's default barrier. Bounds are relaxed by 1e-8, IPOPT's default, so that a
    feasible set without an interior, common in complementarity problems, gets an interior.
    """
    tolerance = max(T_SHARP, min(1e-4, 1e-2 * t))
    barrier = {} if first else {"mu_init": min(1e-3, t / 10)}
    return relaxed(t, {**LOOSE_OPTIONS, **barrier, "tol": tolerance, "compl_inf_tol": tolerance, "dual_inf_tol": 1.0})


@dataclass(frozen=True)
class ColdScholtes:
    """Strategy ``lam gap <= t`` with t falling from ``start``, whose stages start without multipliers.

    Every stage starts with IPOPT's high barrier, which keeps pairs away from zero again, so that contacts still
    change late on the path. A stage may end at its iteration limit. Paths of different ``factor`` and ``start``, in
    natural units (None: the product of characteristic sizes), often end in different minima.
    """

    factor: float = 0.1
    start: float | None = None

    def paths(self, mu: float) -> list[HomotopyPath]:
        """Return one path of t, from ``start`` or ``mu`` to at most ``1e-4 * mu``."""
        values = geometric(self.start or mu, T_LOOSE * min(mu, 1.0), self.factor)
        return [HomotopyPath(values, self._stage)]

    @staticmethod
    def _stage(t: float) -> HomotopyStage:
        tolerance = max(T_SHARP, min(1e-4, 1e-2 * t))
        tolerances = {"tol": tolerance, "compl_inf_tol": tolerance, "dual_inf_tol": 1.0}
        options = {**tolerances, "warm_start_init_point": "no", "max_iter": _COLD_ITERATIONS}
        return replace(relaxed(t, options), label="cold t", partial=True)


def _fischer_burmeister(t: float, first: bool) -> HomotopyStage:
    """Return the stage ``lam + gap - sqrt(lam² + gap² + 2 t) = 0``."""
    return HomotopyStage("t", t, "fischer-burmeister", {RELAXATION: t}, options={"mu_init": 1e-4})


def _lin_fukushima(t: float, first: bool) -> HomotopyStage:
    """Return the relaxation ``lam gap <= t²`` and ``(lam + t)(gap + t) >= t²`` (Lin and Fukushima 2005)."""
    parameters = {RELAXATION: t}
    return HomotopyStage("t", t, "lin-fukushima", parameters, (-np.inf, 0.0), {"mu_init": 1e-4})


def _largest_product(nlp: Program, result: Result) -> float:
    """Return the largest product ``lam gap`` in natural units."""
    lam, gap = (result.point.x / nlp.natural.x)[nlp.pairs]
    return float(np.abs(lam * gap).max(initial=0.0))


def smallest_relaxation(nlp: Program, result: Result) -> float:
    """Return the least t of ``lam gap <= t``, in natural units, that a point satisfies.

    A solution for a larger t is a solution for all values down to this one.
    """
    rows = nlp.constraints["contact"].index.ravel() if "contact" in nlp.constraints else []
    return float((result.g / nlp.natural.g)[rows].max(initial=0.0))


@dataclass(frozen=True)
class L1Penalty:
    """Strategy of an exact penalty, ``cost + rho sum lam gap``, with rho growing tenfold until the products vanish.

    They vanish up to 1e-7 in natural units, or the tolerance of the stages, which limits their accuracy.
    """

    first: float = 10.0
    steps: int = 6
    barrier: float = 1e-4
    options: dict[str, float] = field(default_factory=dict)

    def paths(self, mu: float) -> list[HomotopyPath]:
        """Return one path of growing penalties."""

        def stage(rho: float) -> HomotopyStage:
            barrier = {} if rho == self.first else {"mu_init": self.barrier}
            return HomotopyStage("rho", rho, "none", {PENALTY: rho}, options={**self.options, **barrier})

        limit = max(1e-7, self.options.get("tol", 0.0))
        values = [self.first * 10.0**i for i in range(self.steps)]
        return [HomotopyPath(values, stage, False, lambda nlp, result: _largest_product(nlp, result) <= limit)]


_SCHOLTES = Falling(lambda t, first: relaxed(t, inexact(t)))
"""Scholtes' relaxation in inexact stages, with a tolerance of t and IPOPT's barrier held at t/10, since
nothing is gained by solving a relaxation more tightly than it is relaxed."""


@dataclass(frozen=True)
class L1ThenScholtes:
    """Strategy of at most three penalties, to approach a solution, then Scholtes' relaxation from a small t."""

    def paths(self, mu: float) -> list[HomotopyPath]:
        """Return the path of penalties, followed by the path of the relaxation."""
        return [*L1Penalty(steps=3).paths(mu), *_SCHOLTES.paths(1e-3 * mu)]


STRATEGIES: dict[str, Strategy] = {
    "central-path": CentralPath(),
    "scholtes-adaptive": ScholtesAdaptive(),
    "scholtes": _SCHOLTES,
    "scholtes-exact": Falling(lambda t, _: relaxed(t, {"max_iter": _RELAXATION_ITERATIONS}), tight=True),
    "scholtes-cold": Falling(lambda t, first: relaxed(t, {"warm_start_init_point": "no"})),
    "scholtes-quick": Falling(_quick, factor=0.01),
    "l1": L1Penalty(),
    "l1-quick": L1Penalty(1.0, steps=7, barrier=1e-3, options={**LOOSE_OPTIONS, "tol": 1e-6, "dual_inf_tol": 1e-2}),
    "l1-scholtes": L1ThenScholtes(),
    "fischer-burmeister": Falling(_fischer_burmeister),
    "lin-fukushima": Falling(_lin_fukushima, factor=0.3, power=0.5),
}
"""Mapping from names to strategies; "scholtes-cold" is the textbook loop: tight stages, cold multipliers."""
STRATEGY_USES = {
    "central-path": "the default; all contacts have forces in every stage. Start here",
    "scholtes-adaptive": "the default of laws that average exact steps over noise; takes over if"
    " the central path is not followed to its end",
    "scholtes": "another relaxation, often another minimum: use it if the plan is poor",
    "scholtes-exact": "every stage solved tightly: use it if fast stages lead to poor minima on large programs; slow",
    "scholtes-cold": "the textbook loop with cold multipliers, to compare with a script; slowest",
    "scholtes-quick": "few stages from a problem's own guess; the second of ocp.mpcc",
    "l1": "exact penalty; stays near the guess: with a good guess, or many starts",
    "l1-quick": "loose penalty, cheapest: small programs; the first of ocp.mpcc",
    "l1-scholtes": "penalty for the region, relaxation for the point: with a rough guess",
    "fischer-burmeister": "an equation, to compare with the literature; slower",
    "lin-fukushima": "two-sided relaxation, to compare with the literature; slower",
}
"""Mapping from names of strategies to their uses, as printed by ``ocp settings strategies``."""
DEFAULT_STRATEGY = "central-path"
"""Default strategy of the exact law."""
AVERAGED_STRATEGY = "scholtes-adaptive"
"""Default strategy of laws that average exact steps."""


STAGE_ITERATIONS = 100
"""Iteration limit of the stages of a law's path except the last; these need not converge tightly."""
MU_LAST = 1e-9
"""Parameter mu of the barrier law at the end of its path, which approximates the exact law."""
NEARBY_START = IPOPT_PRIMAL_WARM_START | dict.fromkeys(
    ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac"), 1e-6
)
"""IPOPT options for a start without multipliers that is near the solution."""


def law_path(
    schedule: Schedule, target: float, start: float | None = None, factor: float | None = None
) -> HomotopyPath:
    """Return the path of a law's parameter from its schedule's initial value (or ``start``) down to ``target``."""
    values = geometric(start or schedule.first_value, target, factor or schedule.factor)
    label = schedule.parameter.removeprefix(LAW_PREFIX)

    def stage(value: float) -> HomotopyStage:
        options: dict[str, Any] = {}
        if value != values[0]:
            options["mu_init"] = 1e-5
        is_last = value == target
        if not is_last:
            options |= {"tol": 1e-6, "max_iter": STAGE_ITERATIONS}
        law_values = {schedule.parameter: value}
        return HomotopyStage(label, value, parameters=law_values, options=options, partial=not is_last)

    return HomotopyPath(values, stage)


def from_exact(
    follower: Homotopy, program: Program, x: np.ndarray, schedule: Schedule | None, value: float
) -> Result | None:
    """Solve at the law's ``value`` from the exact law's solution x, in the variables of ``program``.

    The path from a wide law may end in a worse minimum with another contact schedule; the exact solution
    is then the better start. Pairs are moved onto the central path of the law's mu. The solver starts
    with a low, then with a high barrier parameter, since with a high parameter iterates leave the
    neighbourhood of a solution whose cost is small. The usual push off the bounds, by a hundredth of a unit, is
    reduced for the same reason, since it would move small impulses off the path. Returns None if neither converges.
    """
    x = x.copy()
    if program.pairs.size:
        mu = max(value, MU_LAST) if schedule is not None and schedule.is_mu else MU_LAST
        lam, gap = np.maximum(x[program.pairs], np.sqrt(mu) * 1e-3)
        active = lam > gap
        x[program.pairs] = np.where(active, lam, mu / gap), np.where(active, mu / lam, gap)
    for mu_init in (1e-6, 1e-3):
        stage = HomotopyStage("from exact", value, options={**NEARBY_START, "mu_init": mu_init})
        result = follower.solve_stage(stage, program, Point(x), False)
        if result.ok:
            return result
    return None
