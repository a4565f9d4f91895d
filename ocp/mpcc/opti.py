"""Solve problems of ``casadi.Opti`` whose constraints include complementarity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from ocp.errors import InputError, NotConverged
from ocp.mpcc.complements import relation_of
from ocp.mpcc.forms import Relation
from ocp.mpcc.nlpsol import MPCCSolver, presolve
from ocp.mpcc.solving import MPCCSolution


def opti(stack: ca.Opti, **options: Any) -> OptiSolver:
    """Return a ``casadi.Opti`` whose ``solve()`` respects constraints of :func:`~ocp.mpcc.complements.complements`.

    In a script that builds ``opti = casadi.Opti()``, replace ``opti.solve()`` by
    ``ocp.opti(opti).solve()``, or add ``opti = ocp.opti(opti)`` before a loop of solves. ``options``
    are those of :func:`~ocp.mpcc.nlpsol.mpcc_solver`; what ``opti.solver(...)`` says is not used.

    Raises :class:`~ocp.errors.InputError` for anything but a ``casadi.Opti``.
    """
    if not isinstance(stack, ca.Opti):
        raise InputError(f"ocp.opti() got a {type(stack).__name__}; expected a casadi.Opti")
    return OptiSolver(stack, options)


@dataclass(frozen=True)
class Stack:
    """Contents of a ``casadi.Opti``: a snapshot, its complementarity relations, and all other constraints (``plain``).

    ``rows`` are the indices of the plain constraints in the ``g`` of the Opti, and ``row_names`` their names.
    """

    snapshot: Any
    plain: list[Any]
    rows: list[int]
    row_names: list[str]
    relations: list[Relation]

    @classmethod
    def read(cls, stack: ca.Opti) -> Stack:
        """Return the contents of an Opti; raise :class:`~ocp.errors.InputError` for integer variables."""
        snapshot: Any = stack.debug
        snapshot.bake()
        contents = cls(snapshot, [], [], [], [])
        for symbol in snapshot.active_symvar(ca.OPTI_VAR):
            if snapshot.get_meta(symbol).domain != ca.OPTI_DOMAIN_REAL:
                raise InputError(f"{symbol.name()} is an integer variable; complementarity needs real ones")
        for constraint in snapshot.constraints():
            meta = snapshot.get_meta_con(constraint)
            location, rows = _source_line(meta.extra), range(meta.start, meta.stop)
            relation = relation_of(meta.canon)
            if relation is not None:
                contents.relations.append(replace(relation, name=location or "pair"))
                continue
            contents.plain.append(ca.vec(meta.canon))
            contents.rows.extend(rows)
            single = len(rows) == 1
            contents.row_names.extend(f"{location or 'g'}{'' if single else [i]}" for i in range(len(rows)))
        return contents

    @property
    def symbols(self) -> list[Any]:
        """Symbols of variables and of parameters, each stacked in the order of the Opti."""
        kinds = (ca.OPTI_VAR, ca.OPTI_PAR)
        return [ca.veccat(ca.MX(0, 1), *self.snapshot.active_symvar(kind)) for kind in kinds]

    @property
    def expressions(self) -> list[Any]:
        """Cost, plain constraints, and their lower and upper limits."""
        limits = [end[self.rows] if self.rows else ca.MX(0, 1) for end in (self.snapshot.lbg, self.snapshot.ubg)]
        return [ca.densify(self.snapshot.f), ca.veccat(ca.MX(0, 1), *self.plain), *limits]

    @property
    def digest(self) -> tuple[int, ...]:
        """Identities of all expressions, equal for equal problems while both snapshots exist."""
        snapshot = self.snapshot
        symbols = [*snapshot.active_symvar(ca.OPTI_VAR), *snapshot.active_symvar(ca.OPTI_PAR)]
        expressions = (snapshot.objective(), *snapshot.constraints(), *symbols)
        return tuple(expression.__hash__() for expression in expressions)

    def parameters(self) -> np.ndarray:
        """Return the values of the parameters (n_p,); raise :class:`~ocp.errors.InputError` if one has no value."""
        try:
            return np.atleast_1d(self.snapshot.value(self.snapshot.p, self.snapshot.value_parameters()))
        except RuntimeError as error:
            line = next((line.strip() for line in str(error).splitlines() if "Opti parameter" in line), str(error))
            raise InputError(f"{line}, has no value; set it with opti.set_value") from error

    def store(self, result: dict[str, Any]) -> None:
        """Store a result in the snapshot, so that ``snapshot.value`` evaluates expressions at this result."""
        snapshot = self.snapshot
        lam_g, x, scale, offset, row_scale = (
            np.array(vector).ravel()
            for vector in (
                np.full(snapshot.ng, np.nan),
                result["x"],
                snapshot.x_linear_scale,
                snapshot.x_linear_scale_offset,
                snapshot.g_linear_scale,
            )
        )
        lam_g[self.rows] = np.array(result["lam_g"]).ravel()
        lam_g *= row_scale / float(snapshot.f_linear_scale)
        snapshot.res({"x": ca.DM((x - offset) / scale), "f": result["f"], "lam_g": ca.DM(lam_g)})


class OptiSolver:
    """Opti with complementarity, see :func:`opti`; all other attributes are those of the ``casadi.Opti``.

    ``value(expression)`` and ``debug.value(expression)`` are at the solution, and in a callback set by
    ``opti.callback`` at the last result of the NLP solver.
    """

    def __init__(self, stack: ca.Opti, options: dict[str, Any]) -> None:
        self.stack, self.options = stack, options
        self._built: tuple[Stack, MPCCSolver] | None = None
        self._contents: Stack | None = None

    def solve(self) -> OptiSolution:
        """Return the certified solution; raise :class:`~ocp.errors.NotConverged` if no solution is certified."""
        solution = self.solve_limited()
        if not solution.report.success:
            raise NotConverged(f"Solver failed: {solution.verdict}")
        return solution

    def solve_limited(self) -> OptiSolution:
        """Return the solution, certified or not.

        Raises :class:`~ocp.errors.InputError` for integer variables, and for parameters without a value.
        """
        contents = self._contents = Stack.read(self.stack)
        solver, snapshot = self._solver(contents), contents.snapshot
        p = contents.parameters()
        result = solver(x0=np.atleast_1d(snapshot.value(snapshot.x, snapshot.initial())), p=p)
        contents.store(result)
        return OptiSolution(contents, solver, result["report"])

    def _solver(self, contents: Stack) -> MPCCSolver:
        """Return the solver of the contents; the last solver is reused if only values have changed."""
        if self._built is None or self._built[0].digest != contents.digest:
            options = {"callback": self._callback, **self.options}
            presolved = presolve("opti", contents.symbols, contents.expressions, contents.relations, contents.row_names)
            self._built = contents, MPCCSolver("opti", presolved, options)
        return self._built[1]

    def _callback(self, runs: int, x: np.ndarray) -> None:
        """Call the function that ``opti.callback`` has set, with the values at x (n,) in :attr:`debug`."""
        callback = vars(self.stack).get("_fh")
        if callback is not None and self._contents is not None:
            zeros = np.zeros(len(self._contents.rows))
            self._contents.store({"x": x, "f": 0.0, "lam_g": zeros})
            callback(runs)

    @property
    def debug(self) -> Any:
        """Snapshot of the Opti at the last result."""
        return self.stack.debug if self._contents is None else self._contents.snapshot

    def value(self, expression: Any, values: Sequence[Any] = ()) -> Any:
        """Return the value of an expression at the last result, as ``Opti.value``."""
        return self.debug.value(expression, [*values])

    def __getattr__(self, name: str) -> Any:
        """Return an attribute of the Opti."""
        return getattr(self.stack, name)


@dataclass(frozen=True)
class OptiSolution:
    """Solution of an Opti, with the methods of ``casadi.OptiSol``, and its ``report`` with the certificate.

    Other attributes, such as ``value_variables``, are those of :attr:`opti`.
    """

    contents: Stack
    solver: MPCCSolver
    report: MPCCSolution

    @property
    def verdict(self) -> str:
        """Status, cost, certificate and findings in a sentence or two."""
        return self.report.verdict

    @property
    def opti(self) -> Any:
        """Snapshot of the Opti at the solution."""
        return self.contents.snapshot

    def value(self, expression: Any, values: Sequence[Any] = ()) -> Any:
        """Return the value of an expression at the solution; ``values`` may hold other values of symbols.

        The dual of a complementarity constraint is NaN; ``report.multipliers`` has the multipliers of its sides.
        """
        return self.opti.value(expression, [*values])

    def stats(self) -> dict[str, Any]:
        """Return statistics of the solve."""
        return self.solver.stats()

    def __getattr__(self, name: str) -> Any:
        """Return an attribute of the snapshot."""
        return getattr(self.opti, name)

    def sensitivity(self, expression: Any, parameter: Any) -> np.ndarray:
        """Return the derivative (k, n_p) of an expression (k,) at the solution by a parameter (n_p,) of the Opti.

        Raises :class:`~ocp.errors.InputError` if the solution has no derivative (see
        :func:`~ocp.mpcc.multipliers.sensitivities`), or if the Opti was solved again since.
        """
        if self.solver.last is None or self.solver.last.solution is not self.report:
            raise InputError("sensitivities belong to the last solve; ask for them before the next one")
        symbols, vector = self.contents.symbols, ca.vec(ca.MX(expression))
        if not (isinstance(parameter, ca.MX) and ca.depends_on(parameter, symbols[1])):
            raise InputError(f"{parameter} is no parameter of this Opti; derivatives are by an opti.parameter()")
        dx = self.solver.sensitivity()["x"]
        by_x, by_p = (self._numbers(ca.jacobian(vector, symbol)) for symbol in symbols)
        chosen = self._numbers(ca.jacobian(ca.vec(parameter), symbols[1]))
        return (by_x @ dx + by_p) @ chosen.T

    def _numbers(self, matrix: ca.MX) -> np.ndarray:
        values = self.contents.snapshot.value(ca.densify(matrix))
        return np.reshape(values, matrix.shape)


def _source_line(extra: dict[str, Any]) -> str:
    """Return the line and file in which a constraint was stated, "" if they are not known."""
    frames = extra.get("stacktrace", ())
    return f"line {frames[0]['line']} of {Path(frames[0]['file']).name}" if frames else ""
