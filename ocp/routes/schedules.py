"""Search over contact schedules: contacts one step earlier or later, and distant schedules from rollouts."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ocp.judge.lpec import LinearModel
from ocp.problem.parts import Scales
from ocp.programs.solver import Point, Result
from ocp.routes.branches import NEIGHBOUR, Branches
from ocp.routes.homotopy import COST_GAIN, lower

_ITERATIONS = 40
"""Iteration limit of one neighbour: useful neighbours are near, others are often infeasible."""
_TURNS = 3
"""Maximum number of rounds in which neighbouring schedules and branches are exchanged alternately."""
_MAX_REMOVED_STEPS = 2
"""Maximum number of steps of a contact that a move may remove."""
SEARCH_ITERATIONS = 800
"""Maximum number of solver iterations of a search."""
SEARCH_WORK = 540_000
"""Maximum product of solver iterations and pairs in a search, which limits large problems."""
_NEAREST = 1e-3
"""Lower limit of the distance in :func:`predicted_gains`, in characteristic sizes."""
MAX_FAILURES = 20
"""Number of failed neighbours in a row, in order of promise, after which a search ends."""
MAX_UNLIKELY = 3
"""Maximum number of neighbours of a schedule that a search of limited patience solves although they are predicted to
cost more; of 530 such neighbours of 46 problems, eight reduced the cost."""
LEAST_FAILURES = 2
"""Number of failed neighbours in a row up to which a patient search tries those that are predicted to cost more."""
VAIN_SHARE = 2.0
"""Iterations of such neighbours in a row, relative to all iterations before them, after which a search ends.

