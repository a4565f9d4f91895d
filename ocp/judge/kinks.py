"""Certificate of a point that lies on kinks: no direction, to either side of any of them, lowers the cost.

At a point on the kinks ``m_k(x) = 0`` a piecewise smooth function has the directional derivative

    f'(x; d) = f_-' d + sum_k c_k max(g_k' d, 0),    g_k = grad m_k,  (f_+ - f_-)' = c_k g_k',

where ``f_-`` is the piece with all margins negative and ``f_+`` that with margin k positive. With ``g_k' d = s_k -
t_k``, ``0 <= s_k ⟂ t_k >= 0``, the first-order problem is one with complementarity, whose pairs are certified like
those of contacts (the abs-normal form, Hegerhorst-Schultchen, Kirches and Steinbach 2020).
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ocp.judge.certificate import Certificate, certify
from ocp.programs.layout import Layout
from ocp.programs.program import ON_KINK, PairName, Program
from ocp.programs.units import Scale
from ocp.transcription.pieces import PiecewiseNLP

if TYPE_CHECKING:
    import scipy.sparse as sp

PARALLEL = 1e-6
"""Difference of 1 and the cosine between two margins' slopes below which two kinks are the same."""


def certify_at_kinks(program: PiecewiseNLP, x: np.ndarray, values: dict[str, float]) -> Certificate | None:
    """Return the certificate of a point that lies on kinks, None if their effects do not add up, as at two at once."""
    lifted = KinkModel(program, x, values)
    if not lifted.is_additive(x, values):
        return None
    return certify(lifted, lifted.extended(x), lifted.parameter_vector(values), lifted.bounds(values))


