"""A solve that Ctrl-C ended: the best point that it had come to, judged as any other."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from ocp.errors import interruptible
from ocp.judgement.judging import judged
from ocp.programs.program import Program
from ocp.programs.solver import Point, Result
from ocp.programs.status import Status
from ocp.routes.homotopy import Progress, Trace, translate
from ocp.routes.outcome import Outcome
from ocp.session import Session
from ocp.solution import Interrupted, Solution, StageRecord

_LOG = logging.getLogger(__name__)
FEASIBLE = 1e-6
"""Violation of a constraint, in natural units, up to which a point keeps it."""


@contextmanager
def keeping(session: Session, seed: int, progress: Progress | None) -> Iterator[Progress]:
    """Give what a solve of the session is to tell its stages to.

    Where Ctrl-C ends the solve inside, raises :class:`~ocp.solution.Interrupted` with the best
    point of it, judged, its status :attr:`~ocp.programs.status.Status.INTERRUPTED`; before a solver
    has run at all, there is none, and KeyboardInterrupt is raised as it came.
    """
    kept = _Kept(session, progress)
    session.solver.heard = kept.ended
    try:
        with interruptible():
            yield kept.told
    except KeyboardInterrupt as stop:
        session.solver.heard = None
        if not kept.ends:
            raise
        raise Interrupted(kept.solution(seed)) from stop
    finally:
        session.solver.heard = None


@dataclass
class _Kept:
    """Stages of a solve, and where each run of the solver ended, in whatever program."""

    session: Session
    progress: Progress | None
    records: list[StageRecord] = field(default_factory=list)
    ends: list[tuple[Program, Result]] = field(default_factory=list)

    def told(self, stage: StageRecord) -> None:
        """Hear of a stage, and pass it on."""
        self.records.append(stage)
        if self.progress is not None:
            self.progress(stage)

    def ended(self, program: Program, result: Result) -> None:
        """Hear where a run of the solver ended."""
        self.ends.append((program, result))

    def solution(self, seed: int) -> Solution:
        """The best point as a judged solution, with all work counted."""
        nlp = self.session.nlp_of("product")
        results = [result for _, result in self.ends]
        trace = Trace(
            records=self.records,
            iterations=sum(result.iterations for result in results),
            seconds=sum(result.seconds for result in results),
            evaluation_s=sum(result.evaluation_s for result in results),
        )
        p = nlp.parameter_vector(self.session.values)
        point = self._best(nlp, p)
        _LOG.info("interrupted after %d stages; the best point is judged", len(self.records))
        found = Result.at(nlp, point, p, Status.INTERRUPTED, "interrupted")
        return judged(self.session, Outcome(found, nlp, False, trace), seed)

    def _best(self, nlp: Program, p: np.ndarray) -> Point:
        """The cheapest point that keeps the constraints of what was asked, or that keeps most."""
        bounds, natural = nlp.bounds(self.session.values), nlp.natural
        found = []
        for program, result in self.ends:
            point = translate(result.point, program, nlp)
            cost, g = nlp.values(point.x, p)
            off = max(
                _beyond(g, bounds["lbg"], bounds["ubg"], natural.g),
                _beyond(point.x, bounds["lbx"], bounds["ubx"], natural.x),
            )
            found.append((off, cost if np.isfinite(cost) else np.inf, point))
        kept = [one for one in found if one[0] <= FEASIBLE]
        by_cost = min(kept, key=lambda one: one[1], default=None)
        return (by_cost or min(found, key=lambda one: one[0]))[2]


def _beyond(value: np.ndarray, low: np.ndarray, high: np.ndarray, size: np.ndarray) -> float:
    """Most that a value is out of its bounds, in natural units; infinite for no number."""
    off = np.maximum(np.maximum(low - value, value - high), 0.0) / size
    return float(np.nan_to_num(off, nan=np.inf, posinf=np.inf).max(initial=0.0))
