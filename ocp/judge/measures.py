"""Measures along trajectories: values of a system's expressions, penetration, and forces at a distance."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from dynamics.contact import Step
from dynamics.systems import ContactSystem
from ocp.problem.evaluation import Evaluation, at_steps
from ocp.problem.problem import Problem
from ocp.problem.rollout import Rollout, mean_multipliers


class TrajectoryEvaluator:
    """Evaluator of expressions in (x, u, x_next, lam, p) along trajectories.

    The system is the problem's system or the referee's model of it. Trajectories are x (S, N+1, nx), u (S, N, nu), lam
    (S, N, nlam).
    """

    def __init__(
        self, evaluation: Evaluation, system: ContactSystem, x: np.ndarray, u: np.ndarray, lam: np.ndarray
    ) -> None:
        parameters = evaluation.problem.parameters.vector
        self.symbols = [system.x, system.u, system.x_next, system.lam, parameters]
        self.values, self.p = (x[:, :-1], u, x[:, 1:], lam), evaluation.p

    def __call__(self, *expressions: ca.SX) -> list[np.ndarray]:
        """Return the values (S, N, size) of each expression at every scenario and step."""
        outputs = [ca.densify(expression) for expression in expressions]
        function = ca.Function("evaluate", self.symbols, outputs)
        return at_steps(function, *self.values, p=self.p)


class DenseFunction:
    """Function that evaluates the nonzeros of expressions at many points at once, and returns dense matrices."""

    def __init__(self, symbols: list[ca.SX], expressions: list[ca.SX]) -> None:
        from dynamics.batch import BatchFunction

        outputs = [ca.sparsify(expression) for expression in expressions]
        self._patterns = [(output.shape, *output.sparsity().get_triplet()) for output in outputs]
        nonzeros = [ca.densify(ca.vec(output.nz[:])) for output in outputs]
        self._batch = BatchFunction(ca.Function("dense", symbols, nonzeros), backend="numpy")

    def __call__(self, *arguments: np.ndarray) -> list[np.ndarray]:
        """Return an array (n, rows, columns) per expression; arguments are (n, size), or (size,) for all points."""
        matrices = []
        for entries, (shape, rows, columns) in zip(self._entries(*arguments), self._patterns, strict=True):
            matrices.append(np.zeros((len(entries), *shape)))
            matrices[-1][:, rows, columns] = entries
        return matrices

    def entries(self, *arguments: np.ndarray) -> list[np.ndarray]:
        """Return the nonzeros (n, count + 1) of each expression, and a zero last; see :attr:`positions`."""
        return [np.column_stack([entries, np.zeros(len(entries))]) for entries in self._entries(*arguments)]

    @property
    def positions(self) -> list[np.ndarray]:
        """Index of every entry (rows, columns) of each expression among its :meth:`entries`, -1 for zeros."""
        positions = []
        for shape, rows, columns in self._patterns:
            positions.append(np.full(shape, -1))
            positions[-1][rows, columns] = np.arange(len(rows))
        return positions

    def _entries(self, *arguments: np.ndarray) -> list[np.ndarray]:
        from dynamics.batch import BatchWarning

        # Diverging states are expected; their values are NaN.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", BatchWarning)
            values = self._batch(*arguments)
        return [values] if isinstance(values, np.ndarray) else values


ACTIVE = 1e-3
"""Normal impulse above which a contact counts as acting, as a fraction of the characteristic impulse."""
_WAY_SAMPLES = 16
"""Number of intervals into which the line between two nodes is divided."""
_GOLDEN = (np.sqrt(5) - 1) / 2
"""Ratio of the golden-section search."""
_SECTIONS = 40
"""Number of golden-section steps around the smallest sample."""


@dataclass(frozen=True)
class Worst:
    """Largest ``amount`` of a measure, with its contact, scenario and step; zero if nothing was measured.

    ``step`` is the index of a node, or of an interval for measures between nodes.
    """

    amount: float
    contact: str
    scenario: int
    step: int


@dataclass(frozen=True)
class Physics:
    """Errors of contact in a trajectory, ideally zero, in [m] or the unit of a joint limit; None without geometry.

    ``penetration`` is max(0, -phi) at the nodes; ``between`` is the same along straight lines in the
    coordinates from node to node; ``force_distance`` is the largest phi(x_next) at which a normal
    impulse above :data:`ACTIVE` characteristic impulses acts. NaN is ignored.
    """

    penetration: Worst | None
    between: Worst | None
    force_distance: Worst | None


def measure(evaluation: Evaluation, step: Step, rollout: Rollout) -> Physics:
    """Return the penetration of trajectories of ``step``, and the largest distance at which contact forces act."""
    problem, x = evaluation.problem, rollout.x
    phi, names = evaluation.signed_distances(x), problem.system.distance_names
    if phi is None:
        return Physics(None, None, None)
    system, impulse = step.system, mean_multipliers(step, rollout.lam)
    if system.forces is None:
        # Normal pairs have the order of the first ``phi``; multipliers that are forces [N] are not converted.
        impulse = impulse[:, :, [i for i, pair in enumerate(system.pairs) if pair.kind == "normal"]]
    else:
        evaluate = TrajectoryEvaluator(evaluation, system, x, rollout.u, impulse)
        impulse = evaluate(system.forces.normal)[0]
    next_distances = phi[:, 1:, : impulse.shape[2]]
    force_distances = np.where(impulse > ACTIVE * problem.scales.impulse, next_distances, 0.0)
    return Physics(
        _worst(-phi, names), between(evaluation, x), None if np.isnan(impulse).all() else _worst(force_distances, names)
    )


def pair_sizes(problem: Problem, system: ContactSystem) -> tuple[np.ndarray, np.ndarray]:
    """Return characteristic sizes (nlam,) of a system's multipliers and gaps; either may be a length [m]."""
    is_length, sizes = [signal.unit == "m" for signal in system.contacts], problem.scales
    lam = np.where(is_length, sizes.gap, sizes.impulse)
    return lam, np.where(is_length, sizes.impulse, sizes.gap)


