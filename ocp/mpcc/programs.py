"""A program with complementarity constraints given as expressions, and its reformulations and derivatives."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import Any

import casadi as ca
import numpy as np

from ocp.errors import InputError
from ocp.mpcc.sizes import variable_sizes
from ocp.problem.cost_sizes import split_constant
from ocp.programs.program import PENALTY, RELAXATION, Functions, Layout, PairName, Program, closure_rows
from ocp.programs.units import Scale, cost_unit, row_units, solver_unit

ORDINARY_VARIABLES = 3
"""Exponent of two up to which the size of a variable counts as 1; steps of larger sizes would decide optimality."""


@dataclass(frozen=True, eq=False)
class MPCC:
    """Mathematical program with complementarity constraints.

    ``min f(x, p)`` subject to ``lbg <= g(x, p) <= ubg``, ``lbx <= x <= ubx`` and ``0 <= G(x, p) ⟂ H(x, p) >= 0``.

    x (n, 1), p (n_p, 1) are symbols, f (1, 1), g (m, 1), G and H (k, 1) expressions in them. Bounds
    are numbers or sequences; by default g is an equation. ``names`` (k) are the names of the pairs in
    verdicts, ``row_names`` (m) those of g.

    Raises :class:`~ocp.errors.InputError` if sizes do not fit, a lower bound exceeds an upper bound, a
    symbol is not declared, or both members of a pair are the same expression.
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
    row_names: Sequence[str] = ()

    def __post_init__(self) -> None:
        for label, value in (("f", self.f), ("g", self.g), ("G", self.G), ("H", self.H)):
            object.__setattr__(self, label, ca.densify(ca.SX(value)))
        self._check_sizes()
        for label, lower, upper in (("x", *self.x_bounds), ("g", *self.g_bounds)):
            crossed = np.flatnonzero(~(lower <= upper))
            if crossed.size:
                i = int(crossed[0])
                cross = f"the bounds of {label}[{i}] cross: {lower[i]:g} > {upper[i]:g}"
                raise InputError(f"{self.name}: {cross}; exchange or widen them")
        for i in range(self.G.numel()):
            if ca.is_equal(self.G[i], self.H[i], 2):
                raise InputError(
                    f"{self.name}: pair {self.pair(i)!r} is the same expression twice,"
                    f" {self.G[i]}; a pair needs two sides"
                )

    def _check_sizes(self) -> None:
        if not self.x.numel():
            raise InputError(f"{self.name}: the problem has no variables, expected one or more")
        if self.f.numel() != 1:
            raise InputError(f"{self.name}: f has {self.f.numel()} entries, expected 1")
        if self.G.numel() != self.H.numel():
            raise InputError(
                f"{self.name}: G has {self.G.numel()} entries and H {self.H.numel()}; expected as many of both"
            )
        if self.names and len(self.names) != self.G.numel():
            raise InputError(f"{self.name}: {len(self.names)} names for {self.G.numel()} pairs; give one each")
        names = {str(symbol) for symbol in ca.symvar(ca.vertcat(self.x, self.p))}
        used_symbols = ca.symvar(ca.vertcat(self.f, self.g, self.G, self.H))
        unknown = sorted({str(symbol) for symbol in used_symbols} - names)
        if unknown:
            raise InputError(f"{self.name}: {', '.join(unknown)} is neither in x nor in p")

    def pair(self, index: int) -> str:
        """Return the name of the pair with the index ``index``."""
        return self.names[index] if self.names else f"pair {index}"

    @cached_property
    def lifted(self) -> Lifted:
        """The problem with slack variables and derivatives."""
        return Lifted(self)

    def with_bounds(self, lbx: np.ndarray, ubx: np.ndarray, lbg: np.ndarray, ubg: np.ndarray) -> MPCC:
        """Return the problem with other bounds; derivatives and solvers are shared if signs of lbx agree."""
        bounded = replace(self, lbx=lbx, ubx=ubx, lbg=lbg, ubg=ubg)
        if np.array_equal(self.x_bounds[0] <= 0, bounded.x_bounds[0] <= 0):
            bounded.__dict__["lifted"] = self.lifted
        return bounded

    @property
    def x_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds of x, (n,) each."""
        n = self.x.numel()
        return sized(self.name, "lbx", self.lbx, n), sized(self.name, "ubx", self.ubx, n)

    @property
    def g_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds of g, (m,) each."""
        m = self.g.numel()
        return sized(self.name, "lbg", self.lbg, m), sized(self.name, "ubg", self.ubg, m)


