"""Collection of transitions of a step from random states without penetration, half of them near the task."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from dynamics.batch import BatchFunction, StepFunction
from dynamics.contact import Step
from dynamics.learned.region import Region
from dynamics.learned.transitions import Transitions

Keep = Callable[[np.ndarray], np.ndarray]
"""Filter of states: function from states (n, nx) to a mask (n,) of the states to use."""

DrawStates = Callable[[np.random.Generator, int, Sequence[str]], np.ndarray]
Rows = tuple[np.ndarray, np.ndarray, np.ndarray]

MAX_DRAWS_PER_ROW = 1000
"""Number of drawn states per requested transition above which a region is rejected."""
PIECE_ROWS = 1 << 18
"""Maximum number of states that are drawn in one batch."""
STATES_PER_DRAW = 200_000
"""Maximum number of states that are drawn at once."""


def collect_transitions(step: Step, region: Region, n: int, seed: int) -> Transitions:
    """Draw n transitions of ``step``: the first half from states in the region's ranges, the rest from its tube.

    States with penetration are rejected (:func:`nonpenetrating_filter`). A step that is not solved is replaced
    by another; ``unsolved`` in the provenance counts such steps. The same seed gives the same data for any
    number of threads and of workers.

    Raises ``ValueError`` if the region does not fit the system, if almost all of its states are rejected, and as
    :meth:`Transitions.from_arrays` does.
    """
    drawn_pieces = [draw_piece(step, region, piece) for piece in split_pieces(n, seed)]
    return merge_pieces(step, region, drawn_pieces, seed)


@dataclass(frozen=True)
class Piece:
    """Part of a data collection: how many states to draw from the region's ranges, and how many from its tube.

    ``stream`` is the part's random stream; for the ranges and the tube see
    :class:`~dynamics.learned.region.Region`.
    """

    in_ranges: int
    in_tube: int
    stream: np.random.SeedSequence


@dataclass(frozen=True)
class Drawn:
    """Transitions of one part, sampled from the ranges and from the tube, and the number of unsolved steps."""

    in_ranges: Rows
    in_tube: Rows
    unsolved: int


def split_pieces(n: int, seed: int) -> list[Piece]:
    """Split n transitions into parts with independent random streams; a single part uses the seed's own stream."""
    count = max(1, -(-n // PIECE_ROWS))
    root = np.random.SeedSequence(seed)
    streams = [root] if count == 1 else root.spawn(count)
    ends = [k * n // count for k in range(count + 1)]
    halves = [end // 2 for end in ends]
    return [
        Piece(ends[k + 1] - ends[k] - (halves[k + 1] - halves[k]), halves[k + 1] - halves[k], stream)
        for k, stream in enumerate(streams)
    ]


def draw_piece(step: Step, region: Region, piece: Piece) -> Drawn:
    """Draw the transitions of one part of a collection; raise ``ValueError`` as :func:`collect_transitions` does."""
    region.check(step.system)
    p, rng = step.p.values, np.random.default_rng(piece.stream)
    source = _Source(step, p, region, nonpenetrating_filter(step, p))
    in_ranges = source.draw_rows(rng, piece.in_ranges, region.box_states, "ranges")
    in_tube = source.draw_rows(rng, piece.in_tube, region.tube_states, "tube")
    return Drawn(in_ranges, in_tube, source.unsolved)


def merge_pieces(
    step: Step,
    region: Region,
    drawn_pieces: Sequence[Drawn],
    seed: int,
    provenance: Mapping[str, Any] | None = None,
) -> Transitions:
    """Concatenate parts in order: first the rows of all parts from the ranges, then the rows from the tube."""
    rows = [*(piece.in_ranges for piece in drawn_pieces), *(piece.in_tube for piece in drawn_pieces)]
    x, u, x_next = (np.concatenate(column) for column in zip(*rows, strict=True))
    full_provenance = {
        **{"seed": seed, "region": region.described(), "how": "collected"},
        **{"in_tube": sum(len(piece.in_tube[0]) for piece in drawn_pieces)},
        **{"unsolved": sum(piece.unsolved for piece in drawn_pieces), **(provenance or {})},
    }
    return Transitions.from_arrays(x, u, x_next, step.system.states, step.system.inputs, full_provenance)


@dataclass
class _Source:
    """Source of transitions at parameters ``p`` from states that ``keep`` accepts, with a count of unsolved steps."""

    step: Step
    p: np.ndarray
    region: Region
    keep: Keep
    unsolved: int = 0

    def __post_init__(self) -> None:
        self._advance = StepFunction(self.step)
        system = self.step.system
        self._states, self._inputs = ([signal.name for signal in signals] for signals in (system.states, system.inputs))

    def draw_rows(self, rng: np.random.Generator, n_rows: int, draw_states: DrawStates, part_name: str) -> Rows:
        """Return ``n_rows`` rows of x, u and x_next from ``draw_states``; errors name the part ``part_name``."""
        n_kept, batches = 0, [self._rows(draw_states(rng, 1, self._states)[:0], rng)]
        n_drawn = 0
        while n_kept < n_rows:
            if n_drawn > MAX_DRAWS_PER_ROW * n_rows:
                raise ValueError(
                    f"only {n_kept} of {n_drawn} states drawn in the {part_name} of the region could be"
                    " used; choose a region in which bodies do not penetrate"
                )
            share = n_kept / n_drawn if n_kept else 0.5
            size = min(int(1.1 * (n_rows - n_kept) / share) + 64, STATES_PER_DRAW)
            n_drawn += size
            batches.append(self._rows(draw_states(rng, size, self._states), rng))
            n_kept += len(batches[-1][0])
        x, u, x_next = (np.concatenate(column)[:n_rows] for column in zip(*batches, strict=True))
        return x, u, x_next

    def _rows(self, x: np.ndarray, rng: np.random.Generator) -> Rows:
        x = x[self.keep(x)]
        u = self.region.draw_inputs(rng, x, self._states, self._inputs)
        solved = self._advance(x, u, self.p)
        is_solved = np.isfinite(solved.x_next).all(axis=1) & np.isfinite(solved.lam).all(axis=1)
        self.unsolved += int(np.count_nonzero(~is_solved))
        return x[is_solved], u[is_solved], solved.x_next[is_solved]


def nonpenetrating_filter(step: Step, p: np.ndarray) -> Keep:
    """Return the filter of states whose true signed distances are all >= 0; without distances it accepts all states."""
    system = step.system
    if system.phi is None or not system.phi.numel():
        return lambda x: np.ones(len(x), dtype=bool)
    smallest_distance = ca.mmin(ca.densify(system.phi))
    distance = BatchFunction(ca.Function("least_phi", [system.x, step.p.vector], [smallest_distance]))
    return lambda x: distance(x, p)[:, 0] >= 0
