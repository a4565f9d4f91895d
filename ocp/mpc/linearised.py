"""Linearisation of a plan's steps, with the next state, multipliers and gaps of each step eliminated."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ocp.mpc.stages import Plan, StageModel, StageValues


class LinearClosure(NamedTuple):
    """Linearised contact law ``a dgap + b dlam - m dmu = c`` of every pair and step; coefficients are (N, n)."""

    a: np.ndarray
    b: np.ndarray
    m: np.ndarray
    c: np.ndarray

    @classmethod
    def from_active_set(cls, plan: Plan, closed: np.ndarray) -> LinearClosure:
        """Build the closure ``gap = 0`` for pairs in the mask ``closed`` (N, n), and ``lam = 0`` for other pairs."""
        shut = closed.astype(float)
        return cls(shut, 1 - shut, 0 * shut, np.where(closed, -plan.gap, -plan.lam))

    @classmethod
    def from_product(cls, plan: Plan, mu: np.ndarray, sizes: tuple[np.ndarray, np.ndarray]) -> LinearClosure:
        """Linearise ``lam gap = mu`` at the plan, divided by ``sizes`` of (lam, gap) and the larger scaled factor."""
        L, G = (abs(v) / s + FACTOR_FLOOR for v, s in zip((plan.lam, plan.gap), sizes, strict=True))
        lam_size, gap_size = sizes
        larger, unit = np.maximum(L, G), lam_size * gap_size
        off = (mu - plan.lam * plan.gap) / unit
        return cls(L / gap_size / larger, G / lam_size / larger, 1 / unit / larger, off / larger)


EIGENVALUE_ROUNDING = 1e-12
"""Magnitude up to which negative eigenvalues count as rounding errors, relative to the trace."""
FACTOR_FLOOR = 1e-10
"""Number added to both factors of ``lam gap``, which may both be zero if mu = 0."""


class Affine(NamedTuple):
    """Affine map ``value + by_x dx + by_u du`` at every step, of shapes (N, k), (N, k, nx) and (N, k, nu)."""

    value: np.ndarray
    by_x: np.ndarray
    by_u: np.ndarray


@dataclass
class Linearised:
    """Linear-quadratic model of a horizon around a plan, in the changes dx_k and du_k.

    The change ``x_next`` of the next state, and ``lam``, ``gap`` and ``rows``, are affine in dx and du.
    ``gradient`` (N, nw) and ``hessian`` (N, nw, nw) are derivatives of the stage cost with respect to w = (x,
    u_before, u), and ``end`` contains gradient and Hessian of the terminal cost. Derivatives with respect to
    the closures' right sides c are ``by_closure`` (N, nx + n, n) for (x_next, lam), ``gap_by_closure`` (N, n,
    n) for the gaps, and ``rows_by_closure`` (N, m, n) for the rows.
    """

    x_next: Affine
    lam: Affine
    gap: Affine
    rows: Affine
    gradient: np.ndarray
    hessian: np.ndarray
    end: tuple[np.ndarray, np.ndarray]
    by_closure: np.ndarray
    gap_by_closure: np.ndarray
    rows_by_closure: np.ndarray


def linearise(model: StageModel, plan: Plan, evaluated: StageValues, closure: LinearClosure) -> Linearised:
    """Eliminate x_next, lam and gap from every step by solving a linear system of nx + n equations per step.

    Raises ``numpy.linalg.LinAlgError`` if one of the systems is singular.
    """
    nx, nu = model.nx, model.nu
    solution, gap, rows = _eliminate(model, evaluated, closure)
    by_u, by_closure = 1 + nx, 1 + nx + nu

    def affine(block: np.ndarray) -> Affine:
        return Affine(block[:, :, 0], block[:, :, 1:by_u], block[:, :, by_u:by_closure])

    dlam = affine(solution[:, nx:])
    gradient, hessian = _stage_costs(model, evaluated, dlam)
    return Linearised(
        affine(solution[:, :nx]),
        dlam._replace(value=dlam.value + plan.lam),
        affine(gap),
        affine(rows),
        gradient,
        hessian,
        (evaluated.end_gradient, project_psd(evaluated.end_hessian)),
        solution[:, :, by_closure:],
        gap[:, :, by_closure:],
        rows[:, :, by_closure:],
    )


def _eliminate(
    model: StageModel, evaluated: StageValues, closure: LinearClosure
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return z = (x_next, lam), gaps and rows (N, k, 1 + nx + nu + n): value, by x and u, by the closures' c."""
    nx, nu, n = model.nx, model.nu, model.n
    xu, J = nx + nu, evaluated.jacobian
    edges = np.cumsum([0, nx, n, n, model.m])
    R, G, M, P = (J[:, a:b] for a, b in pairwise(edges))
    a, b, m, c = closure
    pairs = a[:, :, None] * G - m[:, :, None] * M
    matrix = np.concatenate([R[:, :, xu:], pairs[:, :, xu:]], axis=1)
    i = np.arange(n)
    matrix[:, nx + i, nx + i] += b + model.compliance
    right_sides = np.concatenate([-evaluated.residual, c], axis=1)
    sensitivities = -np.concatenate([R[:, :, :xu], pairs[:, :, :xu]], axis=1)
    sides = np.zeros((len(J), nx + n, n))
    sides[:, nx + i, i] = 1.0
    solution = np.linalg.solve(matrix, np.concatenate([right_sides[:, :, None], sensitivities, sides], axis=2))
    affine = [block[:, :, xu:] @ solution for block in (G, P)]
    for product, block, value in zip(affine, (G, P), (evaluated.gap, evaluated.rows), strict=True):
        product[:, :, 0] += value
        product[:, :, 1 : 1 + xu] += block[:, :, :xu]
    return solution, affine[0], affine[1]


def _stage_costs(model: StageModel, evaluated: StageValues, dlam: Affine) -> tuple[np.ndarray, np.ndarray]:
    """Return the stage cost's gradient and Hessian in (x, u_before, u), with multipliers eliminated."""
    nw = model.nx + 2 * model.nu
    if not model.costs_impulses:
        return evaluated.gradient, project_psd(evaluated.hessian)
    T = np.zeros((len(dlam.value), nw + model.n, nw))
    T[:, :nw] = np.eye(nw)
    T[:, nw:, : model.nx], T[:, nw:, model.nx + model.nu :] = dlam.by_x, dlam.by_u
    gradient = evaluated.gradient + np.einsum("nij,nj->ni", evaluated.hessian[:, :, nw:], dlam.value)
    transposed = T.transpose(0, 2, 1)
    hessian = project_psd(transposed @ evaluated.hessian @ T)
    return (transposed @ gradient[:, :, None])[:, :, 0], hessian


def project_psd(matrices: np.ndarray) -> np.ndarray:
    """Return symmetric matrices (..., n, n) with their negative eigenvalues set to zero."""
    size = np.einsum("...ii->...", abs(matrices))[..., None, None]
    with suppress(np.linalg.LinAlgError):
        np.linalg.cholesky(matrices + (EIGENVALUE_ROUNDING * size + 1e-300) * np.eye(matrices.shape[-1]))
        return matrices
    values, vectors = np.linalg.eigh(matrices)
    return (vectors * np.maximum(values, 0.0)[..., None, :]) @ np.swapaxes(vectors, -1, -2)
