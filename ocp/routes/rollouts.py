"""Rollouts under the exact law: starts on branches, and polish of a smoothed plan in shooting."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np

from dynamics.contact import Step
from ocp.errors import NotConverged
from ocp.problem.evaluation import Evaluation
from ocp.problem.problem import Problem
from ocp.problem.rollout import Gains, InitialGuess, Rollout, initial_guesses, roll_on, roll_out
from ocp.programs.program import Program
from ocp.programs.solver import Point, Result, Status
from ocp.routes.branches import Branches
from ocp.routes.homotopy import Homotopy, HomotopyPath, RouteResult, lower
from ocp.routes.pieces import polish
from ocp.routes.schedules import acting, are_distinct, improve
from ocp.transcription.nlp import NLP

_NOISE_SIZES = 0.03, 3.0
"""Minimum and maximum size of the noise, in characteristic units."""
_NEIGHBOURHOOD_RADII = 2.0, 0.7, 0.25
"""Radii of the neighbourhoods in which further plans are drawn, in distances between covering plans."""


@dataclass(frozen=True)
class RolloutStarts:
    """Generator of starting points of a program: rollouts of inputs from the initial state of a ``guess``."""

    evaluation: Evaluation
    step: Step
    guess: InitialGuess

    @property
    def problem(self) -> Problem:
        """The problem whose inputs are rolled out."""
        return self.evaluation.problem

    def around(self, program: Program, plan_points: Sequence[Point], count: int) -> list[Point]:
        """Return rollouts of plans around the guess and ``plan_points``, the cheapest first, one for each schedule.

        There are ``count`` plans around each: the plan itself, and plans with a constant and two cosines of up to one
        period over the horizon added to every input, since independent noise at each step averages out. The size of
        these terms is log-uniform from 0.03 to 3 characteristic units, seed 0; inputs are clipped to their bounds.
        Inputs that do not act are unchanged, since their cost would hide the cost of the motion.

        At quick effort these rollouts improve one of 83 drawn problems (``tests/benchmarks/ocp/random_draws.py``, seeds
        77003 and 41507): a cart between walls costs 650 instead of 6413. At normal effort samples find its plan too.
        """
        sizes, N = self.problem.scales, self.problem.N
        rng, (log_smallest, log_largest) = np.random.default_rng(0), np.log(_NOISE_SIZES)
        waves = np.cos(np.pi * np.outer(np.arange(3), (np.arange(N) + 0.5) / N))
        plans = []
        for u in (self.guess[1], *(program.variables.unpack(point.x)["u"][0] for point in plan_points)):
            size = np.exp(rng.uniform(log_smallest, log_largest, (count, 1, 1)))
            size[0] = 0.0
            noise = size * (rng.standard_normal((count, sizes.u.size, 3)) @ waves) * self.acting_inputs.T
            plans += [*(u + sizes.u * noise.transpose(0, 2, 1))]
        return self._points(program, self._cheapest(np.array(plans)))

    def sample_range(self, program: Program, count: int, centres: int, n_neighbours: int) -> list[Point]:
        """Return rollouts whose acting inputs cover their range, the cheapest first, one for each schedule.

        First ``count`` plans over the range are rolled out, then ``n_neighbours`` plans around each of the
        ``centres`` cheapest plans of distinct schedules. The second part is repeated three times with
        shrinking radii, since a valley of the cost may be narrower than the distance between two plans. Without a
        bound the range ends three characteristic units from the guess.
        """
        u, half_range = self.guess[1], _NOISE_SIZES[1] * self.problem.scales.u
        lower, upper = self._bounds
        lowest_inputs = np.where(np.isfinite(lower), lower, u - half_range)
        highest_inputs = np.where(np.isfinite(upper), upper, u + half_range)
        width = np.where(self.acting_inputs, highest_inputs - lowest_inputs, 0.0)
        rng, inputs = np.random.default_rng(0), self.acting_inputs.sum()
        spread = np.zeros((count, *u.shape))
        spread[:, self.acting_inputs] = _sequence(count, inputs) - 0.5
        cheapest = self._cheapest(
            np.where(self.acting_inputs, (lowest_inputs + highest_inputs) / 2, u) + width * spread
        )
        for size in _NEIGHBOURHOOD_RADII:
            chosen = self._distinct_schedules(cheapest, centres)
            noise = rng.uniform(-1, 1, (len(chosen), n_neighbours, *u.shape))
            neighbours = cheapest.u[chosen, None] + size * count ** (-1 / inputs) * width * noise
            cheapest = self._cheapest(np.vstack([cheapest.u, neighbours.reshape(-1, *u.shape)]))
        return self._points(program, cheapest)

    def _cheapest(self, plans: np.ndarray) -> Rollout:
        """Return the rollouts of ``plans`` (S, N, nu), the cheapest of each schedule, in order of cost."""
        best = dict[bytes, int]()
        rolled = self._roll_out(np.clip(plans, *self._bounds))
        active = self._active(rolled)
        for s in np.argsort(rolled.costs, kind="stable"):
            if np.isfinite(rolled.costs[s]):
                best.setdefault(active[s].tobytes(), s)
        return rolled[np.array([*best.values()], dtype=int)]

    def _active(self, rolled: Rollout) -> np.ndarray:
        sizes = self.problem.scales
        return acting(rolled.lam, rolled.gap, sizes)

    def _distinct_schedules(self, rolled: Rollout, limit: int) -> list[int]:
        """Return the indices of the first rollout of each distinct schedule, at most ``limit``."""
        active, chosen = self._active(rolled), list[int]()
        for s, schedule in enumerate(active):
            if len(chosen) < limit and all(are_distinct(schedule, active[k]) for k in chosen):
                chosen.append(s)
        return chosen

    @staticmethod
    def _points(program: Program, plans: Rollout) -> list[Point]:
        single_plans = (plans[[s]] for s in range(len(plans.x)))
        return [Point(pack_rollout(program, plan, None)) for plan in single_plans]

    @property
    def _bounds(self) -> tuple[np.ndarray, np.ndarray]:
        return self.evaluation.limits[2:4]

    def perturbed(self, program: Program, count: int) -> list[Point]:
        """Return finite rollouts of the guessed inputs and of perturbed inputs, at most ``count`` in total."""
        plans = initial_guesses(self.evaluation, count, 0, self.guess)
        rolled = self._roll_out(np.array([u for _, u in plans]))
        solved = np.flatnonzero(np.all(np.isfinite(rolled.x), axis=(1, 2)))
        return self._points(program, rolled[solved])

    @cached_property
    def acting_inputs(self) -> np.ndarray:
        """Mask (N, nu): whether the step's equations depend on each input at the states of the guess.

        Inputs and multipliers are random (seed 0), since at guessed values a derivative may be zero by chance.
        """
        system, (x, u) = self.problem.system, self.guess
        equations = ca.vertcat(system.residual, system.gap)
        slope = ca.sum1(ca.fabs(ca.jacobian(equations, system.u)))
        slopes = ca.Function("slopes", self.problem.step_symbols, [slope])
        rng, scales = np.random.default_rng(0), self.problem.scales
        sampled_inputs = u + scales.u * rng.standard_normal(u.shape)
        lam = scales.impulse * rng.random((len(u), system.nlam))
        sampled_slopes = slopes.map(len(u))(x[:-1].T, sampled_inputs.T, x[1:].T, lam.T, self.evaluation.p)
        return np.array(ca.densify(sampled_slopes)).reshape(len(u), -1, order="C") > 0

    def _roll_out(self, plans: np.ndarray) -> Rollout:
        starts = np.broadcast_to(self.guess[0][0], (len(plans), self.problem.system.nx))
        return roll_on(self.evaluation, plans, self.step, starts)[0]


def _sequence(count: int, dimension: int) -> np.ndarray:
    """Return points (count, dimension) of an additive recurrence that fills the unit cube evenly.

    Its steps are powers of 1/phi, where phi solves ``phi^(dimension + 1) = phi + 1``.
    """
    phi = 1.5
    for _ in range(60):
        phi = (phi + 1.0) ** (1.0 / (dimension + 1))
    return np.outer(np.arange(1, count + 1), phi ** -np.arange(1.0, dimension + 1)) % 1.0


def pack_rollout(nlp: Program, plan: Rollout, gains: Gains | None) -> np.ndarray:
    """Return the variables (n,) of a program for trajectories x (S, N+1, nx), u, lam, gap (S, N, .) and gains."""
    blocks = {
        "x0": plan.x[:, :1],
        "x": plan.x[:, 1:],
        "u": plan.u,
        "lam": np.maximum(plan.lam, 0.0),
        "gap": np.maximum(plan.gap, 0.0),
    }
    if gains is not None:
        blocks |= {"K": gains.K, "k": gains.k}
    # A block that all scenarios share has one row.
    return nlp.variables.pack(
        {name: blocks[name][: block.shape[0]] for name, block in nlp.variables.blocks.items() if name in blocks}
    )


@dataclass(frozen=True)
class RolloutPolish:
    """Polisher of plans: it rolls them out in ``target`` and solves their branches in ``direct``.

    A smoothed optimum differs from the exact optimum by the order of the square root of the last mu. The
    rollout is therefore converted to a point of ``direct``, its contacts are fixed, and ``follower`` solves for
    the other variables (:func:`~ocp.routes.branches.polish`).
    """

    target: NLP
    direct: NLP
    step: Step
    follower: Homotopy

    def polish(self, source: NLP, plan: Result) -> tuple[Result, Result | None]:
        """Return the rollout of a plan of ``source`` under the exact ``step``, and the result on its branch.

        The rollout uses the inputs of the branch result if they cost no more than those of the plan; otherwise it
        uses the plan's inputs, and the branch result is None. Contacts of the branch result are exactly
        open or closed, those of a rollout only to the step solver's tolerance. A plan that was solved in
        ``direct`` is already on a branch.
        """
        rolled_out, direct_point = self._rolled_out(source, plan.point.x)
        if source is self.direct and plan.ok:
            return rolled_out, plan
        branch_start = replace(rolled_out, point=direct_point)
        branch = polish(self.follower, self.direct, branch_start, improving=False)
        if not branch.finished:
            return rolled_out, None
        improved_rollout, _ = self._rolled_out(self.direct, branch.result.point.x)
        return (
            (improved_rollout, branch.result)
            if improved_rollout.f <= rolled_out.f + 1e-9 * abs(rolled_out.f)
            else (rolled_out, None)
        )

    def follow(self, follower: Homotopy, path: HomotopyPath, start: Point) -> RouteResult:
        """Follow a path, solve the branches of its points, and improve the cheapest branch.

        Near an early stage another branch may be cheaper than near the last stage. The path ends early if
        the branches of two successive points have the same cost.
        """
        branch_results: list[Result] = []

        def is_repeated(source: Program, result: Result) -> bool:
            assert isinstance(source, NLP)
            if not result.ok:
                return False
            try:
                solved = self.polish(source, result)[1]
            except NotConverged:
                return False
            if solved is None:
                return False
            branch_results.append(solved)
            latest, previous = branch_results[-2:] if len(branch_results) > 1 else (solved, None)
            return previous is not None and not (lower(latest, previous) or lower(previous, latest))

        followed = follower.follow(replace(path, complete=is_repeated), start)
        if not branch_results:
            return followed
        best = improve(Branches(self.follower), min(branch_results, key=lambda latest: latest.f))
        return RouteResult(best, self.direct, True, follower.trace)

    def _rolled_out(self, nlp: NLP, x: np.ndarray) -> tuple[Result, Point]:
        values = self.follower.values
        blocks = nlp.variables.unpack(x)
        gains = Gains(blocks["K"], blocks["k"]) if "K" in blocks else None
        start = blocks["x0"][:, 0] if "x0" in blocks else None
        rolled = roll_out(self.target.problem, gains or blocks["u"], values, self.step, start)
        target_point = Point(pack_rollout(self.target, rolled, gains))
        p = self.target.parameter_vector(values)
        result = Result.at(self.target, target_point, p, Status.SOLVED, "rolled out")
        return result, Point(pack_rollout(self.direct, rolled, gains))
