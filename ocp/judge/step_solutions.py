"""Search for steps of a plan whose contact has another solution, mode by mode.

A contact is open, sticks or slides. A choice of one of these modes for every contact determines equations: the gap of
an active pair is zero, and lam of an inactive pair is zero. A solution of these equations with ``lam >= 0`` and ``gap
>= 0`` solves the step. If the step is affine, every isolated solution is found in this way; if gaps are curved,
Newton's method starts at the state that the plan reaches.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, product

import casadi as ca
import numpy as np

from ocp.judge.measures import DenseFunction, TrajectoryEvaluator, pair_sizes, slip_sides
from ocp.problem.evaluation import Evaluation, at_steps
from ocp.problem.problem import Problem
from ocp.problem.rollout import Rollout

APART = 1e-2
"""Difference of states, in characteristic sizes, above which two end states of a step are distinct."""
SATISFIED = 1e-5
"""Largest violation of the exact relation by a step of a plan, in characteristic sizes.

A solver that stops at lam gap = 1e-8 N s m leaves errors of a thousandth of both sizes if both are near
zero; such errors cannot separate two end states by more than :data:`APART`.
"""
MODES = 128
"""Maximum number of combinations of modes that are tried at one step."""
_NEWTON_ITERATIONS = 12
"""Maximum number of Newton iterations on one set of active pairs."""
_SOLVED = 1e-9
"""Change and violation, in characteristic sizes, below which the equations of a set of active pairs are solved."""
_PAIR_REGULARISATION = 1e-13
"""Regularisation of the equations of active pairs, in characteristic sizes."""
_LOST = 1e6
"""Change, in characteristic sizes, above which an iteration is abandoned."""
LINEAR_VIOLATION = {True: 1e-6, False: 1.0}
"""Violation after the first Newton step on a set of active pairs, in characteristic sizes, up to which Newton's method
continues: for affine steps (True), and for others (False)."""
_BATCH_STEPS = 32
"""Maximum number of steps whose sets are solved together."""
_BATCH_PAIRS = 100_000
"""Number of entries of derivatives of gaps by multipliers, over the steps of a batch, above which batches are smaller:
every entry is stored for each of up to :data:`MODES` sets."""


@dataclass(frozen=True, eq=False)
class Nonuniqueness:
    """Step of a plan for which the model's exact contact has several solutions from the same state and input.

    The plan's next state satisfies the exact relation; m other solutions, ``x_next`` (m, nx) with ``lam``
    (m, nlam), satisfy it too. ``replayed`` says that the solver of the exact step returns the first of these other
    solutions; ``steps`` counts the plan's steps with several solutions.
    """

    step: int
    scenario: int
    x_next: np.ndarray
    lam: np.ndarray
    replayed: bool
    steps: int


def find_nonuniqueness(evaluation: Evaluation, plan: Rollout) -> Nonuniqueness | None:
    """Return a step of a plan at which the model's exact contact has another solution, or None.

    This is the first step whose replay ends at a state that differs from the plan's state; if there is none, it
    is the first step for which :class:`StepSolutions` finds another solution. Each step is solved from the plan's
    state and input, so that earlier differences have no effect. The result is also None if the plan was made with
    another law or has branches.
    """
    step, (x, u, lam) = evaluation.problem.exact_step, (plan.x, plan.u, plan.lam)
    if lam.shape[2] != step.n or not step.n:
        return None
    x_next, lam_solved, _, error = at_steps(step.solve, x[:, :-1], u, p=step.p.pack(evaluation.values))
    obeys, gap = _obeys(evaluation, plan)
    replayed = np.all(error <= SATISFIED, axis=2) & obeys & _apart(evaluation.problem, x_next, x[:, 1:])
    scenario, node = (array.ravel() for array in np.indices(obeys.shape))
    obeying = obeys.ravel()
    flat_plan = [array.reshape(obeying.size, -1)[obeying] for array in (x[:, :-1], u, x[:, 1:], lam, gap)]
    plan_index, ends, forces = StepSolutions(evaluation)(*flat_plan)
    is_new = _apart(evaluation.problem, ends, flat_plan[2][plan_index])
    plan_index, ends, forces = np.flatnonzero(obeying)[plan_index[is_new]], ends[is_new], forces[is_new]
    several = replayed.ravel().copy()
    several[plan_index] = True
    if not several.any():
        return None
    candidates = np.flatnonzero(replayed if replayed.any() else several)
    k = int(candidates[node[candidates].argmin()])
    s, i, is_replayed = int(scenario[k]), int(node[k]), bool(replayed.flat[k])
    ends, forces = ends[plan_index == k], forces[plan_index == k]
    if is_replayed:
        ends, forces = np.vstack([x_next[s, i], ends]), np.vstack([lam_solved[s, i], forces])
    return Nonuniqueness(i, s, ends, forces, is_replayed, int(several.sum()))


def _apart(problem: Problem, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return (np.abs(first - second) / problem.scales.x).max(axis=-1, initial=0.0) > APART


def _obeys(evaluation: Evaluation, plan: Rollout) -> tuple[np.ndarray, np.ndarray]:
    """Return a mask (S, N) of the plan's steps that satisfy the exact contact relation, and all gaps (S, N, nlam)."""
    system, scaling, lam = evaluation.problem.system, evaluation.problem.scales, plan.lam
    residual, gap = TrajectoryEvaluator(evaluation, system, plan.x, plan.u, lam)(system.residual, system.gap)
    product = scaling.impulse * scaling.gap
    violations = np.stack([-lam / scaling.impulse, -gap / scaling.gap, lam * gap / product])
    motion = np.abs(residual).max(axis=2, initial=0.0)
    return (violations.max(axis=(0, 3), initial=0.0) <= SATISFIED) & (motion <= SATISFIED), gap