At 1 a drawn cart-transport ends at 6.94 instead of 5.60."""
SMALL_GAIN = 1e-5
"""Predicted relative change of the cost up to which a search of limited patience leaves a neighbour out."""
WORTHWHILE_GAIN = 1e-3
"""Relative reduction of the cost that extends a search of limited patience."""
PREDICTED = 64
"""Maximum number of neighbours whose costs are predicted, those with the steepest descent."""


@dataclass(frozen=True)
class ScheduleMove:
    """Move of contact number ``run`` in a chain of pairs, by ``begins`` steps at its start and ``ends`` at its end."""

    chain: int
    run: int
    begins: int
    ends: int

    @property
    def doubled(self) -> ScheduleMove:
        """Move of the same contact by twice as many steps."""
        return replace(self, begins=2 * self.begins, ends=2 * self.ends)


def improve(
    branches: Branches, neighbour: Result, max_failures: int = MAX_FAILURES, patience: float = math.inf
) -> Result:
    """Return the best result of alternating first-order exchanges of branches and neighbouring schedules.

    ``max_failures`` and ``patience`` limit the search for neighbours, see :func:`improve_schedule`.
    """
    best = branches.improve(neighbour)
    for _ in range(_TURNS):
        neighbour = improve_schedule(branches, best, max_failures, patience)
        if not lower(neighbour, best):
            return best
        best = branches.improve(neighbour)
        if not lower(best, neighbour):
            return best
    return best


def improve_schedule(
    branches: Branches, best: Result, max_failures: int = MAX_FAILURES, patience: float = math.inf
) -> Result:
    """Exchange a schedule for a cheaper neighbour until there is none, and return the best result.

    On a time grid every time of a contact event is a separate local minimum: the pairs of adjacent steps
    are far from (0, 0), so that first-order descent cannot shift a contact for any trust region. Therefore
    single pairs change sides, or runs of active pairs are moved by a step, and the branch is solved again.
    The first move tried is twice the last successful one; others follow in the order of the costs that
    :class:`BranchModel` predicts. The search ends after ``max_failures`` in a row that do not reduce the cost. It ends
    earlier if the next neighbour is predicted to cost more, and the failures since the last success took more than
    :data:`VAIN_SHARE` times all iterations before them. With a finite ``patience`` at most :data:`MAX_UNLIKELY` of
    these are tried, and the search ends if neighbours that reduced the cost by less than :data:`WORTHWHILE_GAIN` in sum
    took more than ``patience`` times the iterations before it.
    """
    program, trace = branches.program, branches.follower.trace
    iteration_limit = trace.iterations + min(SEARCH_ITERATIONS, SEARCH_WORK // max(program.pairs.shape[1], 1))
    active = program.active_sets(best.point.x)[-1]
    tried_sets, promising_move = {active.tobytes()}, None
    patience_iterations = patience * max(trace.iterations, 1)
    most_unlikely, least_gain = (MAX_UNLIKELY, SMALL_GAIN) if np.isfinite(patience) else (np.inf, COST_GAIN)
    gained_at, start = trace.iterations, best
    while True:
        failed, unlikely, iterations_before = 0, 0, trace.iterations
        for change, move, changed in _neighbours(branches, best, active, promising_move, least_gain):
            if changed.tobytes() in tried_sets:
                continue
            is_unlikely = change >= 0
            unlikely += is_unlikely and move is not promising_move
            spent = trace.iterations - iterations_before
            in_vain = is_unlikely and failed >= LEAST_FAILURES and spent > VAIN_SHARE * iterations_before
            out_of_patience = trace.iterations - gained_at > patience_iterations or unlikely > most_unlikely
            if trace.iterations > iteration_limit or failed == max_failures or in_vain or out_of_patience:
                return best
            tried_sets.add(changed.tobytes())
            result = branches.solve(best.point, changed, _ITERATIONS, label=NEIGHBOUR)
            if result.ok and lower(result, best):
                best, active = result, changed
                if lower(best, start, WORTHWHILE_GAIN):
                    gained_at, start = trace.iterations, best
                promising_move = move.doubled if isinstance(move, ScheduleMove) else None
                break
            failed += 1
        else:
            return best


Neighbour = tuple[float, "ScheduleMove | int", np.ndarray]
"""Predicted change of the cost, move or pair that changes sides, and active set (m,) of a neighbouring schedule."""


def _neighbours(
    branches: Branches, best: Result, active: np.ndarray, promising_move: ScheduleMove | None, least_gain: float
) -> list[Neighbour]:
    """Return the neighbours of a schedule: that of the promising move, then others by their predicted costs.

    A neighbour whose cost differs relatively by at most ``least_gain`` is left out: where its pairs are at (0, 0), it
    has the same solution.
    """
    fall, distances = predicted_gains(branches, best, active)
    chains = branches.program.chains
    neighbours = []
    for move in [*([promising_move] if promising_move else []), *moves(active, chains), *np.flatnonzero(fall > 0)]:
        changed = apply_move(active, chains, move)
        if changed is None or not fall[differs := changed != active].any():
            continue
        neighbours.append((move is not promising_move, -fall[differs].sum() / distances[differs].sum(), move, changed))
    neighbours = sorted(neighbours, key=lambda entry: entry[:2])[:PREDICTED]
    if not neighbours or best.point.lam_g is None:
        return [(slope, move, changed) for _, slope, move, changed in neighbours]
    pairs = np.flatnonzero(np.any([changed != active for *_, changed in neighbours], axis=0))
    try:
        model = BranchModel(branches, best, active, pairs)
    except RuntimeError:
        return [(slope, move, changed) for _, slope, move, changed in neighbours]
    predicted = [(model.change(changed != active), move, changed) for _, _, move, changed in neighbours]
    moving = [entry for entry in predicted if abs(entry[0]) > least_gain * abs(best.f)]
    # Both orders alternate, since costs are lower than predicted where bounds become inactive.
    cheapest = sorted(moving, key=lambda entry: entry[0])
    return [neighbour for two in zip(moving, cheapest, strict=True) for neighbour in two]


def predicted_gains(branches: Branches, result: Result, active: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the predicted gain (m,) when each pair changes sides, and the pair's distance (m,) from doing so.

    The gain is the first-order decrease of the cost as the held member grows by its characteristic size,
    zero if the cost does not decrease. The distance is the other member, which then decreases to zero, in
    characteristic sizes; the smaller it is, the better the prediction.
    """
    program, x = branches.program, result.point.x
    (first, second), sizes = program.pairs, program.sizes(x)
    held_members, free_members = np.where(active, (second, first), (first, second))
    multiplier = branches.bound_multipliers(result, active)
    fall = np.where(multiplier > branches.min_multiplier, multiplier * (sizes / program.natural.x)[held_members], 0.0)
    return fall, np.maximum(x[free_members] / sizes[free_members], _NEAREST)


