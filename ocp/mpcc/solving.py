"""From a complementarity problem and a start to a certified answer."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ocp.errors import InputError, choose
from ocp.judges.audit import TOLERANCES
from ocp.mpcc.programs import MPCC, MPCCProgram, programs_of, sized
from ocp.problem import Scaling
from ocp.programs.program import Program
from ocp.programs.solver import Point, Result, Solver, Status
from ocp.routes.branches import polish
from ocp.routes.complementarity import Search, solve_pairs
from ocp.routes.homotopy import Homotopy
from ocp.routes.relaxations import STRATEGIES
from ocp.routes.restoration import restored, violation
from ocp.stationarity.certificate import Certificate, certify

DEFAULTS = ("l1-quick", "scholtes-quick")
"""Strategies that are tried: an exact penalty is cheapest, the relaxation bears more."""
_LARGE = 300
"""Variables from which on the first certified answer is taken."""


@dataclass(frozen=True)
class MPCCSolution:
    """An answer to an :class:`MPCC`: x (n,), G and H (k,) there, cost and certificate.

    ``success`` means feasible to 1e-6 and certified B-stationary, whatever the solver's status.
    ``infeasibility`` is the largest violation of a bound, of g, or of min(G, H) = 0; ``worst`` says
    where. ``strategy`` is the one that led there.
    """

    x: np.ndarray
    G: np.ndarray
    H: np.ndarray
    f: float
    status: Status
    certificate: Certificate
    infeasibility: float
    worst: str
    strategy: str
    iterations: int
    seconds: float

    @property
    def success(self) -> bool:
        """Whether the answer is certified."""
        return self.status is Status.SOLVED

    @property
    def verdict(self) -> str:
        """What was found, in a sentence or two."""
        if self.status is Status.INFEASIBLE:
            return f"Locally infeasible: {self.worst} cannot be met near the last point."
        word = self.status.value.partition(":")[0].capitalize()
        return f"{word}: cost {self.f:.8g}; {self.certificate.sentence}."


def solve(
    mpcc: MPCC,
    x0: float | Sequence[float] | np.ndarray = 0.0,
    p: Sequence[float] | np.ndarray = (),
    strategies: Sequence[str] = DEFAULTS,
    solver: str = "ipopt",
    options: dict[str, object] | None = None,
) -> MPCCSolution:
    """Solve a problem from ``x0`` (n,) at parameters ``p``, and certify the answer.

    Each strategy relaxes the pairs until their active set shows; a branch that holds it is solved,
    and exchanged as long as the linear program with complementarity constraints finds descent
    (:mod:`ocp.routes.branches`). Complementarity problems have many local minima, and strategies
    end in different ones: all are tried and the cheapest certified answer returned, but from 300
    variables on the first certified one. Where none is feasible, violation is minimised
    over branches and what is left of it is named.

    Raises :class:`~ocp.errors.InputError` for sizes that do not fit, unknown names, or a start that
    is not finite.
    """
    began = time.perf_counter()
    start = sized(mpcc.name, "x0", x0, mpcc.x.numel())
    if not np.all(np.isfinite(start)):
        at = int(np.flatnonzero(~np.isfinite(start))[0])
        raise InputError(f"{mpcc.name}: x0[{at}] is {start[at]}, expected a finite number")
    given = sized(mpcc.name, "p", p, mpcc.p.numel()) if mpcc.p.numel() else np.zeros(0)
    for name in strategies:
        choose("strategy", name, STRATEGIES)
    inside = np.clip(start, *mpcc.x_bounds)
    programs = programs_of(mpcc, given, inside)
    values = {"penalty": 0.0, "relaxation": 0.0}
    follower = Homotopy(programs, Solver(solver, dict(options or {})), values)
    scaling = Scaling(impulse=1.0, gap=1.0)
    best: MPCCSolution | None = None
    for name in strategies:
        search = Search(STRATEGIES[name], scaling, lambda program: Point(program.extended(inside)))
        end = solve_pairs(follower, search)
        found = _judged(programs("none"), end.nlp, end.result, inside, name)
        if best is None or _rank(found) < _rank(best):
            best = found
        if best.success and end.nlp.n >= _LARGE:
            break
    assert best is not None
    if best.infeasibility > TOLERANCES["constraint_violation"]:
        best = _restored(follower, programs("none"), best, inside)
    spent = {"iterations": follower.trace.iterations, "seconds": time.perf_counter() - began}
    return MPCCSolution(**{**vars(best), **spent})


def _restored(
    follower: Homotopy, program: MPCCProgram, end: MPCCSolution, start: np.ndarray
) -> MPCCSolution:
    """Polish from where violation is least near an infeasible end; keep the better of both."""
    least = restored(follower, program.extended(end.x))
    if least is None:
        return end
    x, p = least[0], program.parameter_vector(follower.values)
    there = Result.at(program, Point(x), p, Status.INFEASIBLE, "restored")
    polished = polish(follower, program, there)
    found = _judged(program, polished.nlp, polished.result, start, end.strategy)
    return found if _rank(found) < _rank(end) else end


def _rank(found: MPCCSolution) -> tuple[bool, bool, float]:
    infeasible = found.infeasibility > TOLERANCES["constraint_violation"]
    return infeasible, not found.success, found.infeasibility if infeasible else found.f


def _judged(
    program: MPCCProgram, source: Program, result: Result, start: np.ndarray, name: str
) -> MPCCSolution:
    """Certify a result where it is feasible; else name the most violated constraint."""
    values = {"penalty": 0.0, "relaxation": 0.0}
    mpcc, x = program.mpcc, program.extended(result.point.x[: program.mpcc.x.numel()])
    p, bounds = program.parameter_vector(values), program.bounds(values)
    off, worst = violation(program, x, p, bounds)
    sides = program.lifted.sides(x[: mpcc.x.numel()], program.given)
    G, H = (np.array(v).ravel() for v in sides)
    apart = np.abs(np.minimum(G, H))
    if apart.size and apart.max() > off:
        off, worst = float(apart.max()), f"complementarity of {mpcc.pair(int(apart.argmax()))!r}"
    certificate = Certificate("undecided", reason="the point is not feasible")
    status = Status.INEXACT if result.ok else result.status
    if off <= TOLERANCES["constraint_violation"]:
        multipliers = result.point.lam_g if source is program else None
        certificate = certify(program, x, p, bounds, multipliers, _span(program, start, x, p))
        decided = {"not": Status.NOT_OPTIMAL, "undecided": Status.UNDECIDED}
        status = decided.get(certificate.stationarity, Status.SOLVED)
    elif result.status in (Status.SOLVED, Status.INFEASIBLE):
        status = Status.INFEASIBLE
    f, _ = program.values(x, p)
    return MPCCSolution(x[: mpcc.x.numel()], G, H, f, status, certificate, off, worst, name, 0, 0.0)


def _span(program: MPCCProgram, start: np.ndarray, x: np.ndarray, p: np.ndarray) -> float:
    """What the cost changes by: on the way from the start, and there by characteristic sizes."""
    begin = program.extended(start)
    change = abs(program.values(begin, p)[0] - program.values(x, p)[0])
    return max(change if np.isfinite(change) else 0.0, program.span(begin, p))
