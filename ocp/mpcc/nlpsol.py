"""Solve problems with complementarity that are stated as for ``casadi.nlpsol``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from ocp.errors import InputError, NotConverged, choose
from ocp.mpcc.complements import relation_of, relation_of_sides, scalar_graphs
from ocp.mpcc.forms import Graph, Relation, StandardForm
from ocp.mpcc.multipliers import sensitivities
from ocp.mpcc.presolve import Presolved, Values
from ocp.mpcc.programs import MPCC, sized
from ocp.mpcc.solving import Callback, MPCCSolution, solve
from ocp.programs.solver import SOLVERS

ENTRIES = {
    "x": "variables",
    "p": "parameters",
    "f": "cost",
    "g": "constraints between lbg and ubg",
    "pairs": "complementarity: complements(...), or tuples of sides",
}
"""Mapping from the entries of a problem to their meaning."""
OPTIONS = {
    "solver": "name of the NLP solver, by default ipopt",
    "strategies": "names of strategies, by default those of ocp.mpcc.solve",
    "warm_start": "whether later calls begin with the branch nearest to their start, by default the last solution",
    "callback": "function of the number of solver runs so far, and of x after the last one",
    "error_on_fail": "whether a call without a certified solution raises NotConverged",
    **{name: f"dictionary of options of {name}" for name in SOLVERS},
}
"""Mapping from option names to their meaning."""
Numbers = float | Sequence[float] | np.ndarray | ca.DM
"""Numbers of a start, bound or parameter; a single number stands for all entries."""


def mpcc_solver(name: str, problem: Mapping[str, Any], options: Mapping[str, Any] | None = None) -> MPCCSolver:
    """Return a solver of a problem with complementarity, with the interface of a solver from ``casadi.nlpsol``.

    ``problem`` maps ``x``, ``p``, ``f``, ``g`` to expressions as for nlpsol, all SX or all MX, and
    ``pairs`` to one relation or a list of them: tuples ``(a, b)`` for ``0 <= a ⟂ b >= 0``, or results of
    :func:`~ocp.mpcc.complements.complements`. ``options`` are explained in :data:`OPTIONS`.

    Raises :class:`~ocp.errors.InputError` for unknown entries or options, sizes that do not fit, and
    symbols that are neither in x nor in p.
    """
    for entry in problem:
        choose("entry of the problem", entry, ENTRIES)
    if "x" not in problem:
        raise InputError(f"{name}: the problem has no x; give the variables as the entry 'x'")
    x, kind = problem["x"], type(problem["x"])
    f, g = (ca.vec(ca.densify(kind(problem.get(key, default)))) for key, default in (("f", 0), ("g", kind(0, 1))))
    limits = [kind(ca.DM(np.full(g.numel(), end))) for end in (-np.inf, np.inf)]
    symbols = [x, problem.get("p", kind(0, 1))]
    return MPCCSolver(name, presolve(name, symbols, [f, g, *limits], _relations(problem.get("pairs", []))), options)


class Call(NamedTuple):
    """One call of a solver: the problem, its parameters and bounds as passed, and its solution."""

    mpcc: MPCC
    values: Values
    solution: MPCCSolution


class MPCCSolver:
    """Solver of a presolved problem, see :func:`mpcc_solver`.

    Derivatives are built at the first call and compiled solvers are reused: parameters, bounds and
    starts may change from call to call. Rows of g that bound a single variable become bounds, and rows
    that only repeat the sign of a pair's side are left out.
    """

    def __init__(self, name: str, presolved: Presolved, options: Mapping[str, Any] | None = None) -> None:
        for option in options or ():
            choose("option", option, OPTIONS)
        self.name, self.presolved, self.options = name, presolved, dict(options or {})
        self.last: Call | None = None

    def __call__(
        self,
        x0: Numbers | None = None,
        p: Numbers = 0.0,
        lbx: Numbers = -np.inf,
        ubx: Numbers = np.inf,
        lbg: Numbers = -np.inf,
        ubg: Numbers = np.inf,
    ) -> dict[str, Any]:
        """Solve from ``x0`` (n,) and return ``x``, ``f``, ``g``, ``lam_x``, ``lam_g``, ``lam_pairs`` and ``report``.

        The start is by default zero, or the last solution with the option ``warm_start``. Multipliers have
        CasADi's signs; ``lam_pairs`` (k, 2) are those of both sides of every pair; all are NaN if the
        solution is not feasible. ``report`` is the :class:`~ocp.mpcc.solving.MPCCSolution` with verdict,
        certificate and findings.

        Raises :class:`~ocp.errors.InputError` for sizes that do not fit or bounds that cross, and
        :class:`~ocp.errors.NotConverged` for a solution that is not certified if ``error_on_fail`` is set.
        """
        presolved, options = self.presolved, self.options
        numbers = {"p": p, "lbx": lbx, "ubx": ubx, "lbg": lbg, "ubg": ubg}
        values = {key: self._sized(key, value) for key, value in numbers.items()}
        mpcc = presolved.problem(values)
        start = self._start(x0, values["p"])
        solver = options.get("solver", "ipopt")
        solution = solve(
            mpcc,
            start,
            values["p"],
            options.get("strategies"),
            solver,
            dict(options.get(solver, {})),
            bool(options.get("warm_start", False)) and self.last is not None,
            self._callback(),
        )
        self.last = Call(mpcc, values, solution)
        if options.get("error_on_fail", False) and not solution.success:
            raise NotConverged(f"{self.name}: {solution.verdict}")
        return presolved.results(values, solution)

    def _start(self, x0: Numbers | None, p: np.ndarray) -> np.ndarray:
        """Return the start of all variables: new ones are evaluated at x0, or at the last solution."""
        if x0 is None and self.options.get("warm_start", False) and self.last is not None:
            return self.last.solution.x
        return self.presolved.extended(self._sized("x0", 0.0 if x0 is None else x0), p)

    def _sized(self, key: str, numbers: Numbers) -> np.ndarray:
        """Return an argument of a call as a vector of the size that its name implies."""
        presolved = self.presolved
        size = {"x": presolved.n, "g": presolved.m}.get(key[2:3], presolved.p.numel())
        size = presolved.n if key == "x0" else size
        return sized(self.name, key, np.array(ca.vec(ca.DM(numbers))), size)

    def _callback(self) -> Callback | None:
        callback, n = self.options.get("callback"), self.presolved.n
        return None if callback is None else lambda runs, x: callback(runs, x[:n])

    def stats(self) -> dict[str, Any]:
        """Return statistics of the last call, named as those of nlpsol."""
        solution = self._last().solution
        return {
            "success": solution.success,
            "return_status": solution.status.label,
            "iter_count": solution.iterations,
            "t_wall_total": solution.seconds,
        }

    def sensitivity(self) -> dict[str, np.ndarray]:
        """Return derivatives by the parameters at the last solution: ``x`` (n, n_p) and ``f`` (n_p,).

        Raises :class:`~ocp.errors.InputError` if the last solution is not certified or has no derivative.
        """
        mpcc, values, solution = self._last()
        if not solution.success:
            raise InputError(f"{self.name}: the last solution is not certified, so it has no derivatives")
        dx, df = sensitivities(mpcc, solution.x, values["p"], lambda p: self.presolved.bounds({**values, "p": p}))
        return {"x": dx[: self.presolved.n], "f": df}

    def _last(self) -> Call:
        if self.last is None:
            raise InputError(f"{self.name} has not been called yet; solve first")
        return self.last


def presolve(
    name: str,
    symbols: Sequence[Graph],
    expressions: Sequence[Graph],
    relations: Sequence[Relation],
    row_names: Sequence[str] = (),
) -> Presolved:
    """Return the problem of symbols (x, p), expressions (f, g, limits of g) and relations, in scalar graphs.

    Raises :class:`~ocp.errors.InputError` for a cost that is not scalar, and for symbols that are not declared.
    """
    if expressions[0].numel() != 1:
        raise InputError(f"{name}: f has {expressions[0].numel()} entries, expected 1")
    parts = [part for relation in relations for part in (*relation.sides, relation.lower, relation.upper)]
    declared = {symbol.name() for symbol in ca.symvar(ca.veccat(*symbols))}
    unknown = sorted({symbol.name() for symbol in ca.symvar(ca.veccat(*expressions, *parts))} - declared)
    if unknown:
        raise InputError(f"{name}: {', '.join(unknown)} is neither in x nor in p; add it to one of them")
    scalars, (f, g, low, high, *parts) = scalar_graphs([*symbols], [*expressions, *parts])
    form = StandardForm()
    for relation in relations:
        count = len(relation.sides) + 2
        *sides, lower, upper = parts[:count]
        parts = parts[count:]
        form.add(replace(relation, sides=tuple(sides), lower=lower, upper=upper))
    return Presolved(name, scalars, [f, g, low, high], form, row_names)


def _relations(pairs: Any) -> list[Relation]:
    """Return the relations of the entry ``pairs``, each named by its position in the list."""
    entries = pairs if isinstance(pairs, list) else [pairs]
    relations = []
    for number, entry in enumerate(entries):
        relation = relation_of_sides(entry) if isinstance(entry, tuple) else relation_of(entry)
        if relation is None:
            raise InputError(f"pairs[{number}] is {entry}; expected a tuple (a, b) or complements(a, b)")
        relations.append(replace(relation, name=f"pair {number}"))
    return relations
