"""Complementarity problems of anyone, in CasADi: stated as expressions, solved and certified."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from ocp.audit import TOLERANCES
from ocp.certificate import Certificate, certify
from ocp.errors import InputError
from ocp.layout import Layout
from ocp.problem import Reference
from ocp.program import PairName, Program, closure_rows
from ocp.routes.complementarity import Route, solve_pairs
from ocp.routes.legs import Homotopy
from ocp.routes.relaxations import STRATEGIES
from ocp.routes.restoration import violation
from ocp.solution import Status
from ocp.solver import Point, Result, Solver

DEFAULTS = ("scholtes-adaptive", "central-path", "scholtes")
"""Strategies in the order in which they are tried, until one ends at a certified point."""


@dataclass(frozen=True, eq=False)
class MPCC:
    """``min f(x, p)`` subject to ``lbg <= g(x, p) <= ubg``, ``lbx <= x <= ubx`` and
    ``0 <= G(x, p) ⟂ H(x, p) >= 0``.

    x (n, 1), p (n_p, 1) are symbols, f (1, 1), g (m, 1), G and H (k, 1) expressions in them. Bounds
    are numbers or sequences; without ``lbg``, ``ubg`` g is an equation. ``names`` (k) name the
    pairs in verdicts.

    Raises :class:`~ocp.errors.InputError` where sizes do not fit, bounds cross, a symbol is not
    declared, or a pair is the same expression twice.
    """

    x: ca.SX
    f: ca.SX
    G: ca.SX
    H: ca.SX
    g: ca.SX = field(default_factory=lambda: ca.SX(0, 1))
    p: ca.SX = field(default_factory=lambda: ca.SX(0, 1))
    lbx: float | Sequence[float] | np.ndarray = -np.inf
    ubx: float | Sequence[float] | np.ndarray = np.inf
    lbg: float | Sequence[float] | np.ndarray = 0.0
    ubg: float | Sequence[float] | np.ndarray = 0.0
    names: Sequence[str] = ()
    name: str = "mpcc"

    def __post_init__(self) -> None:
        for what, value in (("f", self.f), ("g", self.g), ("G", self.G), ("H", self.H)):
            object.__setattr__(self, what, ca.densify(ca.SX(value)))
        self._check_sizes()
        for what, lower, upper in (("x", *self.x_bounds), ("g", *self.g_bounds)):
            crossed = np.flatnonzero(~(lower <= upper))
            if crossed.size:
                i = int(crossed[0])
                raise InputError(
                    f"{self.name}: the bounds of {what}[{i}] cross: {lower[i]:g} > {upper[i]:g};"
                    " exchange or widen them"
                )
        for i in range(self.G.numel()):
            if ca.is_equal(self.G[i], self.H[i], 2):
                raise InputError(
                    f"{self.name}: pair {self.pair(i)!r} is the same expression twice,"
                    f" {self.G[i]}; a pair needs two sides"
                )

    def _check_sizes(self) -> None:
        if self.f.numel() != 1:
            raise InputError(f"{self.name}: f has {self.f.numel()} entries, expected 1")
        if self.G.numel() != self.H.numel():
            raise InputError(
                f"{self.name}: G has {self.G.numel()} entries and H {self.H.numel()}; expected as"
                " many of both"
            )
        if self.names and len(self.names) != self.G.numel():
            raise InputError(
                f"{self.name}: {len(self.names)} names for {self.G.numel()} pairs; give one each"
            )
        known = {str(symbol) for symbol in ca.symvar(ca.vertcat(self.x, self.p))}
        used = ca.symvar(ca.vertcat(self.f, self.g, self.G, self.H))
        strange = sorted({str(symbol) for symbol in used} - known)
        if strange:
            raise InputError(f"{self.name}: {', '.join(strange)} is neither in x nor in p")

    def pair(self, index: int) -> str:
        """Name of a pair."""
        return self.names[index] if self.names else f"pair {index}"

    @property
    def x_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds of x, (n,) each."""
        n = self.x.numel()
        return _sized(self.name, "lbx", self.lbx, n), _sized(self.name, "ubx", self.ubx, n)

    @property
    def g_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds of g, (m,) each."""
        m = self.g.numel()
        return _sized(self.name, "lbg", self.lbg, m), _sized(self.name, "ubg", self.ubg, m)


def _sized(name: str, what: str, value: float | Sequence[float] | np.ndarray, n: int) -> np.ndarray:
    numbers = np.asarray(value, dtype=float).ravel()
    if numbers.size not in (1, n):
        raise InputError(f"{name}: {what} has {numbers.size} entries, expected {n}")
    return np.broadcast_to(numbers, n).copy()


class MPCCProgram(Program):
    """An :class:`MPCC` in one of the forms of :class:`~ocp.program.Program`.

    Every side of a pair that is an entry of x, and of no other pair, is that entry; for any other
    there is a variable with an equation.
    """

    def __init__(self, mpcc: MPCC, form: str, p: np.ndarray) -> None:
        self.mpcc, self.form, self.given = mpcc, form, p
        self.solvers = {}
        sides = [self._side("G", mpcc.G), self._side("H", mpcc.H)]
        self.variables, self.constraints = Layout(), Layout()
        n, k = mpcc.x.numel(), mpcc.G.numel()
        self.variables.add("x", (n,), tuple(str(mpcc.x[i]) for i in range(n)))
        own, places = [mpcc.x], []
        taken: set[int] = set()
        equations = []
        for label, expressions, found in sides:
            at = np.empty(k, dtype=int)
            fresh = []
            for i in range(k):
                place = found[i]
                if place is not None and place not in taken:
                    at[i] = place
                    taken.add(place)
                else:
                    fresh.append(i)
            block = self.variables.add(label, (len(fresh),))
            at[fresh] = block.index
            symbol = ca.SX.sym(label, len(fresh))
            own.append(symbol)
            needed = ca.vertcat(ca.SX(0, 1), *(expressions[i] for i in fresh))
            equations.append((f"{label}_definition", needed - symbol))
            places.append(at)
        self.pairs = np.array(places).reshape(2, k)
        self.x = ca.vertcat(*own)
        penalty, t = ca.SX.sym("penalty"), ca.SX.sym("relaxation")
        first, second = (self.x[[int(i) for i in at]] if k else ca.SX(0, 1) for at in self.pairs)
        rows = [("g", mpcc.g), *equations, *closure_rows(form, first, second, 0.0, t)]
        f = mpcc.f + (penalty * ca.dot(first, second) if form == "none" and k else 0)
        for name, row in rows:
            self.constraints.add(name, (row.numel(),))
        self._differentiate(f, ca.vertcat(*(row for _, row in rows)), penalty, t)

    def _side(self, label: str, side: ca.SX) -> tuple[str, ca.SX, list[int | None]]:
        places = {str(self.mpcc.x[i]): i for i in range(self.mpcc.x.numel())}
        found = [
            places.get(str(side[i])) if side[i].is_symbolic() else None for i in range(side.numel())
        ]
        return label, side, found

    def _differentiate(self, f: ca.SX, g: ca.SX, penalty: ca.SX, t: ca.SX) -> None:
        p = ca.vertcat(self.mpcc.p, penalty, t)
        lam_f, lam_g = ca.SX.sym("lam_f"), ca.SX.sym("lam_g", g.numel())
        given, names = [self.x, p], ["x", "p"]
        lagrangian = lam_f * f + ca.dot(lam_g, g)
        hessian = ca.triu(ca.hessian(lagrangian, self.x)[0])
        more = {"cse": True}
        self.f_g = ca.Function("f_g", given, [f, g], names, ["f", "g"], more)
        gradient = ca.densify(ca.gradient(f, self.x))
        self.gradient = ca.Function("grad_f", given, [f, gradient], names, ["f", "grad_f_x"], more)
        jacobian = ca.jacobian(g, self.x)
        self.jacobian = ca.Function("jac_g", given, [g, jacobian], names, ["g", "jac_g_x"], more)
        self.hessian = ca.Function(
            "hess_lag", [*given, lam_f, lam_g], [hessian],
            [*names, "lam_f", "lam_g"], ["triu_hess_gamma_x_x"], more,
        )  # fmt: skip

    @property
    def title(self) -> str:
        """Name of the problem."""
        return self.mpcc.name

    def parameter_vector(self, values: dict[str, float]) -> np.ndarray:
        """p, then penalty and relaxation."""
        return np.concatenate([self.given, [values["penalty"], values["relaxation"]]])

    def bounds(self, values: dict[str, float]) -> dict[str, np.ndarray]:
        """Bounds of the problem; members of pairs are at least zero."""
        lower, upper = self.mpcc.x_bounds
        lbx = np.full(self.n, -np.inf)
        ubx = np.full(self.n, np.inf)
        lbx[: lower.size], ubx[: upper.size] = lower, upper
        lbx[self.pairs] = np.maximum(lbx[self.pairs], 0.0)
        g_lower, g_upper = self.mpcc.g_bounds
        ends = {"g": (g_lower, g_upper)}
        if "separation" in self.constraints:
            ends["separation"] = (np.zeros(1), np.full(1, np.inf))
        return {
            "lbx": lbx,
            "ubx": ubx,
            "lbg": self.constraints.pack({name: pair[0] for name, pair in ends.items()}),
            "ubg": self.constraints.pack({name: pair[1] for name, pair in ends.items()}),
        }

    def sizes(self, x: np.ndarray) -> np.ndarray:
        """1, or where a variable is larger its own size there."""
        return np.maximum(1.0, np.abs(x))

    def pair_name(self, index: int) -> PairName:
        """Name of a pair, which has neither scenario nor step."""
        return PairName("pair", self.mpcc.pair(index))

    def lifted(self, x: np.ndarray) -> np.ndarray:
        """Add the variables of sides that have their own, at their values at x (n,)."""
        extended = np.zeros(self.n)
        extended[: x.size] = x
        sides = ca.Function("sides", [self.mpcc.x, self.mpcc.p], [self.mpcc.G, self.mpcc.H])
        for at, value in zip(self.pairs, sides(x, self.given), strict=True):
            own = at >= x.size
            extended[at[own]] = np.maximum(np.array(value).ravel()[own], 0.0)
        return extended


@dataclass(frozen=True)
class MPCCSolution:
    """An answer to an :class:`MPCC`: x (n,), G and H (k,) there, cost and certificate.

    ``success`` means feasible to 1e-6 and certified B-stationary, whatever a solver said.
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
    (:mod:`ocp.routes.branches`). The first certified answer is returned, else the best one; where
    none is feasible, constraint violation is minimised over branches and what is left is named.

    Raises :class:`~ocp.errors.InputError` for sizes that do not fit or unknown names.
    """
    began = time.perf_counter()
    start = _sized(mpcc.name, "x0", x0, mpcc.x.numel())
    given = _sized(mpcc.name, "p", p, mpcc.p.numel()) if mpcc.p.numel() else np.zeros(0)
    for name in strategies:
        if name not in STRATEGIES:
            raise InputError(f"unknown strategy {name!r}; there are {', '.join(STRATEGIES)}")
    programs: dict[str, MPCCProgram] = {}

    def program_of(form: str) -> MPCCProgram:
        if form not in programs:
            programs[form] = MPCCProgram(mpcc, form, given)
        return programs[form]

    values = {"penalty": 0.0, "relaxation": 0.0}
    follower = Homotopy(program_of, Solver(solver, dict(options or {})), values)
    inside = np.clip(start, *mpcc.x_bounds)
    reference = Reference(impulse=1.0, gap=1.0)
    best: MPCCSolution | None = None
    for name in strategies:
        route = Route(
            [STRATEGIES[name]()], reference, lambda program: Point(program.lifted(inside))
        )
        result, program, _ = solve_pairs(follower, route)
        found = _judged(program_of("none"), program, result, values, name)
        if best is None or _rank(found) < _rank(best):
            best = found
        if best.success:
            break
    assert best is not None
    spent = {"iterations": follower.trace.iterations, "seconds": time.perf_counter() - began}
    return MPCCSolution(**{**vars(best), **spent})


def _rank(found: MPCCSolution) -> tuple[bool, bool, float]:
    infeasible = found.infeasibility > TOLERANCES["constraint_violation"]
    return infeasible, not found.success, found.infeasibility if infeasible else found.f


def _judged(
    program: MPCCProgram, source: Program, result: Result, values: dict[str, float], name: str
) -> MPCCSolution:
    """Certify a result where it is feasible; else say which constraint is off most."""
    mpcc, x = program.mpcc, program.lifted(result.point.x[: program.mpcc.x.numel()])
    p, bounds = program.parameter_vector(values), program.bounds(values)
    off, worst = violation(program, x, p, bounds)
    sides = ca.Function("sides", [mpcc.x, mpcc.p], [mpcc.G, mpcc.H])
    G, H = (np.array(v).ravel() for v in sides(x[: mpcc.x.numel()], program.given))
    apart = np.abs(np.minimum(G, H))
    if apart.size and apart.max() > off:
        off, worst = float(apart.max()), f"complementarity of {mpcc.pair(int(apart.argmax()))!r}"
    certificate = Certificate("undecided", reason="the point is not feasible")
    status = Status.INEXACT if result.ok else result.status
    if off <= TOLERANCES["constraint_violation"]:
        own = result.point if source is program else None
        certificate = certify(program, x, p, bounds, own.lam_g if own is not None else None)
        decided = {"not": Status.NOT_OPTIMAL, "undecided": Status.UNDECIDED}
        status = decided.get(certificate.stationarity, Status.SOLVED)
    elif result.status in (Status.SOLVED, Status.INFEASIBLE):
        status = Status.INFEASIBLE
    f = float(program.f_g(x, p)[0])
    return MPCCSolution(x[: mpcc.x.numel()], G, H, f, status, certificate, off, worst, name, 0, 0.0)
