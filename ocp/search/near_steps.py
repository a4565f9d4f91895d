"""Steps of many states at once with only the nearest contacts.

A scene with many corners has a hundred pairs; a step closes only a few of these. The other pairs are left out, and
dense linear algebra over all states at once replaces a graph of the whole step, whose C code takes minutes to compile.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from dynamics.batch import BatchFunction
from dynamics.batch.complementarity import linear_complementarity
from dynamics.systems import ContactSystem
from ocp.judge.measures import DenseFunction, pair_sizes, slip_sides
from ocp.problem.evaluation import Evaluation

_LINEARISATIONS = 10
"""Maximum number of linearisations of a step."""
_SOLVED, _DEEP = 1e-9, 1e-6
"""Error below which a step is solved, and largest penetration of an ignored contact, in characteristic units."""
_LOOSE = 1e-6
"""Friction impulse, in characteristic impulses, up to which a contact counts as frictionless."""
_NEAR = 0, 1, 3, 8
"""Numbers of nearest contacts that a step includes, the next one where it penetrates a contact that was left out."""


class NearSteps:
    """Solver of steps ``x_next = step(x, u)`` under the exact law, from states (S, nx) and inputs (S, nu).

    Impulses act only at the nearest contacts of each state, as many as :data:`_NEAR` says, and between bodies and
    tables. Their pairs ``0 <= lam ⟂ gap(x_next, lam) >= 0`` are linearised at the last x_next and
    lam and solved, until neither changes (the Josephy-Newton method). The next state is NaN if this does
    not converge, or if the state penetrates a contact that was left out.
    """

    def __init__(self, evaluation: Evaluation, system: ContactSystem) -> None:
        problem = evaluation.problem
        self.p, self.n = evaluation.p, system.nlam
        self.of_lam, self.of_gap = pair_sizes(problem, system)
        owners = np.array([pair.contact for pair in system.pairs])
        self.owners = [np.flatnonzero(owners == i) for i in range(owners.max() + 1)]
        self.slips = slip_sides(system)
        self.curved = not ca.is_linear(system.gap, system.lam)
        width = max(map(len, self.owners))
        # Contacts with fewer pairs repeat their last pair, which a mask excludes.
        self.rows = np.array(
            [[*contact_rows, *[contact_rows[-1]] * (width - len(contact_rows))] for contact_rows in self.owners]
        )
        self.real = np.array([[True] * len(o) + [False] * (width - len(o)) for o in self.owners])
        symbols = [system.x, system.u, system.x_next, system.lam, problem.parameters.vector]
        jac = ca.jacobian
        x_next, lam = system.x_next, system.lam
        gaps = [system.gap, jac(system.gap, x_next), jac(system.gap, lam)]
        motion = [system.residual, jac(system.residual, x_next), jac(system.residual, lam)]
        self._along, self._once = DenseFunction(symbols, gaps), DenseFunction(symbols, motion)
        self._motion_positions = self._once.positions
        self._gap, (_, self._slopes, self._slopes_by_lam) = DenseFunction(symbols, gaps[:1]), self._along.positions
        phi = problem.signed_distance
        assert phi is not None
        self._distance = BatchFunction(phi, backend="numpy")

    def __call__(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Return the next states (S, nx)."""
        return self.solved(x, u)[0]

    def solved(self, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the next states (S, nx), and the multipliers and gaps (S, nlam) of all pairs."""
        S = len(x)
        x_next, (lam, gap), unsolved = np.empty_like(x), np.empty((2, S, self.n)), np.arange(S)
        for n_near in _NEAR:
            x_next[unsolved], lam[unsolved], gap[unsolved] = self._solved(x[unsolved], u[unsolved], n_near)
            unsolved = unsolved[~np.isfinite(x_next[unsolved]).all(axis=1)]
            if not len(unsolved) or n_near >= len(self.owners):
                break
        return x_next, lam, gap

    def _solved(self, x: np.ndarray, u: np.ndarray, n_near: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the solution of steps with the ``n_near`` nearest contacts of each state."""
        S, zeros = len(x), np.zeros((len(x), self.n))
        residual, by_state, by_lam = self._once.entries(x, u, np.zeros_like(x), zeros, self.p)
        of_residual, of_state, of_lam = self._motion_positions
        inverse = np.linalg.inv(by_state[:, of_state])
        a = -(inverse @ residual[:, of_residual])[:, :, 0]
        phi = np.asarray(self._distance(x, self.p))[:, : len(self.owners)]
        near_contacts = np.argsort(phi, axis=1, kind="stable")[:, :n_near]
        always = np.arange(phi.shape[1], len(self.owners))
        near_contacts = np.column_stack([near_contacts, np.tile(always, (S, 1))])
        rows, is_real = self.rows[near_contacts].reshape(S, -1), self.real[near_contacts].reshape(S, -1)
        B = -inverse @ by_lam[np.arange(S)[:, None, None], of_lam[:, rows].swapaxes(0, 1)]
        x_next, unsolved, near_lam = x.copy(), np.arange(S), np.zeros(rows.shape)
        if not rows.shape[1]:
            x_next, unsolved = a, unsolved[:0]
        for _ in range(_LINEARISATIONS):
            if not len(unsolved):
                break
            iterate = x[unsolved], u[unsolved], x_next[unsolved], near_lam[unsolved]
            linearised_next, lam = self._linearised(
                *iterate, a[unsolved], B[unsolved], rows[unsolved], is_real[unsolved]
            )
            change = np.abs(linearised_next - x_next[unsolved]).max(axis=1)
            if self.curved:
                change = np.maximum(change, np.abs(lam - near_lam[unsolved]).max(axis=1))
            x_next[unsolved], near_lam[unsolved] = linearised_next, np.where(np.isfinite(lam), lam, 0.0)
            unsolved = unsolved[~(change < _SOLVED) & np.isfinite(change)]
        lam, (s, k) = zeros, np.nonzero(is_real)
        lam[s, rows[s, k]] = near_lam[s, k] * self.of_lam[rows[s, k]]
        gap = self._gap(x, u, x_next, lam, self.p)[0][:, :, 0]
        for slip, sides in self.slips:
            # Without an impulse the motion only bounds a contact's slip from below. A larger slip
            # keeps its pairs of friction from being (0, 0).
            extra_slip = np.maximum(0.0, self.of_lam[slip] - gap[:, sides].min(axis=1))
            extra_slip[lam[:, sides].max(axis=1) > _LOOSE * self.of_gap[slip]] = 0.0
            lam[:, slip] += extra_slip
            gap[:, sides] += extra_slip[:, None]
        normal = np.array([rows_of_contact[0] for rows_of_contact in self.owners])
        x_next[(gap[:, normal] / self.of_gap[normal] < -_DEEP).any(axis=1)] = np.nan
        x_next[unsolved] = np.nan
        return x_next, lam, gap

    def _linearised(
        self,
        x: np.ndarray,
        u: np.ndarray,
        at: np.ndarray,
        near: np.ndarray,
        a: np.ndarray,
        B: np.ndarray,
        rows: np.ndarray,
        is_real: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return next states (S, nx) and multipliers (S, rows) of steps with linearised gaps.

        Gaps are linearised at states ``at`` (S, nx) and multipliers ``near`` (S, rows). Without impulses the next
        states are ``a`` (S, nx), and ``B`` (S, nx, rows) is their derivative by the impulses."""
        sample_index = np.arange(len(x))[:, None]
        full_lam = np.zeros((len(x), self.n))
        s, k = np.nonzero(is_real)
        full_lam[s, rows[s, k]] = near[s, k] * self.of_lam[rows[s, k]]
        gap, by_state, by_lam = self._along.entries(x, u, at, full_lam, self.p)
        units, sizes = self.of_gap[rows], self.of_lam[rows]
        slope = by_state[sample_index[:, :, None], self._slopes[rows]]
        B_near = B * sizes[:, None, :]
        z = gap[sample_index, rows] + np.einsum("sij,sj->si", slope, a - at)
        by_lam = by_lam[sample_index[:, :, None], self._slopes_by_lam[rows[:, :, None], rows[:, None, :]]]
        by_lam = np.where(is_real[:, None, :], by_lam * sizes[:, None, :], 0.0)
        z -= np.einsum("sij,sj->si", by_lam, near)
        F = slope @ B_near + by_lam
        real_pairs = is_real[:, :, None] & is_real[:, None, :]
        lam = linear_complementarity(np.where(real_pairs, F / units[:, :, None], 0.0), z / units, is_real)
        return a + np.einsum("sij,sj->si", B_near, lam), lam
