"""Contact schedules next to one: contacts that begin or end a step earlier or later, or fail to."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ocp.programs.solver import Result
from ocp.routes.branches import NEIGHBOUR, WISH, Branches
from ocp.routes.outcome import lower

_ITERATIONS = 40
"""Of one neighbour at most: those worth having are near, others often infeasible."""
_SHORT = 2
"""Steps of a contact that may be left out at once."""
_ALL = 800
"""Iterations after which a search ends."""


@dataclass(frozen=True)
class Move:
    """The ``run``-th contact of a chain of pairs begins and ends so many steps later."""

    chain: int
    run: int
    begins: int
    ends: int


def rescheduled(branches: Branches, best: Result) -> Result:
    """Exchange a schedule for a neighbour that costs less, until none does.

    On a grid of time every instant of a contact is a minimum of its own: the pairs of the steps
    beside it are far from (0, 0), so that no descent to first order leads there, however long the
    steps of a trust region. Hence runs of active pairs are moved by a step and solved again; what
    helped once is tried once more first.
    """
    program, trace = branches.program, branches.follower.trace
    until = trace.iterations + _ALL
    active = program.active_sets(best.point.x)[-1]
    tried, last = {active.tobytes()}, None
    while True:
        wish = branches.wishes(best, active)
        for move in ([last] if last else []) + list(moves(active, program.chains)):
            changed = moved(active, program.chains, move)
            if changed is None or changed.tobytes() in tried:
                continue
            if not wish[changed != active].max(initial=0.0) > WISH:
                continue
            if trace.iterations > until:
                return best
            tried.add(changed.tobytes())
            found = branches.solve(best.point, changed, _ITERATIONS, knob=NEIGHBOUR)
            if found.ok and lower(found, best):
                best, active, last = found, changed, move
                break
        else:
            return best


def moves(active: np.ndarray, chains: np.ndarray) -> Iterator[Move]:
    """Every run a step earlier or later, at one end or at both, and a short one left out."""
    for chain, pairs in enumerate(chains):
        for run, (begin, end) in enumerate(runs(active[pairs])):
            for begins, ends in ((1, 1), (-1, -1), (0, 1), (0, -1), (1, 0), (-1, 0)):
                yield Move(chain, run, begins, ends)
            if end - begin <= _SHORT:
                yield Move(chain, run, end - begin, 0)


def moved(active: np.ndarray, chains: np.ndarray, move: Move) -> np.ndarray | None:
    """The active set after a move; None where its run is not there."""
    pairs = chains[move.chain]
    there = runs(active[pairs])
    if move.run >= len(there):
        return None
    begin, end = there[move.run]
    changed = active.copy()
    changed[pairs[begin:end]] = False
    changed[pairs[max(begin + move.begins, 0) : max(end + move.ends, 0)]] = True
    return changed


def runs(held: np.ndarray) -> list[tuple[int, int]]:
    """First index and one past the last of every unbroken run of True."""
    steps = np.diff(np.concatenate([[0], held.astype(int), [0]]))
    ends = (np.flatnonzero(steps == sign).tolist() for sign in (1, -1))
    return list(zip(*ends, strict=True))