def sized(name: str, label: str, value: float | Sequence[float] | np.ndarray, n: int) -> np.ndarray:
    """Return numbers as a vector (n,), repeating a single number; raise :class:`InputError` for another size."""
    numbers = np.asarray(value, dtype=float).ravel()
    if numbers.size not in (1, n):
        raise InputError(f"{name}: {label} has {numbers.size} entries, expected {n}")
    return np.broadcast_to(numbers, n).copy()


class Lifted:
    """An :class:`~ocp.mpcc.MPCC` with slack variables, so that pairs are entries of x, and its derivatives.

    A side of a pair stays an entry of x if it is one, occurs in no other pair and has no lower bound above
    zero; any other side becomes a slack variable with an equation. Common subexpressions are
    eliminated once before differentiation, which is cheaper than in every derivative.
    """

    def __init__(self, mpcc: MPCC) -> None:
        self.mpcc = mpcc
        varying, constant = split_constant(mpcc.f, mpcc.x)
        self.constant = ca.Function("constant", [mpcc.p], [constant])
        f, *expressions = ca.cse([varying, mpcc.g, mpcc.G, mpcc.H])
        self.variables, self.constraints = Layout(), Layout()
        n, k = mpcc.x.numel(), mpcc.G.numel()
        self.variables.add("x", (n,), tuple(str(mpcc.x[i]) for i in range(n)))
        self.constraints.add("g", (mpcc.g.numel(),), tuple(mpcc.row_names))
        symbols, rows, pair_positions, taken_entries = [mpcc.x], [expressions[0]], [], set()
        for label, sides in (("G", expressions[1]), ("H", expressions[2])):
            positions = self._entries(sides, taken_entries)
            fresh = np.flatnonzero(positions < 0)
            positions[fresh] = self.variables.add(label, (fresh.size,)).index
            titles = tuple(f"{label} >= 0 of {mpcc.pair(int(i))!r}" for i in fresh)
            self.constraints.add(f"{label}_definition", (fresh.size,), titles)
            symbol = ca.SX.sym(label, fresh.size)
            symbols.append(symbol)
            rows.append(sides[[int(i) for i in fresh]] - symbol if fresh.size else ca.SX(0, 1))
            pair_positions.append(positions)
        self.pairs = np.array(pair_positions).reshape(2, k)
        self.x, self.f, self.g = ca.vertcat(*symbols), f, ca.vertcat(*rows)
        self.lam_f, self.lam_g = ca.SX.sym("lam_f"), ca.SX.sym("lam_g", self.g.numel())
        self.gradient, self.jacobian = ca.gradient(f, self.x), ca.jacobian(self.g, self.x)
        lagrangian = self.lam_f * f + ca.dot(self.lam_g, self.g)
        self.hessian = ca.triu(ca.hessian(lagrangian, self.x)[0])
        self.sides = ca.Function("sides", [mpcc.x, mpcc.p], [mpcc.G, mpcc.H])
        self.solvers: dict[str, dict[str, Any]] = {}
        self._closed: dict[str, tuple[Functions, Layout]] = {}

    def close(self, reformulation: str) -> tuple[Functions, Layout]:
        """Return functions and constraints of a reformulation, which is differentiated at its first use."""
        if reformulation not in self._closed:
            k, constraints = self.pairs.shape[1], Layout()
            for name, block in self.constraints.blocks.items():
                constraints.add(name, block.shape, block.components)
            first, second = (self.x[[int(i) for i in indices]] if k else ca.SX(0, 1) for indices in self.pairs)
            penalty, t = ca.SX.sym("penalty"), ca.SX.sym("relaxation")
            rows = closure_rows(reformulation, first, second, 0.0, t)
            for name, row in rows:
                constraints.add(name, (row.numel(),))
            penalised = penalty * ca.dot(first, second) if reformulation == "none" and k else ca.SX(0)
            closure = ca.vertcat(ca.SX(0, 1), *(row for _, row in rows))
            functions = self._functions(penalised, closure, ca.vertcat(self.mpcc.p, penalty, t))
            self._closed[reformulation] = functions, constraints
        return self._closed[reformulation]

    def _functions(self, penalised: ca.SX, closure: ca.SX, p: ca.SX) -> Functions:
        """Return the program's functions from derivatives of problem, penalty and ``closure`` constraints."""
        x, lam_closure = self.x, ca.SX.sym("lam_closure", closure.numel())
        f, g = self.f + penalised, ca.vertcat(self.g, closure)
        gradient = ca.densify(self.gradient + ca.gradient(penalised, x))
        jacobian = ca.vertcat(self.jacobian, ca.jacobian(closure, x))
        closing = self.lam_f * penalised + ca.dot(lam_closure, closure)
        hessian = self.hessian + ca.triu(ca.hessian(closing, x)[0])
        lam_g = ca.vertcat(self.lam_g, lam_closure)
        return Functions.of((x, p, self.lam_f, lam_g), (f, g), (f, gradient), (g, jacobian), hessian)

    def _entries(self, sides: ca.SX, taken_entries: set[int]) -> np.ndarray:
        """Return the indices in x of the sides that are entries of x, -1 for the others."""
        x, (lower, _) = self.mpcc.x, self.mpcc.x_bounds
        index_by_hash = {x[i].element_hash(): i for i in range(x.numel()) if lower[i] <= 0}
        entries = np.full(sides.numel(), -1)
        for i in range(sides.numel()):
            position = index_by_hash.get(sides[i].element_hash(), -1) if sides[i].is_symbolic() else -1
            if position not in taken_entries:
                entries[i] = position
                taken_entries |= {position} - {-1}
        return entries


