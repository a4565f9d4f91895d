"""KKT conditions with the active set held fixed: smooth equations in a point and one parameter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ocp.errors import InputError
from ocp.judge.certificate import fit_multipliers
from ocp.judge.lpec import LinearModel, negative_curvature
from ocp.programs.program import PENALTY, Program
from ocp.programs.solver import Point

if TYPE_CHECKING:
    import scipy.sparse as sp

SHARP = 1e-7
"""Newton step, in characteristic sizes, below which the next step would be no larger than rounding errors."""
_BORDER_REGULARISATION = 1e-12
"""Regularisation of the bordered KKT matrix, scaled."""
_NEWTON_STEPS = 8
"""Maximum number of Newton steps of a correction."""
_CENTRAL_STEP = 1e-5
"""Step of central differences with respect to the parameter, in its unit."""
_BIACTIVE_MEMBER = 1e-6
"""Value of a pair's larger member, in characteristic sizes, below which this member is also held at zero."""


@dataclass(frozen=True)
class Held:
    """Active set of ``x`` (n,) and ``g`` (m,): -1 for entries at the lower bound, 1 at the upper bound, 0 if free."""

    x: np.ndarray
    g: np.ndarray

    def toggle_end(self, end: int) -> Held:
        """Return the active set with the index ``end`` of :meth:`KKTCurve.margins` freed if held, and held if free."""
        x, g = self.x.copy(), self.g.copy()
        signs, index = (x, end) if end < 2 * x.size else (g, end - 2 * x.size)
        sign, index = (-1, index) if index < signs.size else (1, index - signs.size)
        signs[index] = 0 if signs[index] else sign
        return Held(x, g)

    def holds_end(self, end: int) -> bool:
        """Return whether the index ``end`` of :meth:`KKTCurve.margins` is held."""
        toggled = self.toggle_end(end)
        return np.abs(toggled.x).sum() + np.abs(toggled.g).sum() < (np.abs(self.x).sum() + np.abs(self.g).sum())


