"""Polish to exact complementarity: solve a branch of the problem, then change to better branches.

A branch is the program in which one member of every pair is held at zero. Every solution of a branch
is feasible for the exact problem.
"""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np

from ocp.judge.certificate import RADII, tolerance_of
from ocp.judge.lpec import Descent, LinearModel
from ocp.programs.options import ABANDONS
from ocp.programs.program import PENALTY
from ocp.programs.solver import Point, Result
from ocp.routes.homotopy import IPOPT_WARM_START, Homotopy, RouteResult, lower

ACTIVE_SET = "active set"
"""Label of a stage that solves a branch."""
NEIGHBOUR = "neighbour"
"""Label of a stage that tries a neighbouring contact schedule."""
MAX_BRANCH_ITERATIONS = 300
"""Iteration limit of one branch."""
SECOND_GUESS_FACTOR = 2
"""Iteration limit of a second guess of the active set, as a multiple of the iterations of the first guess."""
MIN_SECOND_GUESS = 64
"""Minimum iteration limit of a second guess of the active set."""
MAX_SIDE_CHANGES = 8
"""Maximum number of rounds in which pairs at (0, 0) change sides, while each branch costs less than the last."""
MAX_EXCHANGES = 12
"""Maximum number of exchanges of a branch for a neighbour of lower cost."""
LOW_COST = 2.0**-12
"""Typical change of the cost, in its unit, below which the solver's tolerance is too coarse for it."""
MAX_COST_FACTOR = 2.0**30
"""Maximum factor of a cost; beyond it, the rounding errors of the first cost are larger than the rest."""
DEGENERATE_SIZE = 1e-6
"""Size of both members of a pair, in natural units, below which the pair is at (0, 0)."""
MIN_MULTIPLIER = 1e-6
"""Smallest multiplier that counts, in natural units, of a cost that is as large as its unit."""
FIRST_RADIUS = 0.1
"""Trust-region radius of the first exchange, in characteristic sizes."""
GUESS_RADII = (1e-3, 1e-2, 1e-1, 1.0)
"""Trust-region radii for guesses of the active set by a linear program, in characteristic sizes."""
_EFFORT = 750_000
"""Maximum of binaries times row entries of a program over branches; in larger programs HiGHS
takes many seconds before the first node, and a smaller trust region has fewer binaries."""
_EXCHANGE_EFFORT = 150_000
"""Maximum of the same product for an exchange of branches, at which HiGHS takes as long as IPOPT on a branch."""


