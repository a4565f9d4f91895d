"""Other contact schedules: contacts a step earlier or later, and plans rolled out far from one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ocp.problem.parts import Scales
from ocp.programs.solver import Point, Result
from ocp.routes.branches import MIN_MULTIPLIER, NEIGHBOUR, Branches
from ocp.routes.homotopy import lower

_ITERATIONS = 40
"""Of one neighbour at most: those worth having are near, others often infeasible."""
_TURNS = 3
"""Times that neighbours, longer or shorter contacts are tried in turn."""
_SHORT = 2
"""Steps of a contact that may be left out at once."""
SEARCH_ITERATIONS = 800
"""Iterations after which a search ends."""
SEARCH_WORK = 540_000
"""Iterations times pairs after which the search of a large problem ends."""
_NEAREST = 1e-3
"""Characteristic sizes below which a member counts as being as near as that."""
MAX_FAILURES = 20
"""Neighbours in a row, from the most promising on, after which none is likely to cost less."""


@dataclass(frozen=True)
class ScheduleMove:
    """The ``run``-th contact of a chain of pairs begins and ends so many steps later."""

    chain: int
    run: int
    begins: int
    ends: int

    @property
    def twice(self) -> ScheduleMove:
        """The same move, twice as far."""
        return replace(self, begins=2 * self.begins, ends=2 * self.ends)


def improved(branches: Branches, neighbour: Result, max_failures: int = MAX_FAILURES) -> Result:
    """Exchange branches to first order, and schedules for neighbouring ones, in turn."""
    best = branches.improve(neighbour)
    for _ in range(_TURNS):
        neighbour = improve_schedule(branches, best, max_failures)
        if not lower(neighbour, best):
            return best
        best = branches.improve(neighbour)
        if not lower(best, neighbour):
            return best
    return best


def improve_schedule(branches: Branches, best: Result, max_failures: int = MAX_FAILURES) -> Result:
    """Exchange a schedule for a neighbour that costs less, until none does.

    On a grid of time every instant of a contact is a minimum of its own: the pairs of the steps
    beside it are far from (0, 0), so that no descent to first order leads there, however long the
    steps of a trust region. Hence single pairs change sides, and runs of active pairs are moved by
    a step, and the branch is solved again: first twice what helped the last time, then what the
    multipliers promise most of (:func:`predicted_gains`), until ``max_failures`` in a row cost no less.
    """
    program, trace = branches.program, branches.follower.trace
    iteration_limit = trace.iterations + min(SEARCH_ITERATIONS, SEARCH_WORK // max(program.pairs.shape[1], 1))
    active = program.active_sets(best.point.x)[-1]
    tried_sets, promising_move = {active.tobytes()}, None
    while True:
        fall, distances = predicted_gains(branches, best, active)
        neighbours = []
        first_moves = [promising_move] if promising_move else []
        for move in [*first_moves, *moves(active, program.chains), *np.flatnonzero(fall > 0)]:
            changed = moved(active, program.chains, move)
            if changed is None or not fall[other := changed != active].any():
                continue
            neighbours.append((move is promising_move, fall[other].sum() / distances[other].sum(), move, changed))
        neighbours.sort(key=lambda one: one[:2], reverse=True)
        failed = 0
        for _, _, move, changed in neighbours:
            if changed.tobytes() in tried_sets:
                continue
            if trace.iterations > iteration_limit or failed == max_failures:
                return best
            tried_sets.add(changed.tobytes())
            result = branches.solve(best.point, changed, _ITERATIONS, label=NEIGHBOUR)
            if result.ok and lower(result, best):
                best, active = result, changed
                promising_move = move.twice if isinstance(move, ScheduleMove) else None
                break
            failed += 1
        else:
            return best


def predicted_gains(branches: Branches, result: Result, active: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Predict the gain (m,) of each pair's change of sides, and how far it is (m,).

    The first is the fall of the cost, to first order, as the member that is held grows by its
    characteristic size, zero where that would not pay; the second the other member, which then
    falls to zero, in characteristic sizes. Where that is near, the multiplier still holds.
    """
    program, x = branches.program, result.point.x
    (first, second), sizes = program.pairs, program.sizes(x)
    held_members, free_members = np.where(active, (second, first), (first, second))
    multiplier = branches.bound_multipliers(result, active)
    fall = np.where(multiplier > MIN_MULTIPLIER, multiplier * (sizes / program.natural.x)[held_members], 0.0)
    return fall, np.maximum(x[free_members] / sizes[free_members], _NEAREST)


