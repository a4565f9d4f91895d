"""Strategies for exact complementarity, each a few paths of easier NLPs.

All work on a direct transcription, whose pairs ``lam, gap >= 0`` are variables, and all but the
equality and smoothing ones admit the exact solution itself, so that no plan rides on leftover
smoothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import ClassVar, Protocol

import numpy as np

from ocp.problem import Reference
from ocp.programs.program import Program
from ocp.programs.solver import Result
from ocp.routes.legs import Path, Plan, geometric

T_SHARP = 1e-8
"""Relaxation at which the textbook paths end."""
_SHORT = 300
"""Iterations after which a stage is rather retried at a larger t."""
_LOOSE = {"bound_relax_factor": 1e-8, "constr_viol_tol": 1e-8, "max_iter": _SHORT}
T_LOOSE = 1e-4
"""Fraction of impulse times distance at which the active set shows, and polishing can begin."""


class Strategy(Protocol):
    """Paths to follow one after the other, from sizes characteristic of the problem."""

    name: ClassVar[str]
    summary: ClassVar[str]

    def paths(self, reference: Reference) -> list[Path]:
        """Return the paths, easiest first."""
        ...


def _inexact(t: float) -> dict[str, float]:
    """IPOPT options for a stage solved no better than it is relaxed."""
    tolerance = min(1e-4, max(t, 1e-9))
    return {"tol": tolerance, "mu_target": t / 10, "compl_inf_tol": tolerance,
            "mu_init": max(t / 10, 1e-11)}  # fmt: skip


@dataclass(frozen=True)
class CentralPath:
    """``lam gap = t``, t falling fast, inexact stages, ended as soon as the active set shows.

    Every stage is a point on the central path, so the first ones feel all contacts; the polish
    makes the end exact. Where it cannot, :meth:`further` follows the path on.
    """

    factor: float = 0.03
    wide: float = 1.0
    below: bool = True
    name: ClassVar[str] = "central-path"
    summary: ClassVar[str] = "lam gap = t, t falling, then the active set (the default)"

    def paths(self, reference: Reference) -> list[Path]:
        """One path from ``wide`` times impulse times distance to a ten-thousandth of these.

        The first stage may lie ``below`` the path (``lam gap <= t``): from a cold start that
        halves its iterations on systems with many contacts.
        """
        size = reference.impulse * reference.gap
        start = self.wide * size

        def plan(t: float) -> Plan:
            first = self.below and t >= start
            return replace(self._plan(t), contact=(-np.inf, t)) if first else self._plan(t)

        return [Path(geometric(start, T_LOOSE * size, self.factor), plan)]

    def further(self, reference: Reference) -> list[Path]:
        """The same path on to 1e-8."""
        start = T_LOOSE * reference.impulse * reference.gap
        return [Path(geometric(start, T_SHARP, 0.1), self._plan)]

    def _plan(self, t: float) -> Plan:
        return Plan("t", t, contact=(t, t), options={**_inexact(t), "max_iter": _SHORT})


@dataclass(frozen=True)
class ScholtesAdaptive(CentralPath):
    """``lam gap <= t``, t falling fast, IPOPT's barrier adaptive after the first, then active set.

    For laws that average exact steps over noise: each of their many nodes has contacts of its own,
    and to hold all of those on the central path costs more than it guides. Also the second try
    where the central path was not followed to its end.
    """

    name: ClassVar[str] = "scholtes-adaptive"
    summary: ClassVar[str] = "lam gap <= t, adaptive barrier, then the active set (if averaged)"

    def paths(self, reference: Reference) -> list[Path]:
        """One path; from far away, as the first stage starts, a barrier that falls is steadier."""
        start = reference.impulse * reference.gap

        def plan(t: float) -> Plan:
            steady = {} if t < start else {"mu_strategy": "monotone"}
            found = self._plan(t)
            return replace(found, options={**found.options, **steady})

        return [Path(geometric(start, T_LOOSE * start, self.factor), plan)]

    def _plan(self, t: float) -> Plan:
        options = {**_inexact(t), "mu_strategy": "adaptive", "max_iter": _SHORT}
        return Plan("t", t, contact=(-np.inf, t), options=options)


@dataclass(frozen=True)
class Scholtes:
    """``lam gap <= t``, t falling (Scholtes 2001).

    Inexact stages stop at a tolerance of t with IPOPT's own barrier held at t/10: nothing is
    gained by solving a relaxation better than it is relaxed.
    """

    factor: float = 0.1
    inexact: bool = True
    name: ClassVar[str] = "scholtes"
    summary: ClassVar[str] = "lam gap <= t, t falling, inexact stages"

    def paths(self, reference: Reference) -> list[Path]:
        """One path from t = impulse times distance."""
        start = reference.impulse * reference.gap

        def plan(t: float) -> Plan:
            return Plan("t", t, contact=(-np.inf, t), options=_inexact(t) if self.inexact else {})

        return [Path(geometric(start, T_SHARP, self.factor), plan)]


@dataclass(frozen=True)
class ScholtesQuick:
    """``lam gap <= t``, t falling a hundredfold, stages a hundred times as tight as they are loose.

    Bounds give way by 1e-8, as IPOPT's own default is: a feasible set without an interior, usual
    where programs were written without their complementarity in mind, has one then.
    """

    factor: float = 0.01
    name: ClassVar[str] = "scholtes-quick"
    summary: ClassVar[str] = "lam gap <= t, t falling a hundredfold, bounds giving way by 1e-8"

    def paths(self, reference: Reference) -> list[Path]:
        """One path from t = impulse times distance; its first stage has the barrier of any NLP."""
        start = reference.impulse * reference.gap

        def plan(t: float) -> Plan:
            tolerance = max(T_SHARP, min(1e-4, 1e-2 * t))
            barrier = {} if t == start else {"mu_init": min(1e-3, t / 10)}
            options = {**_LOOSE, **barrier, "tol": tolerance, "compl_inf_tol": tolerance,
                       "dual_inf_tol": 1.0}  # fmt: skip
            return Plan("t", t, contact=(-np.inf, t), options=options)

        return [Path(geometric(start, T_SHARP, self.factor), plan)]


@dataclass(frozen=True)
class ScholtesCold:
    """``lam gap <= t`` with every stage solved tightly from cold multipliers: the textbook loop."""

    factor: float = 0.1
    name: ClassVar[str] = "scholtes-cold"
    summary: ClassVar[str] = "lam gap <= t, tight stages, cold multipliers (the textbook loop)"

    def paths(self, reference: Reference) -> list[Path]:
        """One path whose stages forget the multipliers."""
        start = reference.impulse * reference.gap

        def plan(t: float) -> Plan:
            return Plan("t", t, contact=(-np.inf, t), options={"warm_start_init_point": "no"})

        return [Path(geometric(start, T_SHARP, self.factor), plan)]


def _complementary(tolerance: float) -> Callable[[Program, Result], bool]:
    def reached(nlp: Program, result: Result) -> bool:
        lam, gap = (result.point.x / nlp.natural.x)[nlp.pairs]
        return bool(np.abs(lam * gap).max(initial=0.0) <= tolerance)

    return reached


@dataclass(frozen=True)
class L1Penalty:
    """``cost + rho sum lam gap``, rho growing until the products vanish (an exact penalty)."""

    first: float = 10.0
    growth: float = 10.0
    steps: int = 6
    barrier: float = 1e-4
    options: dict[str, float] = field(default_factory=dict)
    name: ClassVar[str] = "l1"
    summary: ClassVar[str] = "penalty rho lam gap, rho growing until it is exact"

    def paths(self, reference: Reference) -> list[Path]:
        """One ladder of penalties."""

        def plan(rho: float) -> Plan:
            barrier = {} if rho == self.first else {"mu_init": self.barrier}
            options = {**self.options, **barrier}
            return Plan("rho", rho, "none", {"penalty": rho}, options=options)

        values = [self.first * self.growth**i for i in range(self.steps)]
        return [Path(values, plan, strict=False, complete=_complementary(1e-7))]


@dataclass(frozen=True)
class L1ThenScholtes:
    """A short ladder of penalties finds the region, Scholtes' relaxation the point."""

    name: ClassVar[str] = "l1-scholtes"
    summary: ClassVar[str] = "two or three penalties, then the relaxation from a small t"

    def paths(self, reference: Reference) -> list[Path]:
        """The ladder, then the relaxation."""
        ladder = L1Penalty(steps=3).paths(reference)
        small = Reference(reference.impulse, 1e-3 * reference.gap)
        return [*ladder, *Scholtes().paths(small)]


