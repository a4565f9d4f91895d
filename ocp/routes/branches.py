"""Polish to exact complementarity: solve a branch of the problem, then move to better branches.

A branch is the program that is left when one member of every pair is held at zero. Every branch's
answer is feasible for the exact problem.
"""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np

from ocp.judge.certificate import RADII, tolerance_of
from ocp.judge.lpec import LinearModel
from ocp.programs.program import PENALTY, Program
from ocp.programs.solver import Point, Result
from ocp.routes.homotopy import IPOPT_WARM_START, Homotopy, RouteResult, lower, translate

NEIGHBOUR = "neighbour"
"""Label of a stage that tries a neighbouring contact schedule."""
LONGEST = 300
"""Iterations after which a branch is given up."""
SECOND_GUESS_FACTOR = 2
"""Iteration limit of a second guess of the active set, as a multiple of the first's."""
MIN_SECOND_GUESS = 64
"""Least iteration limit of a second guess of the active set."""
MAX_SIDE_CHANGES = 8
"""Rounds in which pairs at (0, 0) change sides, while each branch costs less than the one before."""
MAX_EXCHANGES = 12
"""Exchanges of a branch for a neighbour with descent."""
DEGENERATE_SIZE = 1e-6
"""Size of both members of a pair, in natural units, below which it is at (0, 0)."""
MIN_MULTIPLIER = 1e-6
"""Multiplier of a held member, in natural units, above which its growth lowers the cost."""
FIRST_RADIUS = 0.1
"""Trust region of the first exchange, in characteristic sizes."""
GUESS_RADII = (1e-3, 1e-2, 1e-1, 1.0)
"""Trust regions in which the linear program guesses an active set, in characteristic sizes."""
_EFFORT = 750_000
"""Binaries times entries of the rows up to which a program over branches is solved: larger ones
take HiGHS many seconds before its first node, and a smaller trust region has fewer binaries."""