class KinkModel(Program):
    """First-order model of a program at a point ``x`` on kinks, with a pair ``s_k ⟂ t_k`` for each of them.

    Variables are those of the program, then s and t (K,) each; constraints are those of the program, then
    ``m_k + g_k' d - s_k + t_k = 0``. Derivatives are valid at ``x`` only.
    """

    def __init__(self, program: PiecewiseNLP, x: np.ndarray, values: dict[str, float]) -> None:
        margins, changes = program.kink_margins(x, values)
        at_kink = np.flatnonzero(np.abs(margins) < ON_KINK * changes)
        live = program.with_sides(np.zeros(margins.size))
        p, sizes = live.parameter_vector(values), live.sizes(x)
        slopes = live.first_derivatives(x, p)[2][program.kink_rows[at_kink]].multiply(sizes).toarray()
        groups = _parallel_groups(slopes)
        first = np.array([members[0] for members, _ in groups], dtype=int)
        sides = np.zeros(margins.size)
        for members, signs in groups:
            sides[at_kink[members]] = -signs
        self.piece, self.live, self.reformulation = program.with_sides(sides), live, "none"
        self.kinks, self.slopes = at_kink[first], slopes[first] / sizes
        self.margins, self.changes = margins[self.kinks], changes[self.kinks]
        self.base = self.piece.first_derivatives(x, self.piece.parameter_vector(values))
        self.jumps = [
            self._jump(x, values, sides, at_kink[members], slope)
            for (members, _), slope in zip(groups, self.slopes, strict=True)
        ]
        self.variables, self.constraints = Layout(), Layout()
        self.variables.add("x", (x.size + 2 * first.size,))
        self.constraints.add("g", (program.m + first.size,))
        s = x.size + np.arange(first.size)
        self.pairs = np.concatenate([program.pairs, np.stack([s, s + first.size])], axis=1)

    def _jump(
        self, x: np.ndarray, values: dict[str, float], sides: np.ndarray, kinks: np.ndarray, slope: np.ndarray
    ) -> tuple[float, np.ndarray]:
        """Return the factors c_k of the cost and of the constraints (m,) as the ``kinks`` of a group change sides."""
        changed = sides.copy()
        changed[kinks] *= -1
        beyond = self.piece.with_sides(changed)
        gradient, _, jacobian = beyond.first_derivatives(x, beyond.parameter_vector(values))
        direction = slope / (slope @ slope)
        return float((gradient - self.base[0]) @ direction), (jacobian - self.base[2]) @ direction

    def is_additive(self, x: np.ndarray, values: dict[str, float]) -> bool:
        """Return whether the piece with all margins positive has the derivatives that single kinks predict."""
        import scipy.sparse as sp

        opposite = self.piece.with_sides(-self.piece.sides)
        gradient, _, jacobian = opposite.first_derivatives(x, opposite.parameter_vector(values))
        costs, rows = np.array([cost for cost, _ in self.jumps]), np.array([row for _, row in self.jumps])
        slopes, sizes = sp.csr_matrix(self.slopes), sp.diags(self.piece.sizes(x))
        last, first = (sp.vstack([sp.csr_matrix(c), J]) @ sizes for c, J in ((gradient, jacobian), self.base[:3:2]))
        predicted = sp.vstack([sp.csr_matrix(costs), sp.csr_matrix(rows.T)]) @ slopes @ sizes
        return bool(abs(last - first - predicted).max() <= PARALLEL * max(abs(first).max(), abs(last).max()))

    def extended(self, x: np.ndarray) -> np.ndarray:
        """Return the point of the model: x with the margins' positive and negative parts."""
        return np.concatenate([x, np.maximum(self.margins, 0), np.maximum(-self.margins, 0)])

    @property
    def title(self) -> str:
        """Name of the program."""
        return self.piece.title

    @cached_property
    def scale(self) -> Scale | None:
        """Units of the program; margins have the unit 1."""
        scale, count = self.piece.natural, self.kinks.size
        return Scale(np.append(scale.x, np.ones(2 * count)), np.append(scale.g, np.ones(count)), scale.f)

    def parameter_vector(self, values: dict[str, float]) -> np.ndarray:
        """Return the parameters of the piece."""
        return self.piece.parameter_vector(values)

    def bounds(self, values: dict[str, float]) -> dict[str, np.ndarray]:
        """Return the bounds; the margins themselves are free."""
        count, bounds = self.kinks.size, self.live.bounds(values)
        more = {"lbx": np.zeros(2 * count), "ubx": np.full(2 * count, np.inf)}
        more |= {"lbg": np.zeros(count), "ubg": np.zeros(count)}
        return {key: np.append(bound, more[key]) for key, bound in bounds.items()}

    def sizes(self, x: np.ndarray) -> np.ndarray:
        """Return the sizes of variables; those of margins are their changes."""
        return np.concatenate([self.piece.sizes(x[: self.piece.n]), self.changes, self.changes])

    def pair_name(self, index: int) -> PairName:
        """Return the name of a pair of the program, or of a kink."""
        count = self.piece.pairs.shape[1]
        return self.piece.pair_name(index) if index < count else PairName("kink", f"kink {index - count + 1}")

    def values(self, x: np.ndarray, p: np.ndarray) -> tuple[float, np.ndarray]:
        """Return cost and constraints at the point."""
        cost, g = self.piece.values(x[: self.piece.n], p)
        return cost, np.append(g, np.zeros(self.kinks.size))

    def typical_change(self, x: np.ndarray, p: np.ndarray, bounds: dict[str, np.ndarray]) -> float:
        """Return the typical change of the program's cost."""
        n, m = self.piece.n, self.piece.m
        parts = {key: bound[: n if key.endswith("x") else m] for key, bound in bounds.items()}
        return self.piece.typical_change(x[:n], p, parts)

    def first_derivatives(self, x: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray, sp.csr_matrix]:
        """Return gradient, constraints and Jacobian at the point, with the margins' parts as variables."""
        import scipy.sparse as sp

        gradient, g, jacobian = self.base
        count = self.kinks.size
        costs, rows = np.array([cost for cost, _ in self.jumps]), np.array([row for _, row in self.jumps])
        identity = sp.identity(count)
        blocks = [[jacobian, sp.csr_matrix(rows.T), None], [sp.csr_matrix(self.slopes), -identity, identity]]
        extended = np.concatenate([gradient, costs, np.zeros(count)])
        return extended, np.append(g, np.zeros(count)), sp.csr_matrix(sp.bmat(blocks))

    def scaled_hessian(self, x: np.ndarray, p: np.ndarray, multipliers: np.ndarray, sizes: np.ndarray) -> sp.csr_matrix:
        """Return the Hessian of the piece; the margins' parts have none."""
        import scipy.sparse as sp

        n, count = self.piece.n, 2 * self.kinks.size
        hessian = self.piece.scaled_hessian(x[:n], p, multipliers[: self.piece.m], sizes[:n])
        return sp.csr_matrix(sp.block_diag([hessian, sp.csr_matrix((count, count))]))


def _parallel_groups(slopes: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return groups of parallel rows: their indices, and 1 or -1 by their direction relative to the first."""
    directions = slopes / np.linalg.norm(slopes, axis=1, keepdims=True)
    cosines, left, groups = directions @ directions.T, np.arange(len(slopes)), []
    while left.size:
        parallel = np.abs(cosines[left[0], left]) > 1 - PARALLEL
        groups.append((left[parallel], np.sign(cosines[left[0], left[parallel]])))
        left = left[~parallel]
    return groups
