"""Small complementarity problems in CasADi, with the interface that certificates need."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from ocp.mpcc import MPCC
from ocp.mpcc.programs import programs_of
from ocp.programs.layout import Layout
from ocp.programs.program import PENALTY, RELAXATION, PairName, Program
from ocp.programs.solver import Solver
from ocp.programs.units import Scale
from ocp.routes.homotopy import Homotopy


@dataclass
class SmallMPCC:
    """Program ``min f`` subject to ``g_lower <= g <= g_upper`` and ``0 <= x_i ⟂ x_j >= 0`` for ``pairs`` (i, j)."""

    x: ca.SX
    f: ca.SX
    g: ca.SX
    g_lower: list[float]
    g_upper: list[float]
    pairs: np.ndarray
    reformulation: str = "none"
    values, first_derivatives, scaled_hessian = Program.values, Program.first_derivatives, Program.scaled_hessian
    typical_change = Program.typical_change

    def __post_init__(self) -> None:
        p, lam_f, lam_g = ca.SX.sym("p"), ca.SX.sym("lf"), ca.SX.sym("lg", self.g.numel())
        inputs = [self.x, p]
        self.f_g = ca.Function("fg", inputs, [self.f, self.g])
        self.gradient = ca.Function("df", inputs, [self.f, ca.gradient(self.f, self.x)])
        self.jacobian = ca.Function("dg", inputs, [self.g, ca.jacobian(self.g, self.x)])
        lagrangian = lam_f * self.f + ca.dot(lam_g, self.g)
        hessian = ca.triu(ca.hessian(lagrangian, self.x)[0])
        self.hessian = ca.Function("h", [*inputs, lam_f, lam_g], [hessian])
        self.pairs = np.asarray(self.pairs, dtype=int).reshape(2, -1)
        self.m = self.g.numel()
        self.natural = Scale.none(self.x.numel(), self.m)
        self.variables = Layout()
        self.variables.add("x", (self.x.numel(),))

    def sizes(self, x: np.ndarray) -> np.ndarray:
        return np.ones(self.x.numel())

    def pair_name(self, index: int) -> PairName:
        return PairName("normal", f"c{index}")

    def bounds(self) -> dict[str, np.ndarray]:
        lower = np.full(self.x.numel(), -np.inf)
        lower[self.pairs.ravel()] = 0.0
        return {
            "lbx": lower,
            "ubx": np.full(self.x.numel(), np.inf),
            "lbg": np.asarray(self.g_lower, dtype=float),
            "ubg": np.asarray(self.g_upper, dtype=float),
        }


def free_pair(f) -> SmallMPCC:
    """Return the problem of two complementary variables with the cost ``f(x1, x2)``."""
    x = ca.SX.sym("x", 2)
    return SmallMPCC(x, f(x[0], x[1]), ca.SX(0, 1), [], [], [[0], [1]])


def scheel_scholtes() -> SmallMPCC:
    """Return ``min z1 + z2 - z0``, ``-4 z1 + z0 <= 0``, ``-4 z2 + z0 <= 0``, ``0 <= z1 ⟂ z2 >= 0``.

    Its only minimiser, the origin, is B-stationary and, as LICQ fails, only M-stationary (Scheel
    and Scholtes 2000, example 3).
    """
    z = ca.SX.sym("z", 3)
    g = ca.vertcat(-4 * z[1] + z[0], -4 * z[2] + z[0])
    return SmallMPCC(z, z[1] + z[2] - z[0], g, [-np.inf] * 2, [0.0] * 2, [[1], [2]])


def symbols(n: int) -> tuple[ca.SX, list[ca.SX]]:
    """Return n symbols as a column and as a list."""
    x = ca.SX.sym("x", n)
    return x, ca.vertsplit(x)


def follower_of(mpcc: MPCC) -> Homotopy:
    """Return a follower of the programs of a problem without parameters."""
    programs = programs_of(mpcc, np.zeros(0), np.zeros(mpcc.x.numel()))
    return Homotopy(programs, Solver("ipopt"), {PENALTY: 0.0, RELAXATION: 0.0})
