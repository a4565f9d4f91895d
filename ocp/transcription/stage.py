"""Stages that are differentiated once, mapped over all copies and scattered into a sparse NLP.

A :class:`Stage` is a cost and constraints in a few local variables; :func:`assemble` gathers these for every copy
from the decision vector, maps the stage's derivatives over the copies, and scatters them into gradient, Jacobian and
Hessian. The set-up cost is that of a single stage.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from ocp.programs.program import Functions
from ocp.transcription.eliminated import Compile, EliminatedUnknowns

COMPARISONS = frozenset({ca.OP_LT, ca.OP_LE})
"""Codes of the operations that compare numbers."""
ROUNDABLE = frozenset({ca.OP_FMAX, ca.OP_FMIN, ca.OP_FABS})
"""Codes of the operations with a kink that may be rounded."""


@dataclass(eq=False)
class Stage:
    """A cost (1,) and constraints (nc,) in local variables ``w`` (nw,), used for a number of ``copies``.

    ``index`` (copies, nw) are the indices of each copy's local variables in ``[x; data]``, ``rows``
    (copies, nc) those of its constraints in g; ``weight`` scales the cost. ``eliminated`` are unknowns
    that w determines, or None; all derivatives account for the dependence of these unknowns on w.
    """

    name: str
    w: ca.SX
    p: ca.SX
    cost: ca.SX
    constraints: ca.SX
    index: np.ndarray
    rows: np.ndarray
    weight: float = 1.0
    eliminated: EliminatedUnknowns | None = None

    def __post_init__(self) -> None:
        self.copies = self.index.shape[0]
        self.cost = self.weight * ca.densify(ca.SX(self.cost))
        self.constraints = ca.densify(ca.vertcat(ca.SX(0, 1), self.constraints))
        self.arguments = [self.w, self.p, self.eliminated.symbols if self.eliminated else ca.SX(0, 1)]

    @cached_property
    def operations(self) -> set[int]:
        """Codes of the operations in the cost and the constraints."""
        graph = ca.Function("graph", self.arguments, [self.cost, self.constraints])
        return {graph.instruction_id(k) for k in range(graph.n_instructions())}

    def values(self) -> ca.Function:
        """Return the function ``(w, p, eliminated) -> (cost, constraints)``."""
        return self._function("values", self.arguments, [self.cost, self.constraints])

    def first(self) -> tuple[ca.Function, ca.Sparsity]:
        """Return ``(w, p, eliminated) -> (cost, constraints, gradient, Jacobian nonzeros)``, and the pattern."""
        gradient = self._total(self.cost).T
        jacobian = self._total(self.constraints)
        outputs = [self.cost, self.constraints, ca.densify(gradient), _nonzeros(jacobian)]
        return self._function("first", self.arguments, outputs), jacobian.sparsity()

    def cost_value(self) -> ca.Function:
        """Return the function ``(w, p, eliminated) -> cost``."""
        return self._function("cost", self.arguments, [self.cost])

    def constraint_values(self) -> ca.Function:
        """Return the function ``(w, p, eliminated) -> constraints``."""
        return self._function("constraints", self.arguments, [self.constraints])

    def cost_slope(self) -> ca.Function:
        """Return the function ``(w, p, eliminated) -> (cost, gradient)``."""
        gradient = ca.densify(self._total(self.cost).T)
        return self._function("slope", self.arguments, [self.cost, gradient])

    def constraint_slopes(self) -> tuple[ca.Function, ca.Sparsity]:
        """Return the function ``(w, p, eliminated) -> (constraints, Jacobian nonzeros)`` and the Jacobian's pattern."""
        jacobian = self._total(self.constraints)
        outputs = [self.constraints, _nonzeros(jacobian)]
        return self._function("slopes", self.arguments, outputs), jacobian.sparsity()

    def second(self) -> tuple[ca.Function, ca.Sparsity]:
        """Return the function ``(w, p, eliminated, s, m, curvatures) -> Hessian nonzeros`` and the Hessian's pattern.

        The Hessian is the upper triangle for ``s cost + m' c``; ``curvatures`` is an argument only if ``eliminated``
        has it.
        """
        lagrangian, s, m = self._lagrangian()
        arguments = [*self.arguments, s, m]
        if self.eliminated is None:
            hessian = ca.hessian(lagrangian, self.w)[0]
        else:
            hessian = self.eliminated.total_hessian(lagrangian, self.w)
            arguments += [self.eliminated.curvatures] if self.eliminated.curvatures.numel() else []
        hessian = ca.triu(hessian)
        return self._function("second", arguments, [_nonzeros(hessian)]), hessian.sparsity()

    def curvature_values(self, arguments: list[ca.MX], copies: int) -> list[ca.MX]:
        """Return the argument ``curvatures`` of :meth:`second` in a list, given the others; empty if it has none."""
        if self.eliminated is None or not self.eliminated.curvatures.numel():
            return []
        lagrangian, s, m = self._lagrangian()
        slope = ca.densify(ca.gradient(lagrangian, self.eliminated.inner))
        function = self._function("slope_of_hidden", [*self.arguments, s, m], [slope])
        return self.eliminated.curvature_values(function, arguments, copies)

    def _lagrangian(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        s, m = ca.SX.sym("s"), ca.SX.sym("m", self.constraints.numel())
        return s * self.cost + ca.dot(m, self.constraints), s, m

    def _function(self, function_name: str, inputs: list[ca.SX], outputs: list[ca.SX]) -> ca.Function:
        if self.eliminated is not None:
            outputs = self.eliminated.substitute_held(outputs)
        return ca.Function(f"{self.name}_{function_name}", inputs, outputs, {"cse": True})

    def _total(self, expression: ca.SX) -> ca.SX:
        direct = ca.jacobian(expression, self.w)
        if self.eliminated is None:
            return direct
        by_inner = ca.jacobian(expression, self.eliminated.inner)
        return direct + by_inner @ self.eliminated.sensitivity(self.w)


def _nonzeros(matrix: ca.SX) -> ca.SX:
    return ca.vec(matrix[matrix.sparsity()].nz[:]) if matrix.nnz() else ca.SX(0, 1)


def _call_copies(stage: Stage, function: ca.Function, source: ca.MX, p: ca.MX, *more: ca.MX) -> list[ca.MX]:
    """Return the outputs of a stage's function for all its copies, given the whole [x; data] and p."""
    copies, eliminated = stage.copies, stage.eliminated
    w = ca.reshape(source[stage.index.ravel().tolist()], -1, copies)
    inner = ca.MX(0, copies) if eliminated is None else eliminated.values(w, p, copies)
    last = stage.curvature_values([w, p, inner, *more], copies) if more else []
    mapped = function.map(f"{function.name()}_map", "serial", copies, [1], [])
    return mapped.call([w, p, inner, *more, *last])


def assemble(stages: list[Stage], n: int, n_data: int, m: int, n_p: int, compiled: Compile | None = None) -> Functions:
    """Assemble an NLP of n variables and m constraints from stages.

    ``n_p`` parameters come first in the parameter vector, ``n_data`` data entries after them.
    """
    x, full = ca.MX.sym("x", n), ca.MX.sym("p", n_p + n_data)
    p, source = full[:n_p], ca.vertcat(x, full[n_p:])

    def call(stage: Stage, function: ca.Function, *more: ca.MX) -> list[ca.MX]:
        return _call_copies(stage, compiled(function) if compiled else function, source, p, *more)

    # Cost and constraints are separate functions, since solvers evaluate one at a time.
    costs = [call(stage, stage.cost_value()) for stage in stages]
    values = [call(stage, stage.constraint_values()) for stage in stages]
    f, g = _sum_costs(costs), _collect(stages, [v[0] for v in values], m)

    slope = [call(stage, stage.cost_slope()) for stage in stages]
    target = np.concatenate([stage.index.ravel() for stage in stages])
    grad = _add_up(target, n, ca.vertcat(*(ca.vec(v[1]) for v in slope)))
    slope_functions = [(stage, *stage.constraint_slopes()) for stage in stages]
    first = [call(stage, function) for stage, function, _ in slope_functions]
    g1 = _collect(stages, [v[0] for v in first], m)
    jac = _scattered_jacobian([(stage, pattern) for stage, _, pattern in slope_functions], [v[1] for v in first], n, m)

    lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", m)
    patterns, entries = [], []
    for stage in stages:
        function, pattern = stage.second()
        scale = ca.repmat(lam_f, 1, stage.copies)
        multipliers = ca.reshape(lam_g[stage.rows.ravel().tolist()], -1, stage.copies)
        entries.append(call(stage, function, scale, multipliers)[0])
        patterns.append((stage, pattern))
    hess = _scattered_hessian(patterns, entries, n)
    symbols = (x, full, lam_f, lam_g)
    return Functions.of(symbols, (f, g), (_sum_costs(slope), grad), (g1, jac), hess)


def _sum_costs(values: list[list[ca.MX]]) -> ca.MX:
    return sum((ca.sum2(value[0]) for value in values), ca.MX(0))


def _collect(stages: list[Stage], stage_rows: list[ca.MX], m: int) -> ca.MX:
    """Return g (m, 1) with the constraints of the stages in their rows."""
    rows = np.concatenate([stage.rows.ravel() for stage in stages])
    order = np.argsort(rows, kind="stable")
    flat = ca.vertcat(ca.MX(0, 1), *(ca.vec(rows_of_stage) for rows_of_stage in stage_rows))
    return flat[order.tolist()] if m else ca.MX(0, 1)


def _add_up(target: np.ndarray, size: int, values: ca.MX) -> ca.MX:
    """Return a dense vector of ``size`` with ``values`` summed at the indices ``target``, ignoring larger indices."""
    inside = np.flatnonzero(target < size)
    ones = ca.DM(_by_columns(size, target.size, target[inside], inside), 1.0)
    return ca.densify(ones @ values)


def _by_columns(m: int, n: int, row: np.ndarray, column: np.ndarray) -> ca.Sparsity:
    """Return the sparsity pattern (m, n) of distinct entries sorted by column, then row."""
    start = np.concatenate([[0], np.cumsum(np.bincount(column, minlength=n))])
    return ca.Sparsity(m, n, start.tolist(), row.tolist())


def _placed(*blocks: tuple[np.ndarray, np.ndarray, ca.Sparsity]) -> list[np.ndarray]:
    """Return rows and columns of all copies' entries, from blocks ``(row indices, column indices, pattern)``."""
    placed = [
        [index[:, entry].ravel() for index, entry in zip(indices, pattern.get_triplet(), strict=True)]
        for *indices, pattern in blocks
    ]
    return [np.concatenate(coordinates) for coordinates in zip(*placed, strict=True)]


def _scattered_jacobian(patterns: list[tuple[Stage, ca.Sparsity]], stage_entries: list[ca.MX], n: int, m: int) -> ca.MX:
    row, column = _placed(*((stage.rows, stage.index, pattern) for stage, pattern in patterns))
    inside = np.flatnonzero(column < n)
    order = inside[np.argsort(column[inside] * m + row[inside], kind="stable")]
    sparsity = _by_columns(m, n, row[order], column[order])
    flat = ca.vertcat(ca.MX(0, 1), *(ca.vec(entries) for entries in stage_entries))
    return ca.MX(sparsity, flat[order.tolist()])


def _scattered_hessian(patterns: list[tuple[Stage, ca.Sparsity]], stage_entries: list[ca.MX], n: int) -> ca.MX:
    ends = _placed(*((stage.index, stage.index, pattern) for stage, pattern in patterns))
    row, column = np.minimum(*ends), np.maximum(*ends)
    inside = column < n
    key = np.where(inside, column * n + row, n * n)
    unique, target = np.unique(key, return_inverse=True)
    cells = unique[unique < n * n]
    sparsity = _by_columns(n, n, cells % n, cells // n)
    flat = ca.vertcat(ca.MX(0, 1), *(ca.vec(entries) for entries in stage_entries))
    return ca.MX(sparsity, _add_up(target, cells.size, flat))