@dataclass(frozen=True)
class FischerBurmeister:
    """``lam + gap - sqrt(lam² + gap² + 2 t) = 0``, t falling."""

    factor: float = 0.1
    name: ClassVar[str] = "fischer-burmeister"
    summary: ClassVar[str] = "smoothed Fischer-Burmeister equation, t falling"

    def paths(self, reference: Reference) -> list[Path]:
        """One path in t."""
        start = reference.impulse * reference.gap

        def plan(t: float) -> Plan:
            return Plan("t", t, "fischer-burmeister", {"relaxation": t}, options={"mu_init": 1e-4})

        return [Path(geometric(start, T_SHARP, self.factor), plan)]


@dataclass(frozen=True)
class LinFukushima:
    """``lam gap <= t²`` and ``(lam + t)(gap + t) >= t²``, t falling (Lin and Fukushima 2005)."""

    factor: float = 0.3
    name: ClassVar[str] = "lin-fukushima"
    summary: ClassVar[str] = "lam gap <= t^2 and (lam+t)(gap+t) >= t^2, t falling"

    def paths(self, reference: Reference) -> list[Path]:
        """One path in t, the square root of Scholtes'."""
        start = float(np.sqrt(reference.impulse * reference.gap))

        def plan(t: float) -> Plan:
            parameters = {"relaxation": t}
            return Plan("t", t, "lin-fukushima", parameters, (-np.inf, 0.0), {"mu_init": 1e-4})

        return [Path(geometric(start, float(np.sqrt(T_SHARP)), self.factor), plan)]


STRATEGIES: dict[str, Callable[[], Strategy]] = {
    "central-path": CentralPath,
    "scholtes-adaptive": ScholtesAdaptive,
    "scholtes": Scholtes,
    "scholtes-exact": lambda: Scholtes(inexact=False),
    "scholtes-cold": ScholtesCold,
    "scholtes-quick": ScholtesQuick,
    "l1": L1Penalty,
    "l1-quick": lambda: L1Penalty(
        1.0, steps=7, barrier=1e-3, options={**_LOOSE, "tol": 1e-6, "dual_inf_tol": 1e-2}
    ),
    "l1-scholtes": L1ThenScholtes,
    "fischer-burmeister": FischerBurmeister,
    "lin-fukushima": LinFukushima,
}
DEFAULT_STRATEGY = "central-path"
AVERAGED_STRATEGY = "scholtes-adaptive"
"""The default where a law averages exact steps."""
