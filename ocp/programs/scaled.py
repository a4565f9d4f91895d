"""A program in scaled variables, as passed to a solver, and its points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from ocp.programs.program import Program

Bounds = dict[str, Any]
"""Mapping from a solver's argument names to start and bounds."""


@dataclass(frozen=True)
class Point:
    """Variables x (n,) and multipliers of an NLP, as used for a warm start; None if not known."""

    x: np.ndarray
    lam_x: np.ndarray | None = None
    lam_g: np.ndarray | None = None


class Scaled:
    """Scaled program ``min f(X z, p)/F`` subject to bounds on ``g(X z, p)/G``, where X, G, F are a program's scale.

    A solver's tolerances and barrier are absolute numbers. In the variables z they have the same meaning
    for any units of the problem; without a scale everything is passed unchanged.
    """

    def __init__(self, program: Program) -> None:
        self.program, self.scale = program, program.scale

    def functions(self) -> dict[str, ca.Function]:
        """Return ``f_g``, ``grad_f``, ``jac_g`` and ``hess_lag`` in z, with arguments like the program's functions."""
        program, scale = self.program, self.scale
        functions = {
            "f_g": program.f_g,
            "grad_f": program.gradient,
            "jac_g": program.jacobian,
            "hess_lag": program.hessian,
        }
        if scale is None:
            return functions
        X, G = ca.DM(scale.x), ca.DM(scale.g)
        z, p = ca.MX.sym("z", program.n), ca.MX.sym("p", program.n_parameters)
        s, y = ca.MX.sym("s"), ca.MX.sym("y", program.m)
        f, g = functions["f_g"].call([X * z, p], True, False)
        slope = functions["grad_f"].call([X * z, p], True, False)[1]
        rows = functions["jac_g"].call([X * z, p], True, False)[1]
        hessian = functions["hess_lag"].call([X * z, p, s / scale.f, y / G], True, False)[0]
        outputs = {
            "f_g": [f / scale.f, g / G],
            "grad_f": [f / scale.f, X * slope / scale.f],
            "jac_g": [g / G, _scale_matrix(rows, 1 / scale.g, scale.x)],
            "hess_lag": [_scale_matrix(hessian, scale.x, scale.x)],
        }
        return {
            name: ca.Function(
                f"scaled_{name}",
                [z, p, s, y][: functions[name].n_in()],
                expressions,
                functions[name].name_in(),
                functions[name].name_out(),
            )
            for name, expressions in outputs.items()
        }

    def solver_arguments(self, start: Point, bounds: Bounds) -> Bounds:
        """Return start and bounds in z, as arguments of a solver."""
        x, g, f = self._factors
        arguments = {
            "x0": start.x / x,
            **{name: bounds[name] / x for name in ("lbx", "ubx")},
            **{name: bounds[name] / g for name in ("lbg", "ubg")},
        }
        if start.lam_g is not None and start.lam_x is not None:
            arguments |= {"lam_g0": start.lam_g * g / f, "lam_x0": start.lam_x * x / f}
        return arguments

    def unscale(
        self, f: float, x: np.ndarray, lam_x: np.ndarray, lam_g: np.ndarray, g: np.ndarray
    ) -> tuple[Point, float, np.ndarray]:
        """Convert a point, cost and constraints in z to the program's units."""
        by_x, by_g, by_f = self._factors
        return Point(x * by_x, lam_x * by_f / by_x, lam_g * by_f / by_g), f * by_f, g * by_g

    @property
    def _factors(self) -> tuple[np.ndarray | float, np.ndarray | float, float]:
        return (1.0, 1.0, 1.0) if self.scale is None else (self.scale.x, self.scale.g, self.scale.f)


def _scale_matrix(matrix: ca.MX, rows: np.ndarray, columns: np.ndarray) -> ca.MX:
    """Return ``diag(rows) matrix diag(columns)`` with the sparsity of ``matrix``."""
    pattern = matrix.sparsity()
    row, column = (np.array(indices, dtype=int) for indices in pattern.get_triplet())
    return ca.MX(pattern, ca.vec(matrix.nz[:]) * ca.DM(rows[row] * columns[column]))