class Branches:
    """The branches of a program as reformulation "none", at the values of a follower's session."""

    def __init__(self, follower: Homotopy) -> None:
        self.follower = follower
        self.program = follower.nlp_of("none")
        self.p = self.program.parameter_vector({**follower.values, PENALTY: 0.0})
        self.limits = self.program.bounds(follower.values)
        self.solved: dict[bytes, Result] = {}

    def schedule(self, x: np.ndarray) -> np.ndarray:
        """Pairs (m,) whose second member is held at zero on the branch on which x lies."""
        return self.program.active_sets(x)[-1]

    def solve(
        self, start: Point, active: np.ndarray, most: int = LONGEST, mu_init: float = 1e-6, label: str = "active set"
    ) -> Result:
        """Hold ``H = 0`` where ``active`` and ``G = 0`` elsewhere, and solve what remains.

        It is given up after ``most`` iterations; ``label`` is what the stage is called.
        """
        first, second = self.program.pairs
        bounds = {key: value.copy() for key, value in self.limits.items()}
        bounds["ubx"][second[active]] = 0.0
        bounds["ubx"][first[~active]] = 0.0
        options: dict[str, Any] = {}
        if self.follower.solver.name == "ipopt":
            warm = IPOPT_WARM_START if start.lam_g is not None else {}
            options = {**warm, "mu_init": mu_init, "max_iter": most}
        inside = Point(np.clip(start.x, bounds["lbx"], bounds["ubx"]), start.lam_x, start.lam_g)
        result = self.follower.solver.run(self.program, inside, self.p, bounds, **options)
        return self.follower.record(label, float(active.sum()), self.program, result, self.p, bounds)

    def solve_branch(self, start: Point, iteration_limit: int = LONGEST) -> Result | None:
        """Solve the branch on which a point lies, and go on to neighbours while these cost less.

        A pair near (0, 0) is put where it is larger in characteristic sizes; if its multiplier then
        asks for the other side, it is moved there and the program solved again. Of several guesses
        of the active set the cheapest answer counts; None where no branch was solved.

        The last guess is tried first. Once one has an answer the others are given up after twice
        the iterations of its longest branch: one without a feasible point near never ends.
        """
        results: list[Result] = []
        for active in reversed(self.program.active_sets(start.x)):
            n_records = len(self.follower.trace.records)
            result = self.follow(start, active, iteration_limit)
            if result is not None:
                results.insert(0, result)
                longest = max((r.iterations for r in self.follower.trace.records[n_records:]), default=0)
                iteration_limit = min(iteration_limit, second_limit(longest))
        return min(results, key=lambda result: result.f, default=None)

    def follow(self, start: Point, active: np.ndarray, most: int) -> Result | None:
        """Solve a branch, and its neighbours at pairs that are (0, 0) while these cost less."""
        best, point, cost_unit = None, start, self.program.natural.f
        for _ in range(MAX_SIDE_CHANGES):
            result = self.solved.get(active.tobytes()) or self.solve(point, active, most)
            if not result.ok or (best is not None and result.f > best.f - 1e-9 * (cost_unit + abs(best.f))):
                break
            self.solved[active.tobytes()] = result
            best, point = result, result.point
            changing = self._other_side(result, active)
            if not changing.any():
                break
            active = active ^ changing
        return best

    def propose(self, start: Point) -> Result | None:
        """Solve the branches that linear programs with complementarity constraints propose.

        Pairs of a relaxed point that are farther from (0, 0) than a radius are put on their side;
        of the rest the program chooses, among the branches that are feasible to first order within
        the radius, one that costs least. The radius grows tenfold until a branch is solved
        (Nurkanovic and Leyffer, arXiv 2501.13835, phase 1). None where none is.
        """
        for radius in GUESS_RADII if self.program.pairs.size else ():
            result = self._proposed(start.x, radius)
            if result is not None:
                return result
        return None

    def _proposed(self, x: np.ndarray, radius: float) -> Result | None:
        pairs = self.program.pairs
        active = self.program.active_sets(x)[-1]
        held_members = np.where(active, pairs[1], pairs[0])
        members = x[pairs] / self.program.sizes(x)[pairs]
        base = np.clip(x, self.limits["lbx"], self.limits["ubx"])
        base[held_members[~np.all(members < radius, axis=0)]] = 0.0
        model = LinearModel.at(self.program, base, self.p, self.limits, residuals=True)
        if not model.finite or not 0 < model.effort(radius) <= _EFFORT:
            return None
        step = model.descend(radius, True, -np.inf)
        if not step.step.any():
            return None
        active[step.near] = step.active > 0.5
        result = self.solve(Point(base + radius * model.sizes * step.step), active)
        return result if result.ok else None

    def improve(self, start: Result) -> Result:
        """Exchange active sets as the linear program with complementarity constraints proposes.

        The program looks for descent within a trust region that starts a tenth of the
        characteristic sizes wide; the branch that it proposes is solved from the point it leads to,
        and kept where that costs less, else the region shrinks tenfold. The end is B-stationary
        where no descent is left at the certificate's smallest radius (Nurkanovic and Leyffer,
        arXiv 2501.13835, phase 2).
        """
        best, radius = start, FIRST_RADIUS
        start_time, seconds_before = time.perf_counter(), self.follower.trace.seconds
        for _ in range(MAX_EXCHANGES):
            if radius < RADII[-1] or not self.program.pairs.size:
                break
            model = LinearModel.at(self.program, best.point.x, self.p, self.limits)
            if self._no_descent_left(model, best, radius):
                radius /= 10
                continue
            neighbour = self._exchanged(model, best, radius)
            if neighbour is not None and lower(neighbour, best):
                best, self.follower.trace.refused = neighbour, ""
            else:
                radius /= 10
        self.follower.trace.seconds = seconds_before + time.perf_counter() - start_time
        return best

    def _no_descent_left(self, model: LinearModel, best: Result, radius: float) -> bool:
        """Whether the multipliers alone exclude descent, by weak duality."""
        multipliers = best.point.lam_g
        if multipliers is None:
            return False
        return model.dual_bound(multipliers, radius) <= tolerance_of(model)

    def _exchanged(self, model: LinearModel, best: Result, radius: float) -> Result | None:
        """Solve the branch that a direction of descent leads to; None without one."""
        if not 0 < model.effort(radius) <= _EFFORT:
            return None
        cut = tolerance_of(model)
        direction = model.descend(radius, True, cut, first=True)
        if not direction.decrease > cut:
            return None
        active = self.program.active_sets(best.point.x)[-1]
        active[direction.near] = direction.active > 0.5
        trial_point = best.point.x + radius * model.sizes * direction.step
        result = self.solve(Point(trial_point, best.point.lam_x, best.point.lam_g), active)
        outcome = f"{result.word} after {result.iterations} iterations"
        cost = result.f + self.program.constant(self.p)
        self.follower.trace.refused = (
            f"the branch with these contacts costs {cost:.6g}"
            if result.ok
            else f"the solver did not converge on the branch with these contacts ({outcome})"
        )
        return result if result.ok else None

    def bound_multipliers(self, result: Result, active: np.ndarray) -> np.ndarray:
        """Multiplier (m,) of each pair's held member: the fall of the cost per unit that it grows.

        In natural units."""
        (first, second), units = self.program.pairs, self.program.natural
        if result.point.lam_x is None:
            return np.zeros(active.size)
        lam_x = result.point.lam_x * units.x / units.f
        return np.where(active, lam_x[second], lam_x[first])

    def _other_side(self, result: Result, active: np.ndarray) -> np.ndarray:
        """Pairs at (0, 0) whose held member would lower the cost by growing."""
        x = result.point.x / self.program.natural.x
        degenerate = np.all(x[self.program.pairs] < DEGENERATE_SIZE, axis=0)
        return degenerate & (self.bound_multipliers(result, active) > MIN_MULTIPLIER)


def second_limit(took: int) -> int:
    """Iteration limit of a second attempt; a power of two, since each limit needs a new solver."""
    return max(MIN_SECOND_GUESS, 2 ** math.ceil(math.log2(SECOND_GUESS_FACTOR * max(took, 1))))


def polish(follower: Homotopy, source: Program, result: Result, improving: bool = True) -> RouteResult:
    """Solve the branch on which a relaxation's result lies and, if ``improving``, improve it.

    The input is returned, unfinished, where no branch could be solved.
    """
    branches = Branches(follower)
    branch_point = translate(result.point, source, branches.program)
    answer = branches.solve_branch(branch_point)
    if answer is None and result.ok:
        answer = branches.propose(branch_point)
    if answer is None:
        return RouteResult(result, source, False, follower.trace)
    answer = branches.improve(answer) if improving else answer
    return RouteResult(answer, branches.program, True, follower.trace)