def moves(active: np.ndarray, chains: np.ndarray) -> Iterator[ScheduleMove]:
    """Every run a step earlier or later, at one end or at both, and a short one left out."""
    for chain, pairs in enumerate(chains):
        for run, (begin, end) in enumerate(runs(active[pairs])):
            for begins, ends in ((1, 1), (-1, -1), (0, 1), (0, -1), (1, 0), (-1, 0)):
                yield ScheduleMove(chain, run, begins, ends)
            if end - begin <= _SHORT:
                yield ScheduleMove(chain, run, end - begin, 0)


def moved(active: np.ndarray, chains: np.ndarray, move: ScheduleMove | int) -> np.ndarray | None:
    """The active set after a move, or after a pair's change of sides; None without the run."""
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
    """First index and one past the last of every unbroken run of True."""
    steps = np.diff(np.concatenate([[0], held.astype(int), [0]]))
    ends = (np.flatnonzero(steps == sign).tolist() for sign in (1, -1))
    return list(zip(*ends, strict=True))


_FAR_MOST = 8
"""Branches solved at most."""
_FAR_ITERATIONS = 128
"""Of a branch: it has a feasible point near, or often none."""
_APART = 0.125
"""Shares of the horizon by which all contacts together lie apart in schedules of two kinds."""
_FEASIBLE = 1e-6
"""Violation, in natural units, of a plan that keeps its limits."""


def distant_schedules(branches: Branches, points: Sequence[Point], below: float, most: int = _FAR_MOST) -> list[Result]:
    """Solve the branches of the cheapest feasible ``points``, one of every kind of schedule.

    An event that falls some steps earlier or later, or one more of them, makes another minimum,
    often in a valley of its own that no exchange of neighbours leads to. A point must cost less
    than ``below``; where that is infinite, points that break limits come after the others, so that
    ``most`` are solved if there are as many.
    """
    program, solved_schedules, polished = branches.program, [], []
    for point in _ordered(branches, points, below):
        active = branches.schedule(point.x)
        if all(is_apart(active[program.chains], other[program.chains]) for other in solved_schedules):
            solved_schedules.append(active)
            result = branches.solve_branch(point, _FAR_ITERATIONS)
            polished += [] if result is None else [result]
        if len(solved_schedules) == most:
            break
    return polished


def _ordered(branches: Branches, points: Sequence[Point], below: float) -> Iterator[Point]:
    program, limits = branches.program, branches.limits
    broken: list[tuple[float, Point]] = []
    for point in points:
        f, g = program.values(point.x, branches.p)
        violation = np.maximum(limits["lbg"] - g, g - limits["ubg"]) / program.natural.g
        amount = float(violation.max(initial=0.0))
        if amount > _FEASIBLE:
            broken.append((amount, point))
        elif f < below:
            yield point
    if np.isinf(below):
        yield from (point for _, point in sorted(broken, key=lambda one: one[0]))


def acting(lam: np.ndarray, gap: np.ndarray, sizes: Scales) -> np.ndarray:
    """Return which contacts act, (..., nlam, N), of impulses and gaps (..., N, nlam)."""
    return np.swapaxes(lam / sizes.impulse > gap / sizes.gap, -1, -2)


def is_apart(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether schedules (contacts, N) are of two kinds (:func:`apart`)."""
    return apart(one, other) > _APART


def apart(one: np.ndarray, other: np.ndarray) -> float:
    """Steps by which contacts are moved from one schedule to another, over those of the horizon."""
    exchanged = np.cumsum(one.astype(int) - other.astype(int), axis=1)
    return float(np.abs(exchanged).sum() / one.shape[1])
