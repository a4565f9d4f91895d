"""A stored program solved by pympcc: ``python tests/benchmarks/arena/pympcc_peer.py FOLDER``, without the workbench.

FOLDER has CasADi's functions ``f_g gradient jacobian hessian`` of (x, p) and ``program.npz`` with the start, p, the
bounds and the pairs. pympcc gets exact sparse derivatives and its own strategy, Scholtes' relaxation; the answer is
written to ``answer.npz``.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pympcc  # pyright: ignore[reportMissingImports]

IPOPT = {"tol": 1e-8, "max_iter": 3000, "print_level": 0, "sb": "yes"}
"""Options of IPOPT, those of the published formulations."""


def triplets(pattern: ca.Sparsity) -> tuple[np.ndarray, np.ndarray]:
    """Return rows and columns of the entries of a pattern, in CasADi's order."""
    return tuple(np.array(indices, dtype=int) for indices in pattern.get_triplet())  # type: ignore[return-value]


class StoredProgram:
    """The program of a folder in pympcc's form: rows ``ineq <= 0`` and ``eq = 0``, pairs of variables."""

    def __init__(self, folder: Path) -> None:
        names = ("f_g", "gradient", "jacobian", "hessian")
        self.functions = {name: ca.Function.load(str(folder / f"{name}.casadi")) for name in names}
        self.data = dict(np.load(folder / "program.npz"))
        lower, upper = self.data["lbg"], self.data["ubg"]
        equal = lower == upper
        self.eq = np.flatnonzero(equal)
        self.above, self.below = (np.flatnonzero(~equal & np.isfinite(side)) for side in (upper, lower))
        self.rows, self.columns = triplets(self.functions["jacobian"].sparsity_out(1))
        self.hessian_rows, self.hessian_columns = triplets(self.functions["hessian"].sparsity_out(0))

    def call(self, name: str, *arguments: Any) -> list[Any]:
        """Return the outputs of a function at (x, p) and further arguments."""
        x, *others = arguments
        return self.functions[name].call([x, self.data["p"], *others])

    def values(self, x: np.ndarray) -> np.ndarray:
        """Return all rows g (m,)."""
        return np.array(self.call("f_g", x)[1]).ravel()

    def slopes(self, x: np.ndarray) -> np.ndarray:
        """Return the entries of the Jacobian of all rows."""
        return np.array(self.call("jacobian", x)[1].nonzeros())

    def block(self, parts: list[tuple[float, np.ndarray]]) -> tuple[tuple[np.ndarray, np.ndarray], Any]:
        """Return the pattern of rows ``sign * g[indices]`` one after another, and the function to their entries."""
        entries, rows, signs, first = [], [], [], 0
        for sign, indices in parts:
            position = np.full(self.data["lbg"].size, -1)
            position[indices] = first + np.arange(indices.size)
            chosen = np.flatnonzero(position[self.rows] >= 0)
            entries.append(chosen)
            rows.append(position[self.rows[chosen]])
            signs.append(np.full(chosen.size, sign))
            first += indices.size
        chosen, sign = np.concatenate(entries), np.concatenate(signs)
        return (np.concatenate(rows), self.columns[chosen]), lambda x: sign * self.slopes(x)[chosen]

    def problem(self) -> pympcc.MPCCProblem:
        """Return the program as pympcc states it."""
        data, (first, second) = self.data, self.data["pairs"]
        count, n = first.size, data["x0"].size
        above, below, eq = self.above, self.below, self.eq
        ineq_pattern, ineq_slopes = self.block([(1.0, above), (-1.0, below)])
        eq_pattern, eq_slopes = self.block([(1.0, eq)])
        pairs = np.arange(count)
        hessian = np.concatenate([self.hessian_columns, np.maximum(first, second)])
        columns = np.concatenate([self.hessian_rows, np.minimum(first, second)])
        products = slice(above.size + below.size + eq.size + 2 * count, None)

        def curvature(x: np.ndarray, y: np.ndarray, weight: float) -> np.ndarray:
            rows = np.zeros(data["lbg"].size)
            rows[above] += y[: above.size]
            rows[below] -= y[above.size :][: below.size]
            rows[eq] += y[above.size + below.size :][: eq.size]
            own = np.array(self.call("hessian", x, weight, rows)[0].nonzeros())
            relaxed = y[products]
            return np.concatenate([own, relaxed[:count] if relaxed.size else np.zeros(count)])

        def inequalities(x: np.ndarray) -> np.ndarray:
            g = self.values(x)
            return np.concatenate([g[above] - data["ubg"][above], data["lbg"][below] - g[below]])

        inequality_arguments: dict[str, Any] = {
            "n_ineq": above.size + below.size,
            "ineq_constraints": inequalities,
            "ineq_jacobian": ineq_slopes,
            "ineq_jacobian_sparsity": ineq_pattern,
        }
        return pympcc.MPCCProblem(
            n=n,
            n_comp=count,
            x0=data["x0"],
            objective=lambda x: float(self.call("f_g", x)[0]),
            gradient=lambda x: np.array(self.call("gradient", x)[1]).ravel(),
            comp_G=lambda x: x[first],
            comp_H=lambda x: x[second],
            comp_G_jacobian=lambda x: np.ones(count),
            comp_H_jacobian=lambda x: np.ones(count),
            comp_G_jacobian_sparsity=(pairs, first),
            comp_H_jacobian_sparsity=(pairs, second),
            xl=data["lbx"],
            xu=data["ubx"],
            **(inequality_arguments if above.size + below.size else {}),
            n_eq=eq.size,
            eq_constraints=lambda x: self.values(x)[eq] - data["lbg"][eq],
            eq_jacobian=eq_slopes,
            eq_jacobian_sparsity=eq_pattern,
            lagrangian_hessian=curvature,
            lagrangian_hessian_sparsity=(hessian, columns),
        )


def main(folder: Path) -> None:
    """Solve the program of a folder and write its answer there."""
    began = time.process_time()
    result = pympcc.solve(StoredProgram(folder).problem(), ipopt_options=IPOPT)
    iterations = sum(int(stage.n_ipopt_iter or 0) for stage in result.history)
    seconds = time.process_time() - began
    np.savez(folder / "answer.npz", x=result.x, seconds=seconds, iterations=iterations, converged=result.success)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
