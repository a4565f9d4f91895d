"""Interior-point method for a horizon's quadratic program in NumPy, for computers without a C compiler.

It takes the same iterations as :mod:`dynamics.batch.engines.c_program`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dynamics.batch.engines import c_program


class ProgramSizes(NamedTuple):
    """Sizes of a program: states, inputs, rows and at most ``slacks`` slacks of a stage, and inputs before in its cost.

    ``proximal`` (nu,) are the curvatures of inputs that every iteration adds.
    """

    nx: int
    nu: int
    rows: int
    slacks: int
    before: bool
    proximal: np.ndarray


class ProgramSolution(NamedTuple):
    """Solution of a program: dx (N+1, nx), du (N, nu), multipliers of dynamics and rows, and the sum of all slacks.

    ``status`` is 1 for a solution, 0 for the iterate after the maximum number of iterations, and -1 if a value is not
    finite.
    """

    dx: np.ndarray
    du: np.ndarray
    costates: np.ndarray
    rows: np.ndarray
    violation: float
    iterations: int
    status: int


class NumpyProgram:
    """Solver of a horizon's quadratic program by Mehrotra's method with a Riccati recursion.

    The variables of a step are q = (x, input before, u). Constraints are rows with a slack that relaxes them, and then
    the lower and upper bounds on u; each has a distance t and a multiplier z. In every iteration slacks, distances
    and multipliers are eliminated, and the steps of the remaining program are eliminated backwards in time.
    """

    def __init__(self, sizes: ProgramSizes) -> None:
        self.sizes, self.nx, self.nu = sizes, sizes.nx, sizes.nu
        self.state = sizes.nx + sizes.before * sizes.nu
        self.at = np.r_[: self.nx, self.state : self.state + self.nu]
        self.held = np.arange(self.nx, self.state)

    def solve(
        self, arrays: Sequence[np.ndarray], slack_of: np.ndarray, options: Sequence[float], max_iterations: int
    ) -> ProgramSolution:
        """Solve a program of any number of steps.

        ``arrays`` are value, by_x and by_u of the next state, the same of the rows, gradient and Hessian of the stage
        cost in (x, input before, u) and of the terminal cost, dx0, and the bounds on du. Row j is relaxed by slack
        ``slack_of[j]``. ``options`` are the characteristic cost, penalty and curvature of a slack, and the tolerances
        of residuals and gap.
        """
        cost, self.penalty, self.curvature, tolerance, gap_tolerance = options
        self._load(arrays, slack_of, cost)
        iteration = status = 0
        with np.errstate(all="ignore"):
            while True:
                primal, dual, gap = self._evaluate()
                status = int(primal <= tolerance and dual <= tolerance and gap <= gap_tolerance)
                status = status if np.isfinite(primal + dual + gap) else -1
                if status or iteration == max_iterations:
                    break
                self._iterate(gap, c_program.LEAST_CENTRE * gap_tolerance)
                iteration += 1
        q, z, rows = self.q, self.z[:, : self.sizes.rows], self.sizes.rows
        return ProgramSolution(
            q[:, : self.nx].copy(),
            q[:-1, self.state :].copy(),
            self.y * cost,
            z / self.scale[:, :rows] * cost,
            float(self.s.sum()),
            iteration,
            status,
        )

    def _load(self, arrays: Sequence[np.ndarray], slack_of: np.ndarray, cost: float) -> None:
        """Store the program, with bounds among the constraints and the terminal cost as step N; choose an iterate."""
        value, by_x, by_u, row, row_by_x, row_by_u, gradient, hessian, end_gradient, end_hessian, dx0, *bounds = arrays
        nx, nu, (N, rows) = self.nx, self.nu, row.shape
        kept = np.arange(nx + 2 * nu) if self.sizes.before else np.r_[:nx, nx + nu : nx + 2 * nu]
        self.H, self.g = (np.zeros((N + 1, *(len(kept),) * axes)) for axes in (2, 1))
        self.H[:N], self.g[:N] = hessian[:, kept[:, None], kept] / cost, gradient[:, kept] / cost
        self.H[N, :nx, :nx], self.g[N, :nx] = end_hessian / cost, end_gradient / cost
        self.AB, self.b = np.concatenate([by_x, by_u], axis=2), value
        self.scale = np.ones((N, rows + 2 * nu))
        first = row.copy()
        first[0] += row_by_x[0] @ dx0
        self.scale[:, :rows] = np.maximum(1.0, first / c_program.MAX_ROW_VALUE)
        inputs = np.broadcast_to(np.hstack([np.zeros((nu, nx)), np.eye(nu)]), (N, nu, nx + nu))
        G = np.concatenate([np.concatenate([row_by_x, row_by_u], axis=2), inputs, -inputs], axis=1)
        self.r = np.concatenate([row, -bounds[0], bounds[1]], axis=1) / self.scale
        self.present = np.isfinite(self.r)
        self.present[:, :rows] = True
        self.r[~self.present] = 0.0
        self.G = G / self.scale[:, :, None]
        slacks = slack_of.max(initial=0) + 1
        self.relaxes = np.zeros((rows + 2 * nu, slacks))
        self.relaxes[np.arange(rows), slack_of] = 1.0
        self.q, self.y = np.zeros_like(self.g), np.zeros((N, nx))
        self.q[0, :nx] = dx0
        self.s, self.zs = np.full((N, slacks), 1 / self.penalty), np.full((N, slacks), self.penalty)
        self.zs *= c_program.START_SHARE
        self.t = np.maximum(c_program.START_DISTANCE, self.r + self._along(self.q))
        self.z = self.present * c_program.START_PRODUCT / self.t
        self.count = self.present.sum() + self.s.size

    def _along(self, q: np.ndarray) -> np.ndarray:
        return np.einsum("kcv,kv->kc", self.G, q[:-1, self.at])

    def _evaluate(self) -> tuple[float, float, float]:
        """Return the largest residuals of constraints and of multipliers, and the gap."""
        nx = self.nx
        self.slope = np.einsum("kij,kj->ki", self.H, self.q) + self.g
        self.rb = self.b + np.einsum("kij,kj->ki", self.AB, self.q[:-1, self.at]) - self.q[1:, :nx]
        self.rs = self.penalty + self.curvature * self.s - self.zs - self.z @ self.relaxes
        self.rp = self.present * (self.r + self._along(self.q) + self.s @ self.relaxes.T - self.t)
        self.slope[:-1, self.at] -= np.einsum("kcv,kc->kv", self.G, self.z)
        dual = self.slope[:-1, self.at] - np.einsum("kij,ki->kj", self.AB, self.y)
        dual[1:, :nx] += self.y[:-1]
        dual[0, :nx] = 0.0
        if self.sizes.before:
            dual[:-1, nx:] += self.slope[1:-1, self.held]
        end = self.slope[-1, :nx] + self.y[-1]
        primal = max(abs(self.rb).max(), abs(self.rp).max(initial=0.0))
        largest_dual = max(abs(dual).max(), abs(end).max(), abs(self.rs).max(initial=0.0))
        return primal, largest_dual, float((self.s * self.zs).sum() + (self.t * self.z).sum())

    def _iterate(self, gap: float, least: float) -> None:
        """Take one step of Mehrotra's method: a predictor, and a corrector with the same factors."""
        self.ds, self.dzs, self.dt, self.dz = (np.zeros_like(v) for v in (self.s, self.zs, self.t, self.z))
        self._factorise()
        self._find_direction(0.0, 0.0)
        if self.count:
            share = 1 / max(1.0, self._inverse_step())
            after = ((self.s + share * self.ds) * (self.zs + share * self.dzs)).sum()
            after += ((self.t + share * self.dt) * (self.z + share * self.dz)).sum()
            self._find_direction(max(least, gap * (after / gap) ** 3) / self.count, 1.0)
        share = 1 / max(1.0, self._inverse_step() / c_program.TO_BOUNDARY)
        for name in ("q", "y", "s", "zs", "t", "z"):
            setattr(self, name, getattr(self, name) + share * getattr(self, f"d{name}"))

    def _inverse_step(self) -> float:
        z = np.where(self.present, self.z, 1.0)
        pairs = ((self.ds, self.s), (self.dzs, self.zs), (self.dt * self.present, self.t), (self.dz, z))
        return max((-change / value).max(initial=0.0) for change, value in pairs)

    def _factorise(self) -> None:
        """Eliminate slacks, distances and multipliers, and then the steps backwards in time."""
        N, state, held, nx = len(self.b), self.state, self.held, self.nx
        self.W = self.z / self.t
        self.D = self.curvature + self.zs / self.s + self.W @ self.relaxes
        self.h = np.einsum("kc,cs,kcv->ksv", self.W, self.relaxes, self.G)
        S = np.einsum("kc,kcv,kcw->kvw", self.W, self.G, self.G)
        S -= np.einsum("ksv,ksw->kvw", self.h / self.D[:, :, None], self.h)
        self.P = np.zeros((N + 1, state, state))
        self.P[N] = self.H[N, :state, :state]
        self.K, self.L = np.zeros((N, self.nu, state)), np.zeros((N, self.nu, self.nu))
        for k in reversed(range(N)):
            T = self.P[k + 1][:, :nx] @ self.AB[k]
            S[k] += self.AB[k].T @ T[:nx]
            if self.sizes.before:
                S[k, nx:] += T[held]
                S[k, :, nx:] += T[held].T
                S[k, nx:, nx:] += self.P[k + 1][held[:, None], held]
            Q = self.H[k].copy()
            Q[self.at[:, None], self.at] += S[k]
            self.L[k] = self._cholesky(Q[state:, state:])
            self.K[k] = self._solve_factors(k, Q[state:, :state])
            P = Q[:state, :state] + Q[:state, state:] @ self.K[k]
            self.P[k] = np.tril(P) + np.tril(P, -1).T

    def _cholesky(self, matrix: np.ndarray) -> np.ndarray:
        """Return the Cholesky factor with the curvatures of inputs added, which are also the smallest pivots."""
        L, proximal = np.zeros_like(matrix), self.sizes.proximal
        for i in range(self.nu):
            for j in range(i + 1):
                rest = matrix[i, j] + proximal[i] * (i == j) - L[i, :j] @ L[j, :j]
                L[i, j] = rest / L[j, j] if i > j else np.sqrt(max(proximal[i], rest))
        return L

    def _solve_factors(self, k: int, right_sides: np.ndarray) -> np.ndarray:
        """Return ``-(L L')^-1`` times the right sides."""
        return -np.linalg.solve(self.L[k].T, np.linalg.solve(self.L[k], right_sides))

    def _find_direction(self, centre: float, second: float) -> None:
        """Find Newton's direction for the products ``centre - second dt dz``."""
        N, nx, state, held = len(self.b), self.nx, self.state, self.held
        self.dzs = (centre - self.s * self.zs - second * self.ds * self.dzs) / self.s
        e = (centre - self.t * self.z - second * self.dt * self.dz) / self.t - self.W * self.rp
        e = self.present * e
        self.ds = (self.dzs - self.rs + e @ self.relaxes) / self.D
        m = self.slope.copy()
        m[:-1, self.at] += np.einsum("ksv,ks->kv", self.h, self.ds) - np.einsum("kcv,kc->kv", self.G, e)
        p, offsets = [m[N, :state]], np.zeros((N, self.nu))
        for k in reversed(range(N)):
            c = p[-1] + self.P[k + 1][:, :nx] @ self.rb[k]
            m[k, self.at] += self.AB[k].T @ c[:nx]
            if self.sizes.before:
                m[k, state:] += c[held]
            offsets[k] = self._solve_factors(k, m[k, state:])
            p.append(m[k, :state] + self.K[k].T @ m[k, state:])
        p = p[::-1]
        self.dq, self.dy = np.zeros_like(self.q), np.zeros_like(self.y)
        for k in range(N):
            self.dq[k, state:] = offsets[k] + self.K[k] @ self.dq[k, :state]
            self.dq[k + 1, :nx] = self.rb[k] + self.AB[k] @ self.dq[k, self.at]
            if self.sizes.before:
                self.dq[k + 1, held] = self.dq[k, state:]
            self.dy[k] = -(p[k + 1] + self.P[k + 1] @ self.dq[k + 1, :state])[:nx] - self.y[k]
        self.ds -= np.einsum("ksv,kv->ks", self.h, self.dq[:-1, self.at]) / self.D
        self.dzs -= self.zs / self.s * self.ds
        change = self._along(self.dq) + self.ds @ self.relaxes.T
        self.dt, self.dz = self.present * (self.rp + change), e - self.W * change