def differing_contacts(problem: Problem, first: np.ndarray, second: np.ndarray) -> tuple[str, ...]:
    """Return the names of contacts whose impulses differ between two vectors (nlam,)."""
    system = problem.system
    names = dict(enumerate(() if system.forces is None else system.forces.names))
    for pair, signal in zip(system.pairs, system.contacts, strict=True):
        names.setdefault(pair.contact, signal.name)
    differing = np.flatnonzero(np.abs(first - second) > APART * problem.scales.impulse)
    return tuple(dict.fromkeys(names[system.pairs[i].contact] for i in differing))


class StepSolutions:
    """Solver for all solutions of the exact step of a problem's system, from given states and inputs.

    Contacts and limits whose gap at the end of the plan's step is below the characteristic gap are
    tried in every mode, the nearest first, with at most :data:`MODES` combinations. Other contacts, and
    bodies that slide on tables, keep their mode in the plan.
    """

    def __init__(self, evaluation: Evaluation) -> None:
        problem = evaluation.problem
        system, scales = problem.system, problem.scales
        self.p, self.x_sizes, self._reach = evaluation.p, scales.x, LINEAR_VIOLATION[system.reduced.affine]
        self.of_lam, self.of_gap = pair_sizes(problem, system)
        kinds = np.array([pair.kind for pair in system.pairs])
        owners = np.array([pair.contact for pair in system.pairs]) + 0.5 * (kinds == "limit")
        groups = [np.flatnonzero(owners == owner) for owner in np.unique(owners)]
        self.groups = [rows for rows in groups if kinds[rows[0]] in ("normal", "limit")]
        self.modes = [_modes(rows, kinds[rows]) for rows in self.groups]
        self._slips = [(slip, sides) for slip, sides in slip_sides(system) if sides]
        lam = ca.SX.sym("lam", system.nlam)
        expressions = ca.substitute([system.residual, system.gap / self.of_gap], [system.lam], [self.of_lam * lam])
        expressions += [ca.jacobian(expression, by) for expression in expressions for by in (system.x_next, lam)]
        symbols = [system.x, system.u, system.x_next, lam, problem.parameters.vector]
        self._model = DenseFunction(symbols, expressions)

    def __call__(
        self, x: np.ndarray, u: np.ndarray, x_next: np.ndarray, lam: np.ndarray, gap: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the solutions of n steps from x (n, nx) and u (n, nu), which end at x_next, lam and gap in a plan.

        Each of m solutions has the index of its step (m,), x_next (m, nx) and lam (m, nlam).
        """
        lam, gap = lam / self.of_lam, gap / self.of_gap
        solutions = [(np.zeros(0, dtype=int), x_next[:0], lam[:0])]
        count = min(_BATCH_STEPS, _BATCH_PAIRS // max(1, lam.shape[1]) ** 2 + 1)
        for first in range(0, len(x), count):
            batch = slice(first, first + count)
            sets = [self._active(*pairs) for pairs in zip(lam[batch], gap[batch], strict=True)]
            step_index = np.repeat(np.arange(len(sets)), [len(active) for active in sets])
            step_index, ends, forces = self._solve(step_index, np.concatenate(sets), x[batch], u[batch], x_next[batch])
            solutions.append((step_index + first, ends, forces * self.of_lam))
        step_index, ends, forces = (np.concatenate(arrays) for arrays in zip(*solutions, strict=True))
        return step_index, ends, forces

    def _active(self, lam: np.ndarray, gap: np.ndarray) -> np.ndarray:
        """Return the candidate sets of active pairs (modes, nlam) of one step, from scaled lam and gap (nlam,)."""
        nearest, chosen, count = np.array([gap[rows[0]] for rows in self.groups]), [], 1
        for i in np.argsort(nearest, kind="stable"):
            if nearest[i] > 1 or count * len(self.modes[i]) > MODES:
                break
            chosen.append(i)
            count *= len(self.modes[i])
        sets = np.tile(lam > gap, (count, 1))
        for i in chosen:
            sets[:, self.groups[i]] = False
        for active, modes in zip(sets, product(*(self.modes[i] for i in chosen)), strict=True):
            active[[row for mode in modes for row in mode]] = True
        return sets

    def _solve(
        self, step_index: np.ndarray, active: np.ndarray, x: np.ndarray, u: np.ndarray, x_next: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return solutions (m, .) among the sets (n, nlam) of active pairs of the steps ``step_index`` (n,)."""
        # All sets of a step start at one point, which is linearised once.
        used = np.flatnonzero(active.any(axis=0))
        model = self._reduced(used, x, u, x_next, np.zeros((len(x), active.shape[1])))
        dx, lam, gap = _newton(*model, step_index, active, used)
        self._let_slide(slid_lam := lam.copy(), gap)
        remaining = (np.minimum(slid_lam, gap) > -self._reach).all(axis=1)
        step_index, active, lam = step_index[remaining], active[remaining], lam[remaining]
        x, u, x_next = x[step_index], u[step_index], x_next[step_index] + dx[remaining]
        last_change = np.ones(len(step_index))
        for _ in range(_NEWTON_ITERATIONS):
            remaining = np.flatnonzero((last_change >= _SOLVED) & (last_change < _LOST))
            if not remaining.size:
                break
            used = np.flatnonzero(active[remaining].any(axis=0))
            model = self._reduced(used, x[remaining], u[remaining], x_next[remaining], lam[remaining])
            dx, dl, _ = _newton(*model, np.arange(remaining.size), active[remaining], used)
            x_next[remaining], lam[remaining] = x_next[remaining] + dx, lam[remaining] + dl
            last_change[remaining] = np.abs(np.column_stack([dx / self.x_sizes, dl])).max(axis=1)
        residual, gap, *_ = self._model(x, u, x_next, lam, self.p)
        self._let_slide(lam, gap := gap[:, :, 0])
        solved = (last_change < _SOLVED) & (np.abs(residual).max(axis=(1, 2), initial=0.0) < _SOLVED)
        is_solution = solved & (np.minimum(lam, gap) > -_SOLVED).all(axis=1)
        return step_index[is_solution], x_next[is_solution], lam[is_solution]

    def _let_slide(self, lam: np.ndarray, gap: np.ndarray) -> None:
        """Increase in place the slip multipliers of contacts without friction impulse to the slip of their motion."""
        for slip, sides in self._slips:
            extra_slip = np.where(lam[:, sides].any(axis=1), 0.0, -gap[:, sides].min(axis=1).clip(max=0))
            lam[:, slip] += extra_slip
            gap[:, sides] += extra_slip[:, None]

    def _reduced(self, used: np.ndarray, *point: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return motion, F and gap of linearised steps for changes dl of the ``used`` multipliers (m,).

        ``dx = motion @ [1, dl]`` (n, nx), scaled gaps ``gap + F @ dl``, with F (n, nlam, m) and gap (n, nlam).
        """
        residual, gap, D, E, G, H = self._model(*point, self.p)
        motion = -np.linalg.solve(D, np.concatenate([residual, E[:, :, used]], axis=2))
        return motion, H[:, :, used] + G @ motion[:, :, 1:], (gap + G @ motion[:, :, :1])[:, :, 0]


def _newton(
    motion: np.ndarray, F: np.ndarray, gap: np.ndarray, index: np.ndarray, active: np.ndarray, used: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return Newton steps of x_next (n, nx) and lam (n, nlam), and new gaps, for the linear models ``index`` (n,).

    ``used`` (m,) are the multipliers that are active in any of the sets ``active`` (n, nlam). A singular set, such as
    four corners on one floor, is regularised; repeated steps converge to a solution of it.
    """
    is_active, gap_columns = active[:, used], F[index]
    system_matrix = np.where(is_active[:, :, None] & is_active[:, None], gap_columns[:, used], 0.0)
    system_matrix += np.where(is_active, _PAIR_REGULARISATION, 1.0)[:, :, None] * np.eye(used.size)
    dl = np.zeros(active.shape)
    dl[:, used] = -np.linalg.solve(system_matrix, np.where(is_active, gap[index][:, used], 0.0)[:, :, None])[:, :, 0]
    dx = motion[index, :, 0] + (motion[:, :, 1:][index] @ dl[:, used, None])[:, :, 0]
    return dx, dl, gap[index] + (gap_columns @ dl[:, used, None])[:, :, 0]


def _modes(rows: np.ndarray, kinds: np.ndarray) -> list[tuple[int, ...]]:
    """Return the sets of active pairs of one contact: open, sticking, or sliding along one edge or between two."""
    edges, slip = rows[kinds == "friction"], rows[kinds == "slip"]
    normal = rows[(kinds == "normal") | (kinds == "limit")]
    if not edges.size:
        return [chosen for size in range(len(normal) + 1) for chosen in combinations(normal, size)]
    sides = [*combinations(edges, 1), *(combinations(edges, 2) if len(edges) > 2 else ())]
    return [(), *((*normal, *chosen, *end) for chosen in sides for end in ((), slip))]
