"""A mathematical program with complementarity constraints, its named blocks, and its scaling."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import casadi as ca
import numpy as np

from ocp.programs.layout import Layout
from ocp.programs.units import Scale

if TYPE_CHECKING:
    import scipy.sparse as sp


PENALTY = "route.penalty"
"""Name of the parameter of every program that weights, in the cost, the products of its pairs."""
RELAXATION = "route.relaxation"
"""Name of the parameter ``t`` of every program, see :class:`Program`."""


NEAR_KINK = 0.03
"""Distance from a kink, in changes of its margin by a variable's size, within which its side is fixed."""
ON_KINK = 1e-6
"""Margin of a kink, in the same unit or in natural units, below which a plan lies on the kink."""
_AT_BOUND = 1e-4
"""Distance from a bound, in characteristic sizes, below which a variable is at the bound."""


@dataclass(frozen=True)
class PairName:
    """Name of a pair: its kind (see :class:`~dynamics.systems.Pair`), its signal, scenario and step."""

    kind: str
    name: str
    scenario: int = 0
    step: int = 0


class Program(ABC):
    """``min f(x, p)`` subject to ``g_lower <= g(x, p) <= g_upper``, bounds, ``0 <= G ⟂ H >= 0``.

    G and H are entries of x at the indices ``pairs`` (2, m). ``reformulation`` says which rows the pairs
    have in the block "contact": "product", ``G H - mu``; "none", no rows, for fixed active sets or a
    penalty on G H; "fischer-burmeister", ``G + H - sqrt(G² + H² + 2 t)``; "lin-fukushima", ``G H - t²``,
    with ``(G + t)(H + t) - t²`` in the block "separation"; t is the parameter ``relaxation``.

    ``f_g`` maps (x, p) to (f, g); ``gradient`` to (f, df/dx); ``jacobian`` to (g, dg/dx);
    ``hessian`` maps (x, p, lam_f, lam_g) to the upper triangle of the Lagrangian's Hessian. x is
    laid out by ``variables``, g by ``constraints``; ``solvers`` stores compiled solver instances.
    """

    variables: Layout
    constraints: Layout
    f_g: ca.Function
    gradient: ca.Function
    jacobian: ca.Function
    hessian: ca.Function
    reformulation: str
    pairs: np.ndarray
    solvers: dict[str, Any]

    @property
    @abstractmethod
    def title(self) -> str:
        """Name of the program in error messages."""

    @abstractmethod
    def parameter_vector(self, values: dict[str, float]) -> np.ndarray:
        """Return the vector p at named values, which include ``penalty`` and ``relaxation``."""

    @abstractmethod
    def bounds(self, values: dict[str, float]) -> dict[str, np.ndarray]:
        """Return the bounds ``lbx ubx lbg ubg`` at named values."""

    @abstractmethod
    def sizes(self, x: np.ndarray) -> np.ndarray:
        """Return the characteristic size (n,) of every variable, near a point x."""

    @abstractmethod
    def pair_name(self, index: int) -> PairName:
        """Return the name of the pair ``pairs[:, index]``."""

    def is_near_kink(self, x: np.ndarray, values: dict[str, float], reach: float) -> bool:
        """Return whether a point is within ``reach`` of a kink whose side may be fixed; by default there are none."""
        return False

    def constant(self, p: np.ndarray) -> float:
        """Return the sum of the constant terms of the cost, which ``f`` does not contain."""
        return 0.0

    def typical_change(self, x: np.ndarray, p: np.ndarray, bounds: dict[str, np.ndarray]) -> float:
        """Return a typical change of the cost at a point x, a reference for changes that count as small.

        A signal, the entries of a block with one last index, changes the cost by the largest
        ``|slope| + |curvature| / 2`` of its entries as each changes by its size. The result is the lower
        median over the signals that change the cost or, if that is larger, the cost without constant
        terms, but at most the largest change by an entry that no bound holds against the slope. The result
        therefore does not grow with a sum over many steps or with one steep entry. It is zero for a constant cost.
        """
        sizes = self.sizes(x)
        f, gradient = self.gradient(x, p)
        slope = np.array(gradient).ravel() * sizes
        curvature = self.scaled_hessian(x, p, np.zeros(self.m), sizes).diagonal()
        entry_changes = np.nan_to_num(np.abs(slope) + np.abs(curvature) / 2, posinf=0.0)
        below, above = (x - bounds["lbx"]) / sizes, (bounds["ubx"] - x) / sizes
        is_held = ((below < _AT_BOUND) & (slope > 0)) | ((above < _AT_BOUND) & (slope < 0))
        signals = [block.index.reshape(-1, block.shape[-1]).T for block in self.variables.blocks.values() if block.size]
        largest = np.array([entry_changes[rows].max() for block in signals for rows in block])
        largest = largest[largest > 0]
        if not largest.size:
            return 0.0
        median = float(np.quantile(largest, 0.5, method="lower"))
        return max(median, min(abs(float(f)), float(entry_changes[~is_held].max(initial=0.0))))

    @property
    def chains(self) -> np.ndarray:
        """Indices of pairs that are consecutive in time, one row per chain; empty for a program without time."""
        return np.empty((0, 0), dtype=int)

    @cached_property
    def scale(self) -> Scale | None:
        """Divisors of variables, constraints and cost for a solver; None if nothing is scaled."""
        return None

    @property
    def natural(self) -> Scale:
        """The :attr:`scale`, or ones if it is None."""
        return self.scale or Scale.none(self.n, self.m)

    @property
    def n(self) -> int:
        """Number of variables."""
        return self.variables.size

    @property
    def m(self) -> int:
        """Number of constraints."""
        return self.constraints.size

    @property
    def n_parameters(self) -> int:
        """Length of the parameter vector p."""
        return int(self.f_g.size1_in(1))

    def values(self, x: np.ndarray, p: np.ndarray) -> tuple[float, np.ndarray]:
        """Return cost and constraints (m,) at x and p."""
        f, g = self.f_g(x, p)
        return float(f), np.array(g).ravel()

    def largest_violation(self, x: np.ndarray, g: np.ndarray, bounds: dict[str, np.ndarray]) -> float:
        """Return the largest violation of a bound or row, in natural units; infinite for NaN."""
        amounts = [
            np.maximum(bounds[f"lb{kind}"] - values, values - bounds[f"ub{kind}"]) / unit
            for kind, values, unit in (("x", x, self.natural.x), ("g", g, self.natural.g))
        ]
        return float(np.nan_to_num(np.concatenate(amounts), nan=np.inf, posinf=np.inf).max(initial=0.0))

    def first_derivatives(self, x: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray, sp.csr_matrix]:
        """Return the gradient of the cost (n,), constraints (m,) and their Jacobian (m, n)."""
        import scipy.sparse as sp

        g, jacobian = self.jacobian(x, p)
        gradient = np.array(self.gradient(x, p)[1]).ravel()
        return gradient, np.array(g).ravel(), sp.csr_matrix(jacobian.sparse())

    def scaled_hessian(self, x: np.ndarray, p: np.ndarray, multipliers: np.ndarray, sizes: np.ndarray) -> sp.csr_matrix:
        """Return the Hessian (n, n) of ``f + multipliers' g`` with respect to variables divided by ``sizes`` (n,)."""
        import scipy.sparse as sp

        upper = sp.csr_matrix(self.hessian(x, p, 1.0, multipliers).sparse())
        return sp.csr_matrix(sp.diags(sizes) @ (upper + sp.triu(upper, 1).T) @ sp.diags(sizes))

    def active_sets(self, x: np.ndarray) -> list[np.ndarray]:
        """Return guesses of the active set near x, as masks (m,) of the pairs whose second member is zero."""
        first, second = x[self.pairs] / self.sizes(x)[self.pairs]
        return [first > second]

    def products(self, x: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Return the products ``G H`` of all pairs (m,)."""
        first, second = x[self.pairs]
        return first * second


class Functions(NamedTuple):
    """The CasADi functions of a :class:`Program`."""

    f_g: ca.Function
    gradient: ca.Function
    jacobian: ca.Function
    hessian: ca.Function

    @classmethod
    def of(
        cls, symbols: Sequence[Any], f_g: Sequence[Any], gradient: Sequence[Any], jacobian: Sequence[Any], hessian: Any
    ) -> Functions:
        """Build the functions from symbols (x, p, lam_f, lam_g) and outputs; ``hessian`` is the upper triangle."""
        names, x_and_p = ["x", "p", "lam:f", "lam:g"], [*symbols[:2]]
        return cls(
            ca.Function("nlp", x_and_p, [*f_g], names[:2], ["f", "g"]),
            ca.Function("grad_f", x_and_p, [*gradient], names[:2], ["f", "grad:f:x"]),
            ca.Function("jac_g", x_and_p, [*jacobian], names[:2], ["g", "jac:g:x"]),
            ca.Function("hess_lag", [*symbols], [hessian], names, ["triu:hess:gamma:x:x"]),
        )


def closure_rows(
    reformulation: str, first: ca.SX, second: ca.SX, mu: ca.SX | float, t: ca.SX
) -> list[tuple[str, ca.SX]]:
    """Return (block, rows) of a reformulation of ``0 <= first ⟂ second >= 0``, see :class:`Program`."""
    if reformulation == "product":
        return [("contact", first * second - mu)]
    if reformulation == "fischer-burmeister":
        return [("contact", first + second - ca.sqrt(first**2 + second**2 + 2 * t))]
    if reformulation == "lin-fukushima":
        return [
            ("contact", first * second - t**2),
            ("separation", (first + t) * (second + t) - t**2),
        ]
    return []