class KKTCurve:
    """Stationary points of a program along the parameter ``name``, with its active set held fixed.

    Coordinates v are the free variables in characteristic sizes, the multipliers of the held rows in
    the scales of cost and rows, and the parameter divided by ``unit``. :meth:`equations` are the
    Lagrangian's gradient at free variables and the held rows; held variables follow their bounds.
    Derivatives with respect to the parameter are central differences over 1e-5 units, which are exact
    to about 1e-10 for smooth functions.
    """

    def __init__(
        self,
        program: Program,
        values: dict[str, float],
        name: str,
        unit: float,
        point: Point,
        multipliers: np.ndarray,
        held: Held | None = None,
    ) -> None:
        import scipy.sparse as sp

        self.program, self.values, self.name, self.unit = program, values, name, unit
        x = point.x
        p, bounds = self.problem_data(values[name] / unit)
        gradient, g, jacobian = program.first_derivatives(x, p)
        self.sizes = program.sizes(x)
        smallest = 1e-12 * program.natural.f
        self.scale = max(float(np.abs(gradient * self.sizes).max(initial=0.0)), smallest)
        largest = abs(jacobian @ sp.diags(self.sizes)).max(axis=1).toarray().ravel()
        self.rows = 1 / np.maximum(largest, 1e-12)
        self.pairs = program.pairs if program.reformulation == "none" else np.zeros((2, 0), dtype=int)
        reduced = gradient + jacobian.T @ multipliers
        self.held = held or self._held(x, reduced, multipliers, g * self.rows, bounds)
        self.free, self.acting = self.held.x == 0, self.held.g != 0
        self.nx, self.ng = int(self.free.sum()), int(self.acting.sum())
        eta = multipliers / (self.scale * self.rows)
        self.start = np.concatenate([(x / self.sizes)[self.free], eta[self.acting], [values[name] / unit]])
        self.iterations = 0

    @property
    def parameter_direction(self) -> np.ndarray:
        """Unit vector along the parameter's coordinate."""
        return np.eye(1, self.start.size, self.start.size - 1).ravel()

    def problem_data(self, tau: float) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Return the parameter vector and bounds at the coordinate ``tau`` of the parameter."""
        values = {**self.values, self.name: tau * self.unit, PENALTY: 0.0}
        return self.program.parameter_vector(values), self.program.bounds(values)

    def _held(
        self, x: np.ndarray, reduced: np.ndarray, y: np.ndarray, g: np.ndarray, bounds: dict[str, np.ndarray]
    ) -> Held:
        """Return the active set: ends whose multiplier exceeds their slack, both in characteristic sizes."""
        slope, eta = reduced * self.sizes / self.scale, y / (self.scale * self.rows)
        lower, upper = bounds["lbx"] / self.sizes, bounds["ubx"] / self.sizes
        held_x = _pressing(slope, -slope, x / self.sizes, lower, upper)
        held_g = _pressing(-eta, eta, g, bounds["lbg"] * self.rows, bounds["ubg"] * self.rows)
        if self.pairs.size:
            members = x[self.pairs] / self.sizes[self.pairs]
            smaller = np.argmin(members, axis=0)
            held_x[self.pairs[smaller, np.arange(smaller.size)]] = -1
            at_zero = (members < _BIACTIVE_MEMBER) | (np.arange(2)[:, None] == smaller)
            held_x[self.pairs] *= at_zero | (held_x[self.pairs] > 0)
        else:
            held_x[self.program.pairs] = 0
        return Held(held_x, held_g)

    def primal_dual(self, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return variables (n,) and multipliers of all rows (m,) at coordinates v."""
        _, bounds = self.problem_data(v[-1])
        x = np.where(self.held.x < 0, bounds["lbx"], bounds["ubx"])
        x[self.free] = v[: self.nx] * self.sizes[self.free]
        y = np.zeros(self.acting.size)
        y[self.acting] = v[self.nx : -1] * (self.scale * self.rows)[self.acting]
        return x, y

    def _state(self, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
        """Return the gradient of the Lagrangian (n,) and the constraints (m,), both scaled, and the bounds."""
        (x, y), (p, bounds) = self.primal_dual(v), self.problem_data(v[-1])
        gradient, g, jacobian = self.program.first_derivatives(x, p)
        return (gradient + jacobian.T @ y) * self.sizes / self.scale, g * self.rows, bounds

    def equations(self, v: np.ndarray) -> np.ndarray:
        """Return the residual of the curve's equations, which has one entry fewer than v."""
        slope, g, bounds = self._state(v)
        ends = np.where(self.held.g < 0, bounds["lbg"], bounds["ubg"])[self.acting]
        return np.concatenate([slope[self.free], g[self.acting] - ends * self.rows[self.acting]])

    def matrix(self, v: np.ndarray) -> sp.csc_matrix:
        """Return the derivative of :meth:`equations`: the reduced KKT matrix, with the parameter's column last."""
        import scipy.sparse as sp

        (x, y), (p, _) = self.primal_dual(v), self.problem_data(v[-1])
        H, A = self._second(x, y, p)
        step = _CENTRAL_STEP * self.parameter_direction
        last = (self.equations(v + step) - self.equations(v - step)) / (2 * _CENTRAL_STEP)
        square = sp.bmat([[H, A.T], [A, sp.csr_matrix((self.ng, self.ng))]])
        return sp.csc_matrix(sp.hstack([square, last[:, None]]))

    def _second(self, x: np.ndarray, y: np.ndarray, p: np.ndarray) -> tuple[sp.csr_matrix, sp.csr_matrix]:
        import scipy.sparse as sp

        H = sp.csr_matrix(self.program.scaled_hessian(x, p, y, self.sizes) / self.scale)
        _, _, jacobian = self.program.first_derivatives(x, p)
        A = sp.csr_matrix(sp.diags(self.rows) @ jacobian @ sp.diags(self.sizes))
        return H[self.free][:, self.free], A[self.acting][:, self.free]

    def curvature(self, v: np.ndarray) -> int:
        """Return the number of directions of negative curvature of the Lagrangian with the active set held."""
        x, y = self.primal_dual(v)
        return negative_curvature(*self._second(x, y, self.problem_data(v[-1])[0]))

    def solve(self, v: np.ndarray, border: np.ndarray, right: np.ndarray) -> np.ndarray:
        """Solve with the KKT matrix bordered by the row ``border``; the result is NaN if the matrix is singular.

        The matrix is regularised by 1e-12. At a simple fold the bordered matrix is regular and the unbordered
        square matrix singular.
        """
        import scipy.sparse as sp
        import scipy.sparse.linalg as sla

        small = np.concatenate([np.full(self.nx, _BORDER_REGULARISATION), np.full(self.ng, -_BORDER_REGULARISATION)])
        diagonal = sp.hstack([sp.diags(small), sp.csr_matrix((small.size, 1))])
        bordered = sp.csc_matrix(sp.vstack([self.matrix(v) + diagonal, sp.csr_matrix(border)]))
        try:
            return sla.splu(bordered).solve(right)
        except RuntimeError:
            return np.full_like(v, np.nan)

    def tangent(self, v: np.ndarray, border: np.ndarray | None = None) -> np.ndarray:
        """Return the direction t of the curve with ``border' t = 1``; by default per unit of the parameter."""
        return self.solve(v, self.parameter_direction if border is None else border, self.parameter_direction)

    def newton(self, v: np.ndarray, border: np.ndarray, target: float) -> np.ndarray | None:
        """Return the point of the curve with ``border' v = target``; None if Newton's method does not converge."""
        last = np.inf
        for _ in range(_NEWTON_STEPS):
            residual = np.append(self.equations(v), border @ v - target)
            step = self.solve(v, border, -residual)
            self.iterations += 1
            size = float(np.abs(step).max())
            if not size < max(2 * last, SHARP):
                return None
            v, last = v + step, size
            if size <= SHARP * max(1.0, float(np.abs(v).max())):
                return v
        return None

    def corrected_point(self, v: np.ndarray, tau: float) -> np.ndarray | None:
        """Return the point of the curve at ``tau``, predicted along the tangent from v and then corrected.

        Returns None if Newton's method does not converge, or if the correction exceeds half the prediction,
        which indicates a jump to another curve.
        """
        predictor = (tau - v[-1]) * self.tangent(v)
        if not np.all(np.isfinite(predictor)):
            return None
        solution = self.newton(v + predictor, self.parameter_direction, tau)
        if solution is None:
            return None
        residual = np.abs(solution - v - predictor)[: self.nx].max(initial=0.0)
        return solution if residual <= 0.5 * np.abs(predictor)[: self.nx].max(initial=0.0) + 1e-4 else None

    def margins(self, v: np.ndarray) -> np.ndarray:
        """Return the scaled margins of the active set: slacks of free ends, and multipliers of held ends.

        Their order (2n + 2m,) is lower ends of x, upper ends of x, lower ends of g, upper ends of g. Margins are
        infinite if an end cannot change: for equations, and for the held member of a pair with one held
        member, since its multiplier may have either sign.
        """
        slope, g, bounds = self._state(v)
        x, y = self.primal_dual(v)
        eta = y / (self.scale * self.rows)
        slack_groups = [
            _margins(x / self.sizes, bounds["lbx"] / self.sizes, bounds["ubx"] / self.sizes, slope, self.held.x),
            _margins(g, bounds["lbg"] * self.rows, bounds["ubg"] * self.rows, -eta, self.held.g),
        ]
        if self.pairs.size:
            # A member held at an upper bound above zero leaves the sign of the other's multiplier free.
            holds = (self.held.x[self.pairs] < 0) | ((self.held.x != 0) & (bounds["ubx"] <= 0))[self.pairs]
            slack_groups[0][0][self.pairs[holds & (holds.sum(axis=0) == 1)]] = np.inf
        return np.concatenate([np.concatenate(part) for part in slack_groups])

    def lower_slopes(self, v: np.ndarray) -> np.ndarray:
        """Return the scaled gradient of the Lagrangian: the multipliers of held lower ends, zero for free ends."""
        return self._state(v)[0]

    def end_name(self, end: int) -> tuple[str, int, bool]:
        """Return the name and step of an end of :meth:`margins`, and whether the end belongs to a pair."""
        program = self.program
        if end < 2 * program.n:
            variable = end % program.n
            pair_columns = np.flatnonzero((program.pairs == variable).any(axis=0))
            if pair_columns.size and end < program.n:
                pair = program.pair_name(int(pair_columns[0]))
                return pair.name, pair.step, True
            block, index = program.variables.locate(variable)
        else:
            block, index = program.constraints.locate((end - 2 * program.n) % program.m)
        name = block.components[index[-1]] if block.components else block.name
        return name, int(index[1]) if len(index) > 2 else 0, False

    def solver_point(self, v: np.ndarray) -> tuple[Point, float, np.ndarray]:
        """Return the point at v with multipliers of rows and bounds, its cost, and its constraints."""
        (x, y), (p, _) = self.primal_dual(v), self.problem_data(v[-1])
        slope = self._state(v)[0] * self.scale / self.sizes
        return Point(x, np.where(self.free, 0.0, -slope), y), *self.program.values(x, p)


def regular_curve(
    program: Program, point: Point, values: dict[str, float], name: str, unit: float
) -> tuple[KKTCurve, np.ndarray]:
    """Return the curve through a solved point and its coordinates; raise ``InputError`` if the curve is singular."""
    p, bounds = program.parameter_vector(values), program.bounds(values)
    y = point.lam_g
    if y is None:
        y = fit_multipliers(LinearModel.at(program, point.x, p, bounds))
    curve = KKTCurve(program, values, name, unit, point, y)
    v = curve.newton(curve.start, curve.parameter_direction, curve.start[-1])
    if v is None:
        raise InputError(
            f"no derivative by {name}: with the active set held the optimality conditions are not"
            " solved near this point (they are singular, or contacts are undecided)"
        )
    return curve, v


def _pressing(low: np.ndarray, high: np.ndarray, value: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    is_held = np.where(low > value - lower, -1, np.where(high > upper - value, 1, 0))
    return np.where(lower == upper, 1, is_held)


def _margins(
    value: np.ndarray, lower: np.ndarray, upper: np.ndarray, press: np.ndarray, held: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    low = np.where(held == 0, value - lower, np.where(held < 0, press, np.inf))
    high = np.where(held == 0, upper - value, np.where(held > 0, -press, np.inf))
    fixed = lower == upper
    return np.where(fixed, np.inf, low), np.where(fixed, np.inf, high)
