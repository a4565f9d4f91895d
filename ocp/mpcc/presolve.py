"""Presolve a stated problem: rows that are bounds become bounds, rows that repeat the sign of a pair are left out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from ocp.mpcc.forms import StandardForm
from ocp.mpcc.programs import MPCC
from ocp.mpcc.solving import MPCCSolution

Bounds = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Lower and upper bounds of variables, then of rows."""
Values = dict[str, np.ndarray]
"""Mapping from ``p`` (n_p,), ``lbx`` and ``ubx`` (n,), ``lbg`` and ``ubg`` (m,) to the numbers of a call."""


class Presolved:
    """A problem in SX with variables x (n,) and rows g (m,) as stated, which :meth:`problem` turns into an MPCC.

    ``expressions`` are f, g, and limits of g that may depend on p; the limits of each call apply in addition.

    A simple bound in g would be a constraint with a multiplier of its own, and a row that repeats
    ``a >= 0`` beside a pair ``a ⟂ b`` would leave the branch ``a = 0`` without an interior.
    """

    def __init__(
        self,
        name: str,
        symbols: Sequence[ca.SX],
        expressions: Sequence[ca.SX],
        form: StandardForm,
        row_names: Sequence[str] = (),
    ) -> None:
        (x, p), (f, g, low, high), none = symbols, expressions, ca.SX(0, 1)
        self.name, self.p, self.form, self.f = name, p, form, f
        self.n, self.m = x.numel(), g.numel()
        self.x = ca.vertcat(x, *form.variables)
        self.starts = ca.Function("starts", [x, p], [ca.vertcat(none, *form.starts)])
        self.values = ca.Function("values", [x, p], [f, g])
        self.g, self.G, self.H = ca.cse([g, ca.vertcat(none, *form.G), ca.vertcat(none, *form.H)])
        side_hashes = {side.element_hash() for side in ca.vertsplit(ca.vertcat(self.G, self.H))}
        self.repeats = np.array([row.element_hash() in side_hashes for row in ca.vertsplit(self.g)], dtype=bool)
        self.unrepeated = np.flatnonzero(~self.repeats)
        unrepeated = self.unrepeated.tolist()
        lbg, ubg = ca.SX.sym("lbg", self.m), ca.SX.sym("ubg", self.m)
        parameters = ca.vertcat(p, lbg, ubg)
        low, high = ca.fmax(low, lbg), ca.fmin(high, ubg)
        # CasADi fails if no row is a simple bound; a bounded variable is therefore added at the end.
        extra = ca.SX.sym("extra")
        kept_rows, lower, upper, _, self.backward = ca.detect_simple_bounds(
            ca.vertcat(self.x, extra),
            parameters,
            ca.vertcat(_entries(self.g, unrepeated), extra),
            ca.vertcat(_entries(low, unrepeated), -1),
            ca.vertcat(_entries(high, unrepeated), 1),
        )
        self.kept_rows = np.array(kept_rows, dtype=int)
        self.limits = ca.Function("limits", [p, lbg, ubg], [lower[:-1], upper[:-1], low, high])
        self.row_names = row_names or [f"g[{i}]" for i in range(self.m)]
        self._problems: dict[str, MPCC] = {}

    def problem(self, values: Values) -> MPCC:
        """Return the problem with the bounds of a call; problems of different calls share their derivatives."""
        bounds, rows = self.bounds(values), self._rows(values)
        key = f"{rows} {np.flatnonzero(bounds[0] <= 0)}"
        if key not in self._problems:
            names = [self.row_names[i] for i in rows]
            names += [f"equation {i} of the pairs" for i in range(len(self.form.rows))]
            g = ca.vertcat(_entries(self.g, rows), *self.form.rows)
            arguments = self.x, self.f, self.G, self.H, g, self.p, *bounds, self.form.names, self.name
            self._problems[key] = MPCC(*arguments, row_names=names)
        return self._problems[key].with_bounds(*bounds)

    def bounds(self, values: Values) -> Bounds:
        """Return lower and upper bounds of all variables and of the remaining rows."""
        lower, upper, low, high = self._limits(values)
        extra, rows = np.full(len(self.form.variables), np.inf), self._rows(values)
        zeros = np.zeros(len(self.form.rows))
        lbx = np.fmax(np.concatenate([values["lbx"], self.form.lower]), lower)
        ubx = np.fmin(np.concatenate([values["ubx"], extra]), upper)
        return lbx, ubx, np.concatenate([low[rows], zeros]), np.concatenate([high[rows], zeros])

    def _limits(self, values: Values) -> list[np.ndarray]:
        """Return the bounds of all variables that rows imply, and the limits of all rows as stated."""
        return [np.array(end).ravel() for end in self.limits(values["p"], values["lbg"], values["ubg"])]

    def _rows(self, values: Values) -> list[int]:
        """Return the indices of rows that are no simple bounds and do not repeat the sign of a pair's side."""
        low, high = self._limits(values)[2:]
        repeats = self.repeats & (low <= 0) & (high == np.inf)
        return [*self.unrepeated[self.kept_rows].tolist(), *np.flatnonzero(self.repeats & ~repeats).tolist()]

    def extended(self, x: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Return x (n,) with the starts of new variables appended."""
        return np.concatenate([x, np.array(self.starts(x, p)).ravel()])

    def results(self, values: Values, solution: MPCCSolution) -> dict[str, Any]:
        """Return the results of a call in the form of ``casadi.nlpsol``, with multipliers of stated rows and bounds."""
        x = solution.x[: self.n]
        f, g = self.values(x, values["p"])
        lam_x, lam_g, lam_pairs = self._multipliers(values, solution)
        return {
            "x": ca.DM(x),
            "f": f,
            "g": g,
            "lam_x": ca.DM(lam_x),
            "lam_g": ca.DM(lam_g),
            "lam_pairs": ca.DM(lam_pairs),
            "report": solution,
        }

    def _multipliers(self, values: Values, solution: MPCCSolution) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return multipliers of bounds (n,), of rows (m,), and of both sides of the pairs (k, 2)."""
        multipliers = solution.multipliers
        if multipliers is None:
            return np.full(self.n, np.nan), np.full(self.m, np.nan), np.full((self.G.numel(), 2), np.nan)
        lower, upper = (end[: self.n] for end in self._limits(values)[:2])
        is_row = np.where(multipliers.x[: self.n] < 0, lower > values["lbx"], upper < values["ubx"])
        by_rows = np.where(is_row, multipliers.x[: self.n], 0.0)
        lam_g, rows = np.zeros(self.m), self._rows(values)
        lam_g[rows] = multipliers.g[: len(rows)]
        parameters = np.concatenate([values["p"], values["lbg"], values["ubg"]])
        padded = np.concatenate([by_rows, np.zeros(len(self.form.variables) + 1)])
        restored = self.backward(lam_g[self.unrepeated[self.kept_rows]], padded, parameters)
        lam_g[self.unrepeated] = np.array(restored).ravel()[:-1]
        pairs = np.array([multipliers.G, multipliers.H]).T
        return multipliers.x[: self.n] - by_rows, lam_g, pairs


def _entries(vector: ca.SX, indices: list[int]) -> ca.SX:
    """Return entries of a vector as a column, of shape (0, 1) if ``indices`` is empty."""
    return vector[indices] if indices else ca.SX(0, 1)