def programs_of(mpcc: MPCC, p: np.ndarray, start: np.ndarray) -> Callable[[str], MPCCProgram]:
    """Return a function from a reformulation to the program of ``mpcc`` at p; it builds each program once.

    Sizes of variables and cost are derived at ``start`` (n,).
    """
    return cache(lambda reformulation: MPCCProgram(mpcc, reformulation, p, start))


BoundsAt = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]
"""Function from the parameters to lower and upper bounds of x, then of g."""


class MPCCProgram(Program):
    """The program of an :class:`~ocp.mpcc.MPCC`, in one reformulation of :class:`~ocp.programs.program.Program`.

    Bounds are those of the problem, or ``bounds_at`` the parameters.
    """

    def __init__(
        self, mpcc: MPCC, reformulation: str, p: np.ndarray, start: np.ndarray, bounds_at: BoundsAt | None = None
    ) -> None:
        self.bounds_at = bounds_at or (lambda p: (*mpcc.x_bounds, *mpcc.g_bounds))
        self.mpcc, self.lifted, self.p_values = mpcc, mpcc.lifted, p
        self.reformulation, self.start = reformulation, start
        self.variables, self.pairs = self.lifted.variables, self.lifted.pairs
        functions, self.constraints = self.lifted.close(reformulation)
        self.f_g, self.gradient, self.jacobian, self.hessian = functions
        self.solvers = self.lifted.solvers.setdefault(reformulation, {})

    @property
    def title(self) -> str:
        """Name of the problem."""
        return self.mpcc.name

    def parameter_vector(self, values: dict[str, float]) -> np.ndarray:
        """Return the parameters p, or named values ``p[i]`` instead of theirs, then penalty and relaxation."""
        p = [values.get(f"p[{i}]", value) for i, value in enumerate(self.p_values)]
        return np.array([*p, values[PENALTY], values[RELAXATION]])

    def bounds(self, values: dict[str, float]) -> dict[str, np.ndarray]:
        """Return the bounds of the problem, with members of pairs at least zero."""
        lower, upper, g_lower, g_upper = self.bounds_at(self.parameter_vector(values)[:-2])
        lbx = np.full(self.n, -np.inf)
        ubx = np.full(self.n, np.inf)
        lbx[: lower.size], ubx[: upper.size] = lower, upper
        lbx[self.pairs] = np.maximum(lbx[self.pairs], 0.0)
        ends = {"g": (g_lower, g_upper)}
        if "separation" in self.constraints:
            ends["separation"] = (np.zeros(1), np.full(1, np.inf))
        return {
            "lbx": lbx,
            "ubx": ubx,
            "lbg": self.constraints.pack({name: pair[0] for name, pair in ends.items()}),
            "ubg": self.constraints.pack({name: pair[1] for name, pair in ends.items()}),
        }

    def constant(self, p: np.ndarray) -> float:
        """Return the constant terms of the cost, which are not in ``f``."""
        return float(self.lifted.constant(p[:-2]))

    def sizes(self, x: np.ndarray) -> np.ndarray:
        """Return the unit of each variable (n,), or its absolute value at x if that is larger."""
        return np.maximum(self.units, np.abs(x))

    @cached_property
    def units(self) -> np.ndarray:
        """Power of two nearest to the derived size of each variable (n,), 1 for ordinary sizes."""
        return self.units_at(self.start)

    def units_at(self, start: np.ndarray) -> np.ndarray:
        """Return the :attr:`units` derived at another start (n_x,)."""
        sizes = variable_sizes(self, self.extended(start), self._unpenalised_parameters)
        return solver_unit(sizes, ORDINARY_VARIABLES)

    @cached_property
    def _unpenalised_parameters(self) -> np.ndarray:
        return self.parameter_vector({PENALTY: 0.0, RELAXATION: 0.0})

    @cached_property
    def scale(self) -> Scale | None:
        """Units of variables, rows and cost for a solver; None if all are 1.

        The unit of the cost is the :func:`~ocp.programs.units.cost_unit` of its largest change by one
        variable or one pair of variables. If changes by all variables were added, a penalty far from its minimum would
        outweigh the rest of the cost.
        """
        x, p = self.units, self._unpenalised_parameters
        point = self.extended(self.start)
        hessian = np.abs(self.hessian(point, p, 1.0, np.zeros(self.m)).sparse()).tocoo()
        sizes = self.sizes(point)
        changes = (
            np.abs(self.first_derivatives(point, p)[0]) * sizes,
            hessian.data * sizes[hessian.row] * sizes[hessian.col],
        )
        f = cost_unit(_largest(change.max(initial=0.0) for change in changes))
        g = row_units(x, lambda z, p: (0.0, self.first_derivatives(z, p)[2]), p)
        if "contact" in self.constraints:
            g[self.constraints["contact"].index] = x[self.pairs].prod(axis=0)
        return None if f == 1 and np.all(x == 1) and np.all(g == 1) else Scale(x, g, f)

    def pair_name(self, index: int) -> PairName:
        """Return the name of a pair, without scenario and step."""
        return PairName("pair", self.mpcc.pair(index))

    def extended(self, x: np.ndarray) -> np.ndarray:
        """Return ``x`` (n_x,) with the slack variables appended: the sides of pairs at x, but at least zero."""
        extended_x = np.zeros(self.n)
        extended_x[: x.size] = x
        for positions, value in zip(self.pairs, self.lifted.sides(x, self.p_values), strict=True):
            is_own = positions >= x.size
            extended_x[positions[is_own]] = np.maximum(np.array(value).ravel()[is_own], 0.0)
        return extended_x


def _largest(values: Iterable[float]) -> float:
    """Return the largest finite value, at least zero."""
    return max((float(value) for value in values if np.isfinite(value)), default=0.0)