def moves(active: np.ndarray, chains: np.ndarray) -> Iterator[ScheduleMove]:
    """Yield moves of every run by a step earlier or later, at one end or both ends, and removals of short runs."""
    for chain, pairs in enumerate(chains):
        for run, (begin, end) in enumerate(runs(active[pairs])):
            for begins, ends in ((1, 1), (-1, -1), (0, 1), (0, -1), (1, 0), (-1, 0)):
                yield ScheduleMove(chain, run, begins, ends)
            if end - begin <= _MAX_REMOVED_STEPS:
                yield ScheduleMove(chain, run, end - begin, 0)


def apply_move(active: np.ndarray, chains: np.ndarray, move: ScheduleMove | int) -> np.ndarray | None:
    """Return the active set (m,) after a move, or after pair ``move`` changes sides; None if there is no such run."""
    if not isinstance(move, ScheduleMove):
        changed = active.copy()
        changed[move] ^= True
        return changed
    pairs = chains[move.chain]
    active_runs = runs(active[pairs])
    if move.run >= len(active_runs):
        return None
    begin, end = active_runs[move.run]
    changed = active.copy()
    changed[pairs[begin:end]] = False
    changed[pairs[max(begin + move.begins, 0) : max(end + move.ends, 0)]] = True
    return changed


def runs(held: np.ndarray) -> list[tuple[int, int]]:
    """Return the first index, and the index after the last, of every unbroken run of True."""
    steps = np.diff(np.concatenate([[0], held.astype(int), [0]]))
    ends = (np.flatnonzero(steps == sign).tolist() for sign in (1, -1))
    return list(zip(*ends, strict=True))


_MAX_DISTANT_BRANCHES = 8
"""Maximum number of branches solved for distant schedules."""
_DISTANT_ITERATIONS = 128
"""Iteration limit of the branch of a distant schedule, which has a feasible point nearby or often none."""
_MIN_SCHEDULE_DISTANCE = 0.125
"""Distance of two schedules (:func:`schedule_distance`) above which they are distinct."""
_FEASIBLE = 1e-6
"""Maximum violation, in natural units, of a plan that counts as feasible."""


def distant_schedules(
    branches: Branches, points: Sequence[Point], cost_limit: float, max_branches: int = _MAX_DISTANT_BRANCHES
) -> list[Result]:
    """Return results on the branches of the cheapest feasible ``points``, one for each distinct schedule.

    A contact event some steps earlier or later, or an additional event, gives another local minimum, which
    exchanges of neighbouring schedules often do not reach. A point must cost less than ``cost_limit``; if this
    limit is infinite, infeasible points are tried after the feasible ones, so that ``max_branches``
    branches are solved if possible.
    """
    program, solved_schedules, polished = branches.program, [], []
    for point in _usable_points(branches, points, cost_limit):
        active = branches.schedule(point.x)
        if all(are_distinct(active[program.chains], other[program.chains]) for other in solved_schedules):
            solved_schedules.append(active)
            result = branches.solve_branch(point, _DISTANT_ITERATIONS)
            polished += [] if result is None else [result]
        if len(solved_schedules) == max_branches:
            break
    return polished


def _usable_points(branches: Branches, points: Sequence[Point], cost_limit: float) -> Iterator[Point]:
    program, limits = branches.program, branches.limits
    broken: list[tuple[float, Point]] = []
    for point in points:
        f, g = program.values(point.x, branches.p)
        violation = np.maximum(limits["lbg"] - g, g - limits["ubg"]) / program.natural.g
        amount = float(violation.max(initial=0.0))
        if amount > _FEASIBLE:
            broken.append((amount, point))
        elif f < cost_limit:
            yield point
    if np.isinf(cost_limit):
        yield from (point for _, point in sorted(broken, key=lambda entry: entry[0]))


def acting(lam: np.ndarray, gap: np.ndarray, sizes: Scales) -> np.ndarray:
    """Return a mask (..., nlam, N) of impulses that exceed their gaps, (..., N, nlam) in characteristic sizes."""
    return np.swapaxes(lam / sizes.impulse > gap / sizes.gap, -1, -2)


def are_distinct(first: np.ndarray, second: np.ndarray) -> bool:
    """Return whether two schedules (contacts, N) are distinct, by their distance :func:`schedule_distance`."""
    return schedule_distance(first, second) > _MIN_SCHEDULE_DISTANCE


def schedule_distance(first: np.ndarray, second: np.ndarray) -> float:
    """Return the number of steps by which contacts differ between two schedules (contacts, N), divided by N."""
    exchanged = np.cumsum(first.astype(int) - second.astype(int), axis=1)
    return float(np.abs(exchanged).sum() / first.shape[1])


