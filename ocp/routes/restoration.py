"""From an infeasible end to a feasible one: violation is minimised over branches."""

from __future__ import annotations

import casadi as ca
import numpy as np

from ocp.programs.program import Functions, Layout, PairName, Program
from ocp.programs.solver import Point
from ocp.routes.branches import Branches
from ocp.routes.homotopy import Homotopy


class Elastic(Program):
    """``min sum(a + b)`` subject to ``g_lower <= g(x, p) - a + b <= g_upper``, the same pairs.

    a, b >= 0 (m,) are what rows are above and below their limits. Bounds of x and complementarity
    are kept, so every point with complementary pairs can be made feasible.
    """

    def __init__(self, base: Program) -> None:
        self.base, self.pairs, self.solvers = base, base.pairs, {}
        self.reformulation = base.reformulation
        self.variables, self.constraints = Layout(), base.constraints
        for name, block in base.variables.blocks.items():
            self.variables.add(name, block.shape, block.components)
        self.variables.add("above", (base.m,))
        self.variables.add("below", (base.m,))
        n, m = base.n, base.m
        z, p = ca.MX.sym("z", n + 2 * m), ca.MX.sym("p", base.n_parameters)
        lam_f, lam_g = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", m)
        x, above, below = z[:n], z[n : n + m], z[n + m :]
        f = ca.sum1(above) + ca.sum1(below)
        g, jacobian = base.jacobian(x, p)
        moved, one = g - above + below, ca.MX.eye(m)
        slope = ca.vertcat(ca.MX.zeros(n), ca.MX.ones(2 * m))
        hessian = ca.diagcat(base.hessian(x, p, 0.0, lam_g), ca.MX(2 * m, 2 * m))
        wide = ca.horzcat(jacobian, -one, one)
        self.f_g, self.gradient, self.jacobian, self.hessian = Functions.of(
            (z, p, lam_f, lam_g), (f, moved), (f, slope), (moved, wide), hessian
        )

    @property
    def title(self) -> str:
        """Name of the problem."""
        return self.base.title

    def parameter_vector(self, values: dict[str, float]) -> np.ndarray:
        """The problem's own."""
        return self.base.parameter_vector(values)

    def bounds(self, values: dict[str, float]) -> dict[str, np.ndarray]:
        """The problem's own, and violations from zero on."""
        own, m = self.base.bounds(values), self.base.m
        lower, upper = np.zeros(2 * m), np.full(2 * m, np.inf)
        return {
            **own,
            "lbx": np.concatenate([own["lbx"], lower]),
            "ubx": np.concatenate([own["ubx"], upper]),
        }

    def sizes(self, x: np.ndarray) -> np.ndarray:
        """The problem's own; 1 for violations."""
        return np.concatenate([self.base.sizes(x[: self.base.n]), np.ones(2 * self.base.m)])

    def pair_name(self, index: int) -> PairName:
        """The problem's own."""
        return self.base.pair_name(index)

    def lifted(self, x: np.ndarray, p: np.ndarray, limits: dict[str, np.ndarray]) -> np.ndarray:
        """Add to x (n,) the violations that it has."""
        _, g = self.base.values(x, p)
        off = [np.maximum(g - limits["ubg"], 0.0), np.maximum(limits["lbg"] - g, 0.0)]
        return np.concatenate([x, *np.nan_to_num(off)])


def restored(follower: Homotopy, x: np.ndarray) -> tuple[np.ndarray, float] | None:
    """Minimise violation over branches from a point of the program as reformulation "none".

    Branch and improve as for any cost (:class:`~ocp.routes.branches.Branches`); a violation left at
    the end is a local minimum over all branches to first order. Returns the point and its sum of
    violations, None where no branch was solved.
    """
    base = follower.nlp_of("none")
    elastic = Elastic(base)
    inner = Homotopy(lambda _: elastic, follower.solver, follower.values, follower.progress,
                     follower.trace)  # fmt: skip
    branches = Branches(inner)
    own = base.bounds(follower.values)
    inside = np.clip(x, own["lbx"], own["ubx"])
    start = Point(elastic.lifted(inside, branches.p, own))
    found = branches.solve_branch(start) or branches.propose(start)
    if found is None:
        return None
    found = branches.improve(found)
    return found.point.x[: base.n], found.f


def violation(
    program: Program, x: np.ndarray, p: np.ndarray, bounds: dict[str, np.ndarray]
) -> tuple[float, str]:
    """Return the largest violation of a bound or constraint at x, and its name."""
    _, g = program.values(x, p)
    worst, name = 0.0, "nothing"
    parts = (("bound on", program.variables, x, "x"), ("constraint", program.constraints, g, "g"))
    for what, layout, values, letter in parts:
        off = np.maximum(bounds[f"lb{letter}"] - values, values - bounds[f"ub{letter}"])
        if off.size and not off.max() <= worst:
            at = int(np.argmax(np.nan_to_num(off, nan=np.inf)))
            block, index = layout.locate(at)
            called = block.components[index[-1]] if block.components else f"{block.name}{[*index]}"
            worst, name = float(off[at]), f"{what} {called}"
    return worst, name