class Branches:
    """Solver of branches of a homotopy's program, in reformulation "none", at the homotopy's parameter values."""

    def __init__(self, follower: Homotopy, reformulation: str = "none") -> None:
        self.follower = follower
        self.program = follower.nlp_of(reformulation)
        self.p = self.program.parameter_vector({**follower.values, PENALTY: 0.0})
        self.limits = self.program.bounds(follower.values)
        self.solved: dict[bytes, Result] = {}
        self.cost_factor = 1.0

    def schedule(self, x: np.ndarray) -> np.ndarray:
        """Return a mask (m,) of the pairs whose second member is held at zero on the branch nearest to x."""
        return self.program.active_sets(x)[-1]

    def solve(
        self,
        start: Point,
        active: np.ndarray,
        max_iterations: int = MAX_BRANCH_ITERATIONS,
        mu_init: float = 1e-6,
        label: str = ACTIVE_SET,
    ) -> Result:
        """Solve the branch with ``H = 0`` for pairs in ``active`` and ``G = 0`` for the others.

        ``max_iterations`` is the iteration limit, ``label`` the name of the stage in the table. If the cost falls so
        far below its unit that the solver's tolerance is coarse, the branch is solved again with a larger cost factor.
        """
        first, second = self.program.pairs
        bounds = {key: value.copy() for key, value in self.limits.items()}
        bounds["ubx"][second[active]] = 0.0
        bounds["ubx"][first[~active]] = 0.0
        options: dict[str, Any] = {}
        if self.follower.solver.name == "ipopt":
            warm = IPOPT_WARM_START if start.lam_g is not None else {}
            options = {**warm, "mu_init": mu_init, "max_iter": max_iterations, ABANDONS: True}
            options |= {"obj_scaling_factor": self.cost_factor} if self.cost_factor > 1 else {}
        inside = Point(np.clip(start.x, bounds["lbx"], bounds["ubx"]), start.lam_x, start.lam_g)
        result = self.follower.solver.run(self.program, inside, self.p, bounds, **options)
        result = self.follower.record(label, float(active.sum()), self.program, result, self.p, bounds)
        if options and result.ok and self._raise_cost_factor(result):
            return self.solve(result.point, active, max_iterations, mu_init, label)
        return result

    def _raise_cost_factor(self, result: Result) -> bool:
        """Raise the cost's factor if its typical change is far below its unit; return whether this was so."""
        unit = self.cost_unit
        if abs(result.f) > LOW_COST * unit:
            return False
        change = self.program.typical_change(result.point.x, self.p, self.limits)
        if not 0 < change < LOW_COST * unit:
            return False
        self.cost_factor = min(2.0 ** round(math.log2(self.program.natural.f / change)), MAX_COST_FACTOR)
        return self.cost_unit < unit

    def solve_branch(self, start: Point, iteration_limit: int = MAX_BRANCH_ITERATIONS) -> Result | None:
        """Solve the branch nearest to a point, then neighbouring branches while they cost less.

        In a pair near (0, 0) the member that is smaller in characteristic sizes is held at zero; if the
        multiplier indicates that the cost decreases as this member grows, the other member is held instead
        and the program is solved again. The cheapest result of several guesses of the active set is
        returned, or None if no guess is solved.

        The last guess is tried first. Once a guess is solved, the iteration limit of the others is twice the
        iterations of its longest branch, since a branch without a feasible point nearby does not converge.
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

    def follow(self, start: Point, active: np.ndarray, max_iterations: int) -> Result | None:
        """Solve a branch; return the cheapest result of this and of branches that exchange pairs at (0, 0).

        Pairs are exchanged as long as the cost decreases. Returns None if the first branch is not solved.
        """
        best, point = None, start
        for _ in range(MAX_SIDE_CHANGES):
            result = self.solved.get(active.tobytes()) or self.solve(point, active, max_iterations)
            if not result.ok or (best is not None and result.f > best.f - 1e-9 * (self.cost_unit + abs(best.f))):
                break
            self.solved[active.tobytes()] = result
            best, point = result, result.point
            changing = self._other_side(result, active)
            if not changing.any():
                break
            active = active ^ changing
        return best

    def propose(self, start: Point) -> Result | None:
        """Return the result of a branch proposed by linear programs with complementarity constraints.

        Pairs of a relaxed point that are farther from (0, 0) than a radius keep their side; for the
        others the program chooses the cheapest branch that is feasible to first order within the radius. The
        radius grows tenfold until a branch is solved (Nurkanovic and Leyffer, arXiv 2501.13835, phase 1);
        the result is None if no branch is solved.
        """
        for radius in GUESS_RADII if self.program.pairs.size else ():
            result = self._propose_within(start.x, radius)
            if result is not None:
                return result
        return None

    def _propose_within(self, x: np.ndarray, radius: float) -> Result | None:
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
        """Return the best result of exchanging branches by linear programs with complementarity constraints.

        The program searches for descent within a trust region whose first radius is a tenth of the characteristic
        sizes. The branch that it proposes is solved from the proposed point and accepted if it costs less; otherwise
        the radius shrinks tenfold. The result is B-stationary if no descent is left at one of the certificate's radii
        (Nurkanovic and Leyffer, arXiv 2501.13835, phase 2).
        """
        best, radius = start, FIRST_RADIUS
        start_time, seconds_before = time.perf_counter(), self.follower.trace.seconds
        for _ in range(MAX_EXCHANGES):
            if radius < RADII[-1] or not self.program.pairs.size:
                break
            model = self.linear_model(best)
            if self._no_descent_left(model, best, radius):
                radius /= 10
                continue
            direction = self._direction(model, radius)
            if direction.decrease <= tolerance_of(model) and radius <= RADII[0]:
                break
            neighbour = self._exchange(model, best, radius, direction)
            if neighbour is not None and lower(neighbour, best):
                best, self.follower.trace.refused = neighbour, ""
            else:
                radius /= 10
        self.follower.trace.seconds = seconds_before + time.perf_counter() - start_time
        return best

    def linear_model(self, result: Result) -> LinearModel:
        """Return the linear model at a result."""
        return LinearModel.at(self.program, result.point.x, self.p, self.limits)

    def is_stationary(self, result: Result) -> bool:
        """Return whether multipliers prove that a result is stationary, by weak duality."""
        return self._no_descent_left(self.linear_model(result), result, RADII[0])

    def result_of_problem(self, result: Result) -> RouteResult:
        """Return a result as an outcome in the problem's own program, with the trace of the follower."""
        return RouteResult(result, self.program, True, self.follower.trace)

    def _no_descent_left(self, model: LinearModel, best: Result, radius: float) -> bool:
        """Return whether the multipliers exclude descent by weak duality, without a linear program."""
        multipliers = best.point.lam_g
        if multipliers is None:
            return False
        return model.dual_bound(multipliers, radius) <= tolerance_of(model)

    def _direction(self, model: LinearModel, radius: float) -> Descent:
        """Return a descent direction across branches; its decrease is NaN if the program is too large to solve."""
        # Within a certificate's radii, the certificate solves the same program.
        limit = _EXCHANGE_EFFORT if radius > RADII[0] else _EFFORT
        if not 0 < model.effort(radius) <= limit:
            return Descent(np.nan)
        return model.descend(radius, True, tolerance_of(model), first=True)

    def _exchange(self, model: LinearModel, best: Result, radius: float, direction: Descent) -> Result | None:
        """Return the result of the branch in a descent direction; None if there is no descent."""
        if not direction.decrease > tolerance_of(model):
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
        """Return each pair's multiplier (m,): the decrease of the cost per natural unit of its held member."""
        (first, second), units = self.program.pairs, self.program.natural
        if result.point.lam_x is None:
            return np.zeros(active.size)
        lam_x = result.point.lam_x * units.x / units.f
        return np.where(active, lam_x[second], lam_x[first])

    @property
    def cost_unit(self) -> float:
        """Unit of the cost: the program's, divided by the factor that raises a low cost."""
        return self.program.natural.f / self.cost_factor

    @property
    def min_multiplier(self) -> float:
        """Multiplier of a held member above which an increase of the member lowers the cost, in natural units."""
        return MIN_MULTIPLIER / self.cost_factor

    def _other_side(self, result: Result, active: np.ndarray) -> np.ndarray:
        """Return a mask (m,) of the pairs at (0, 0) for which an increase of the held member would lower the cost."""
        x = result.point.x / self.program.natural.x
        degenerate = np.all(x[self.program.pairs] < DEGENERATE_SIZE, axis=0)
        return degenerate & (self.bound_multipliers(result, active) > self.min_multiplier)


def second_limit(iterations: int) -> int:
    """Return the iteration limit of a second attempt, a power of two since each new limit needs a new solver."""
    return max(MIN_SECOND_GUESS, 2 ** math.ceil(math.log2(SECOND_GUESS_FACTOR * max(iterations, 1))))