def slip_sides(system: ContactSystem) -> list[tuple[int, list[int]]]:
    """Return the index of each contact's slip pair, and the indices of the contact's friction pairs."""
    return [
        (i, [j for j, other in enumerate(system.pairs) if other.kind == "friction" and other.contact == pair.contact])
        for i, pair in enumerate(system.pairs)
        if pair.kind == "slip"
    ]


def _worst(amounts: np.ndarray, names: Sequence[str]) -> Worst:
    finite_amounts = np.nan_to_num(amounts, nan=-np.inf)
    if not finite_amounts.size:
        return Worst(0.0, "", 0, 0)
    s, k, i = (int(v) for v in np.unravel_index(int(np.argmax(finite_amounts)), finite_amounts.shape))
    return Worst(max(0.0, float(finite_amounts[s, k, i])), names[i], s, k)


def between(evaluation: Evaluation, x: np.ndarray) -> Worst:
    """Return the deepest penetration on the straight lines between the nodes of x (S, N+1, nx)."""
    return _worst(-least_between(evaluation, x), evaluation.problem.system.distance_names)


def least_between(evaluation: Evaluation, x: np.ndarray) -> np.ndarray:
    """Return the smallest phi (S, N, n_phi) on the straight line from every node to the next, ends included.

    The line is sampled at 17 points and searched by golden section around the smallest sample. The
    result is exact if phi has one minimum between two samples, as for convex bodies that do not
    rotate, whose distance is convex along the line.
    """
    start, displacement = x[:, :-1, None], np.diff(x, axis=1)[:, :, None]
    fractions = np.linspace(0, 1, _WAY_SAMPLES + 1)
    sampled = evaluation.signed_distances(start + fractions[:, None] * displacement)
    assert sampled is not None
    least_index = np.nan_to_num(sampled, nan=np.inf).argmin(axis=2)
    low, high = fractions[np.maximum(least_index - 1, 0)], fractions[np.minimum(least_index + 1, _WAY_SAMPLES)]
    contact_index = np.arange(sampled.shape[3])

    def phi(t: np.ndarray) -> np.ndarray:
        # Each contact has its own position on the line, and needs only its own distance there.
        phi = evaluation.signed_distances(start + t[..., None] * displacement)
        assert phi is not None
        return phi[:, :, contact_index, contact_index]

    least_phi = sampled.min(axis=2)
    left_point, right_point = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
    phi_left, phi_right = phi(left_point), phi(right_point)
    for _ in range(_SECTIONS):
        least_phi = np.minimum(least_phi, np.minimum(phi_left, phi_right))
        in_left = phi_left < phi_right
        low, high = np.where(in_left, low, left_point), np.where(in_left, right_point, high)
        new_point = np.where(in_left, high - _GOLDEN * (high - low), low + _GOLDEN * (high - low))
        phi_at_new = phi(new_point)
        left_point, right_point = np.where(in_left, new_point, right_point), np.where(in_left, left_point, new_point)
        phi_left, phi_right = np.where(in_left, phi_at_new, phi_right), np.where(in_left, phi_left, phi_at_new)
    return np.minimum(least_phi, np.minimum(phi_left, phi_right))
