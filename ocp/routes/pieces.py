"""Branches of a program with kinks: the side of every kink near a plan is fixed, and changed where this costs less."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ocp.judge.lpec import LinearModel
from ocp.programs.program import NEAR_KINK, ON_KINK, PENALTY, Program
from ocp.programs.solver import Point, Result
from ocp.routes.branches import ACTIVE_SET, MAX_BRANCH_ITERATIONS, Branches
from ocp.routes.homotopy import Homotopy, RouteResult, lower, translate

if TYPE_CHECKING:
    from ocp.transcription.pieces import PiecewiseNLP

MAX_PIECES = 20
"""Maximum number of pieces solved for one branch, while each costs less than the last."""


class PieceBranches(Branches):
    """Solver of branches like :class:`~ocp.routes.branches.Branches`, on one smooth piece of the program at a time.

    A plan starts on its own piece. Where it ends on a kink, and the multiplier of the kink's constraint says that the
    cost is lower beyond, the next piece is solved. If this costs no less, the plan is a minimum on both sides.
    """

    program: PiecewiseNLP

    def __init__(self, follower: Homotopy) -> None:
        super().__init__(follower, "pieces")
        self._solved_pieces: list[tuple[Result, PiecewiseNLP]] = []

    def solve(
        self,
        start: Point,
        active: np.ndarray,
        max_iterations: int = MAX_BRANCH_ITERATIONS,
        mu_init: float = 1e-6,
        label: str = ACTIVE_SET,
    ) -> Result:
        """Return the cheapest result of pieces of a branch, or the first result if that is not solved."""
        values = {**self.follower.values, PENALTY: 0.0}
        self._fix(self.program.with_sides(self.program.near_sides(start.x, values)))
        if start.lam_g is not None and start.lam_g.size != self.program.m:
            start = translate(start, self.follower.nlp_of("none"), self.program)
        best = super().solve(start, active, max_iterations, mu_init, label)
        piece = self.program
        for _ in range(MAX_PIECES - 1):
            pressed = piece.pressed(best)
            if not (best.ok and pressed.any()):
                break
            self._fix(piece.with_sides(np.where(pressed, -piece.sides, piece.sides)))
            result = super().solve(best.point, active, max_iterations, mu_init, label)
            if not (result.ok and lower(result, best)):
                break
            best, piece = result, self.program
        self._fix(piece)
        self._solved_pieces.append((best, piece))
        return best

    def linear_model(self, result: Result) -> LinearModel:
        """Return the linear model at a result, on the piece on which it was solved."""
        self._fix(next((piece for solved, piece in self._solved_pieces if solved is result), self.program))
        return super().linear_model(result)

    def result_of_problem(self, result: Result) -> RouteResult:
        """Return a result as an outcome in the program without sides."""
        program = self.follower.nlp_of("none")
        p = program.parameter_vector({**self.follower.values, PENALTY: 0.0})
        point = translate(result.point, self.program, program)
        cost, g = program.values(point.x, p)
        smooth = replace(result, point=point, f=cost, g=g)
        return RouteResult(smooth, program, True, self.follower.trace)

    def _fix(self, piece: PiecewiseNLP) -> None:
        self.program = piece
        values = {**self.follower.values, PENALTY: 0.0}
        self.p, self.limits = piece.parameter_vector(values), piece.bounds(values)


def on_piece(branches: Branches, result: Result) -> tuple[Branches, Result]:
    """Return the solver of pieces, and the result on its piece, if a result lies on a kink; else the arguments."""
    values = branches.follower.values
    if not branches.program.is_near_kink(result.point.x, values, ON_KINK) or branches.is_stationary(result):
        return branches, result
    pieces = PieceBranches(branches.follower)
    solved = pieces.solve(result.point, branches.schedule(result.point.x))
    return (pieces, solved) if solved.ok and not lower(result, solved) else (branches, result)


class NearbySolvers:
    """Solvers of the branch nearest to a point: of the whole program, and of its smooth pieces near a kink.

    Where a piece was solved before, pieces are solved first.
    """

    def __init__(self, follower: Homotopy) -> None:
        self.follower, self.branches = follower, Branches(follower)

    @cached_property
    def pieces(self) -> PieceBranches:
        """Solver of pieces, built at its first use."""
        return PieceBranches(self.follower)

    def solve(self, start: Point, max_iterations: int = MAX_BRANCH_ITERATIONS) -> tuple[Branches, Result | None]:
        """Return the solver that converged near a point, and its result; or the first solver, and None."""
        if not self.branches.program.is_near_kink(start.x, self.follower.values, NEAR_KINK):
            return self.branches, self.branches.solve_branch(start, max_iterations)
        solvers = [self.branches, self.pieces]
        for solver in reversed(solvers) if self.follower.prefers_pieces else solvers:
            result = solver.solve_branch(start, max_iterations)
            if result is not None:
                self.follower.prefers_pieces = solver is self.pieces
                return solver, result
        return self.branches, None


def polish(follower: Homotopy, source: Program, result: Result, improving: bool = True) -> RouteResult:
    """Solve the branch nearest to a relaxation's result and, if ``improving``, exchange it for better ones.

    If no branch and no piece of it could be solved, the given result is returned with ``finished`` False.
    """
    start = translate(result.point, source, follower.nlp_of("none"))
    branches, branch_result = NearbySolvers(follower).solve(start)
    if branch_result is None and result.ok:
        branch_result = branches.propose(start)
    if branch_result is None:
        return RouteResult(result, source, False, follower.trace)
    branch_result = branches.improve(branch_result) if improving else branch_result
    return branches.result_of_problem(branch_result)
