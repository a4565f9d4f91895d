"""Solve problems with complementarity that are stated as for ``casadi.nlpsol``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from ocp.errors import InputError, NotConverged, choose
from ocp.mpcc.complements import expression_of, relation_of, relation_of_sides, scalar_graphs
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

    Raises :class:`~ocp.errors.InputError` for unknown entries or options, values of another type, sizes that do
    not fit, and symbols that are neither in x nor in p, or twice there.
    """
    _check_mapping(f"{name}: the problem", problem, "{'x': ..., 'f': ..., 'pairs': [...]}")
    for entry in problem:
        choose("entry of the problem", entry, ENTRIES)
    if "x" not in problem:
        raise InputError(f"{name}: the problem has no x; give the variables as the entry 'x'")
    kind: Any = type(problem["x"])
    symbols = [problem["x"], problem.get("p", kind(0, 1) if kind in (ca.SX, ca.MX) else None)]
    _check_symbols(name, symbols)
    expressions = ((key, problem.get(key, default)) for key, default in (("f", 0), ("g", kind(0, 1))))
    f, g = (ca.vec(expression_of(kind, value, f"{name}: {key}")) for key, value in expressions)
    limits = [kind(ca.DM(np.full(g.numel(), end))) for end in (-np.inf, np.inf)]
    relations = _relations(problem.get("pairs", []), kind)
    return MPCCSolver(name, presolve(name, symbols, [f, g, *limits], relations), options)


def _check_mapping(title: str, value: Any, example: str) -> None:
    """Raise InputError for a value that is no mapping."""
    if not isinstance(value, Mapping):
        raise InputError(f"{title} is a {type(value).__name__}; expected a dictionary such as {example}")


def _check_symbols(name: str, symbols: list[Any]) -> None:
    """Raise InputError unless x and p are columns of symbols, all SX or all MX, each symbol once."""
    for entry, symbol in zip("xp", symbols, strict=True):
        is_column = isinstance(symbol, ca.SX | ca.MX) and symbol.is_column() and symbol.is_dense()
        if not is_column or not symbol.is_valid_input() or type(symbol) is not type(symbols[0]):
            symbol_text = " ".join(str(symbol)[:60].split())
            raise InputError(
                f"{name}: {entry} is {symbol_text}; expected a column of symbols, SX or MX as x is,"
                " such as vertcat(a, b) or vec(A)"
            )
    stacked = ca.veccat(*symbols)
    if sum(symbol.numel() for symbol in ca.symvar(stacked)) < stacked.numel():
        raise InputError(f"{name}: a symbol occurs twice in x and p; state each symbol once")


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
        self.name, self.presolved, self.options = name, presolved, _checked_options(name, options)
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
        try:
            values = sized(self.name, key, np.array(ca.vec(ca.DM(numbers))), size)
        except (NotImplementedError, TypeError) as error:
            raise InputError(f"{self.name}: {key} is {numbers!r}; expected numbers") from error
        is_wrong = np.isnan(values) if key[:2] in ("lb", "ub") else ~np.isfinite(values)
        if is_wrong.any():
            index = int(np.flatnonzero(is_wrong)[0])
            expected = "a number" if key[:2] in ("lb", "ub") else "a finite number"
            raise InputError(f"{self.name}: {key}[{index}] is {values[index]}, expected {expected}")
        return values

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


def _checked_options(name: str, options: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return a copy of the options; raise InputError for an unknown one, or a value of another type."""
    _check_mapping(f"{name}: options", options or {}, "{'warm_start': True}")
    values = dict(options or {})
    for option, value in values.items():
        choose("option", option, OPTIONS)
        if option in SOLVERS:
            _check_mapping(f"{name}: option {option!r}", value, "{'max_iter': 500}")
    expected = {"solver": (str, "a name"), "strategies": (list | tuple | None, "a list of names")}
    expected |= dict.fromkeys(("warm_start", "error_on_fail"), (bool, "True or False"))
    for option, (kind, meaning) in expected.items():
        if option in values and not isinstance(values[option], kind):
            raise InputError(f"{name}: option {option!r} is {values[option]!r}; expected {meaning}")
    if not all(isinstance(strategy, str) for strategy in values.get("strategies") or ()):
        raise InputError(f"{name}: option 'strategies' is {values['strategies']!r}; expected a list of names")
    if not callable(values.get("callback") or print):
        raise InputError(f"{name}: option 'callback' is {values['callback']!r}; expected a function")
    return values


def presolve(
    name: str,
    symbols: Sequence[Graph],
    expressions: Sequence[Graph],
    relations: Sequence[Relation],
    row_names: Sequence[str] = (),
) -> Presolved:
    """Return the problem of symbols (x, p), expressions (f, g, limits of g) and relations, in scalar graphs.

    Raises :class:`~ocp.errors.InputError` for a cost that is not scalar, for symbols that are not declared, and for
    entries of f and g that are NaN or infinite everywhere.
    """
    if expressions[0].numel() != 1:
        raise InputError(f"{name}: f has {expressions[0].numel()} entries, expected 1")
    relation_expressions = [
        part for relation in relations for part in (*relation.sides, relation.lower, relation.upper)
    ]
    declared = {symbol.name() for symbol in ca.symvar(ca.veccat(*symbols))}
    unknown = sorted({symbol.name() for symbol in ca.symvar(ca.veccat(*expressions, *relation_expressions))} - declared)
    if unknown:
        raise InputError(f"{name}: {', '.join(unknown)} is neither in x nor in p; add it to one of them")
    scalars, (f, g, low, high, *relation_expressions) = scalar_graphs([*symbols], [*expressions, *relation_expressions])
    for title, vector in (("f", f), ("g", g)):
        wrong = [value for value in ca.vertsplit(vector) if value.is_constant() and not np.isfinite(float(value))]
        if wrong:
            raise InputError(f"{name}: {title} has an entry that is always {float(wrong[0]):g}; expected a finite one")
    form = StandardForm()
    for relation in relations:
        count = len(relation.sides) + 2
        *sides, lower, upper = relation_expressions[:count]
        relation_expressions = relation_expressions[count:]
        form.add(replace(relation, sides=tuple(sides), lower=lower, upper=upper))
    return Presolved(name, scalars, [f, g, low, high], form, row_names)


def _relations(pairs: Any, kind: Any) -> list[Relation]:
    """Return the relations in the entry ``pairs``, as SX or MX, each named by its position in the list."""
    entries = pairs if isinstance(pairs, list) else [pairs]
    relations = []
    for number, entry in enumerate(entries):
        relation = relation_of_sides(entry) if isinstance(entry, tuple) else relation_of(entry)
        if relation is None:
            raise InputError(f"pairs[{number}] is {entry}; expected a tuple (a, b) or complements(a, b)")
        if not isinstance(relation.sides[0], kind):
            used = type(relation.sides[0]).__name__
            raise InputError(f"pairs[{number}] is an expression of {used}, and x is {kind.__name__}; use one of them")
        relations.append(replace(relation, name=f"pair {number}"))
    return relations