_SHIFT = 1e-9
"""Regularisation of curvature and rows, as a fraction of the largest curvature and of the largest row entries."""


class BranchModel:
    """Predicted costs of branches that differ from a solved branch in few of the given ``pairs``.

    With ``d`` in characteristic sizes, the model is ``r'd + d'Hd / 2`` subject to ``A d = 0`` of the active rows: H is
    the Hessian of the Lagrangian, and r its gradient, zero for free variables and the multipliers of held members. When
    a pair changes sides, its held member h is released, and its other member m is moved to zero:

        [K  B] [z]   [ 0]    K = [H  A'], B = columns of K for the members h, unit vectors for the members m,
        [B' C] [w] = [-s]        [A  0 ]  s = r_h for the members h, x_m for the members m, C = H of the members h,

    so that one factorisation of K serves all branches, which differ in few rows and columns of the Schur complement
    ``C - B' K^-1 B``. The cost changes by ``(r_h' d_h + x_m' v_m) / 2`` with ``w = (d_h, v_m)``. Bounds and
    inequalities with a multiplier stay active, the others are ignored.
    """

    def __init__(self, branches: Branches, result: Result, active: np.ndarray, pairs: np.ndarray) -> None:
        """Factorise the model; raises RuntimeError if its matrix is singular."""
        import scipy.sparse as sp
        import scipy.sparse.linalg as sla

        program, x, lam_g = branches.program, result.point.x, result.point.lam_g
        assert lam_g is not None
        model = LinearModel.at(program, x, branches.p, branches.limits)
        hessian = program.scaled_hessian(x, branches.p, lam_g, model.sizes)
        self.pairs, (first, second) = pairs, program.pairs
        released, zeroed = np.where(active, (second, first), (first, second))[:, pairs]
        reduced, rows, least = (
            model.reduced(lam_g),
            lam_g / model.row_scale,
            branches.min_multiplier * program.natural.f,
        )
        held = ((model.lower == 0) & (reduced > least)) | ((model.upper == 0) & (reduced < -least))
        held[np.where(active, second, first)] = True
        lower, upper = model.row_lower == 0, model.row_upper == 0
        acting = (lower & upper) | (lower & (rows < -least)) | (upper & (rows > least))
        self.unit = max(float(np.abs(hessian.data).max(initial=0.0)), 1e-300)
        H, A, free = sp.csc_matrix(hessian / self.unit), sp.csc_matrix(model.rows[acting]), np.flatnonzero(~held)
        n, m = free.size, int(acting.sum())
        top = H[free][:, free] + _SHIFT * sp.identity(n)
        K = sp.bmat([[top, A[:, free].T], [A[:, free], -_SHIFT * sp.identity(m)]], format="csc")
        unit_vectors = sp.csc_matrix(sp.identity(x.size))[:, zeroed][free]
        B = sp.bmat([[H[free][:, released], unit_vectors], [A[:, released], None]], format="csc")
        factors = sla.splu(K)
        # Column by column: SuperLU solves several columns by calls of BLAS, whose threads cost more than they save.
        self.schur = -B.T @ np.column_stack([factors.solve(column) for column in B.toarray().T])
        count = pairs.size
        self.schur[:count, :count] += H[released][:, released].toarray()
        # The other member of a pair at (0, 0) may be held already.
        is_held = np.concatenate([np.full(count, False), held[zeroed]])
        self.schur[is_held, is_held] = 1.0
        distances = np.where(held[zeroed], 0.0, (x / model.sizes)[zeroed])
        self.right = np.concatenate([reduced[released] / self.unit, distances])

    def change(self, changed: np.ndarray) -> float:
        """Return the predicted change of the cost if the ``changed`` pairs (m,) change sides; inf if there is none."""
        members = np.flatnonzero(changed[self.pairs])
        released, zeroed = members, members + self.pairs.size
        while True:
            unknowns = np.concatenate([released, zeroed])
            try:
                w = np.linalg.solve(self.schur[np.ix_(unknowns, unknowns)], -self.right[unknowns])
            except np.linalg.LinAlgError:
                return np.inf
            opening = w[: released.size] > 0
            if opening.all():
                # A branch without a point nearby has a nearly singular system, whose solution may overflow.
                with np.errstate(all="ignore"):
                    change = self.unit * float(self.right[unknowns] @ w) / 2
                return change if np.isfinite(change) else np.inf
            released = released[opening]
