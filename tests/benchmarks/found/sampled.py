"""Plans from long sampling, independent of the program's own search: cross-entropy, knots, then every input alone."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from dynamics.batch import open_loop
from dynamics.contact import Exact
from ocp import Problem, Solution, roll_out, solve
from ocp.errors import InputError, NotConverged
from ocp.judge.referee import referee_plan
from ocp.problem.batch_rollouts import batch_rollouts
from ocp.problem.evaluation import Evaluation
from ocp.problem.rollout import Rollout
from problems import get
from tests.benchmarks.found.problems import ROOT, Plan, rounded, source_of

SAMPLES, ELITES, ROUNDS = 1000, 60, 120
KNOTS = (6, 12)
SEEDS = 2
AROUND = 4
"""Runs that move every input of the best known plan."""
KEPT = 2
"""Number of the cheapest plans that solves start from."""
BREACH = 1e4
"""Cost of a bound or constraint violated by its unit, per step."""
STRATEGIES = ("central-path", "l1")
"""Strategies tried from each plan."""


@dataclass
class LongSampling:
    """Long cross-entropy runs on the inputs of a problem under the exact law, from ``seed`` 0 on."""

    name: str

    def __post_init__(self) -> None:
        self.problem = problem_of(self.name)
        names, numbers = self.problem.parameters.names, self.problem.parameters.values
        self.values = dict(zip(names, map(float, numbers), strict=True))
        self.evaluation = Evaluation(self.problem, self.values)
        self.limits = self.evaluation.limits
        guess, size = self.evaluation.initial_guess[1].mean(axis=0), self.problem.scales.u
        width = self.limits.u_upper - self.limits.u_lower
        self.centre, self.reach = guess, np.where(np.isfinite(width), width / 3, 3 * size)
        system = replace(self.problem.system, parameters=self.problem.parameters)
        self.step = Exact().close(system)
        self.function = batch_rollouts(penalised(self.problem), self.step, open_loop(system.nx, system.nu))

    def costs(self, inputs: np.ndarray) -> np.ndarray:
        """Return the costs (S,) of inputs (S, N, nu) under the exact law, infinite if a step fails."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            rollouts = self.function(
                self.evaluation.initial_states[0],
                np.clip(inputs, self.limits.u_lower, self.limits.u_upper),
                self.step.p.pack(self.values),
                n_samples=len(inputs),
                u_before=self.limits.u_before if self.problem.uses_du else None,
                gradient=False,
            )
        return np.where(np.isfinite(rollouts.cost), rollouts.cost, np.inf)

    def narrowed(
        self, basis: np.ndarray, mean: np.ndarray, deviation: np.ndarray, generator: np.random.Generator
    ) -> tuple[float, np.ndarray]:
        """Return the cheapest sample of one run as its cost and its inputs (N, nu)."""
        best, best_cost = mean, math.inf
        for _ in range(ROUNDS):
            z = mean + deviation * generator.standard_normal((SAMPLES, *mean.shape))
            z[0], z[1] = best, mean
            costs = self.costs(basis @ z)
            order = np.argsort(costs, kind="stable")[:ELITES]
            best, best_cost = z[order[0]], float(costs[order[0]])
            mean = 0.3 * mean + 0.7 * z[order].mean(axis=0)
            deviation = 0.3 * deviation + 0.7 * z[order].std(axis=0)
        return best_cost, np.clip(basis @ best, self.limits.u_lower, self.limits.u_upper)

    def plans(self) -> list[tuple[float, np.ndarray, str]]:
        """Return cost, inputs and description of every run, improved by one that moves every input, cheapest first."""
        N, found = self.problem.N, []
        for knots in sorted({min(knots, N) for knots in KNOTS}):
            position = np.linspace(0, knots - 1, N)
            linear = np.maximum(0.0, 1.0 - np.abs(position[:, None] - np.arange(knots)))
            constant = np.eye(knots)[np.arange(N) * knots // N]
            for word, basis in (("linear", linear), ("constant", constant)):
                for seed in range(SEEDS):
                    generator = np.random.default_rng(seed)
                    shape = (knots, len(self.reach))
                    start = np.broadcast_to(self.centre, shape), np.broadcast_to(self.reach, shape)
                    cost, inputs = self.narrowed(basis, *start, generator)
                    if not math.isfinite(cost):
                        continue
                    around = np.broadcast_to(0.05 * self.reach, inputs.shape)
                    moved = self.narrowed(np.eye(N), inputs, around, generator)
                    cost, inputs = min((cost, inputs), moved, key=lambda pair: pair[0])
                    found.append((cost, inputs, f"sampled, {knots} {word} pieces, seed {seed}"))
        return sorted(found, key=lambda plan: plan[0])

    def rolled(self, inputs: np.ndarray) -> Rollout | None:
        """Return the exact rollout of inputs, None if a step is not solved or the referee rejects the rollout.

        Samples are penalised by constraints in states and inputs alone; the referee also checks those in impulses and
        next states, and penetration between nodes.
        """
        try:
            rollout = roll_out(self.problem, inputs, self.values)
        except NotConverged:
            return None
        return rollout if referee_plan(self.evaluation, self.step, rollout, None)[0].survives_at_h else None

    def best_plans(self) -> Iterator[Plan]:
        """Yield sampled plans, and the exact replays of solves that start at the cheapest of them."""
        command = f"python -m tests.benchmarks.found --reference {self.name}: "
        sampled = self.plans()
        for _, inputs, words in sampled:
            if (rollout := self.rolled(inputs)) is not None:
                yield Plan(rollout.cost, command + words, rounded(inputs))
        for _, inputs, words in sampled[:KEPT]:
            if (rollout := self.rolled(inputs)) is None:
                continue
            for strategy in STRATEGIES:
                solution = self._solved(rollout, strategy)
                if solution is None:
                    continue
                solved = solution.data["u"].values[0]
                if (replay := self.rolled(solved)) is not None:
                    yield Plan(replay.cost, f"{command}{words}, then {strategy} from there", rounded(solved))

    def around(self, plan: Plan) -> Iterator[Plan]:
        """Yield plans from moving every input of the best plan so far alone, again and again."""
        inputs, cost = np.array(plan.inputs), plan.cost
        words = "every input moved around the plan before"
        for seed in range(AROUND):
            deviation = np.broadcast_to(0.05 * self.reach, inputs.shape)
            _, moved = self.narrowed(np.eye(len(inputs)), inputs, deviation, np.random.default_rng(seed))
            rollout = self.rolled(moved)
            if rollout is not None and rollout.cost < cost:
                inputs, cost = moved, rollout.cost
                yield Plan(cost, f"python -m tests.benchmarks.found --reference {self.name}: {words}", rounded(inputs))

    def near(self, plan: Plan) -> Iterator[Plan]:
        """Yield the replay of a solution near the best plan so far, on its branch or a smooth piece of it."""
        rollout = self.rolled(np.array(plan.inputs))
        if rollout is None:
            return
        solution = solve(self.problem, "exact", guess=(rollout.x[0], rollout.u[0]), effort="quick", search=False)
        replay = self.rolled(solution.data["u"].values[0])
        if replay is not None:
            command = f"python -m tests.benchmarks.found --reference {self.name}: solved near the plan before"
            yield Plan(replay.cost, command, rounded(replay.u[0]))

    def _solved(self, rollout: Rollout, strategy: str) -> Solution | None:
        """Return the solution of a strategy from a rollout, None if it fails."""
        try:
            guess = rollout.x[0], rollout.u[0]
            return solve(self.problem, "exact", settings={"strategy": strategy}, guess=guess, search=False)
        except (InputError, NotConverged):
            return None


def problem_of(name: str) -> Problem:
    """Return a stranger or a named problem at its own parameters."""
    source = source_of(name)
    return get(str(ROOT / source) if source.endswith(".py") else source)


def can_sample(name: str) -> bool:
    """Return whether inputs alone determine a plan, from one given start."""
    problem = problem_of(name)
    return problem.start is None and problem.scenarios.n == 1


def penalised(problem: Problem) -> Problem:
    """Return the problem with bounds of states, and constraints in states and inputs, as costs."""
    system = problem.system
    known = set(map(str, ca.symvar(ca.vertcat(system.x, system.u, problem.parameters.vector))))
    bounds = (system.x, problem.x_lower, problem.x_upper)
    path = [(c.expression, c.lower, c.upper) for c in problem.path]
    path = [row for row in path if set(map(str, ca.symvar(row[0]))) <= known]
    terminal = [(c.expression, c.lower, c.upper) for c in problem.terminal]

    def breach(rows: list) -> ca.SX:
        """Return the violation of the rows, times its cost."""
        return BREACH * sum((ca.sum1(ca.fmax(low - e, 0) + ca.fmax(e - high, 0)) for e, low, high in rows), ca.SX(0))

    return replace(
        problem,
        stage_cost=problem.stage_cost + breach([bounds, *path]),
        terminal_cost=problem.terminal_cost + breach([bounds, *terminal]),
        path=(),
        terminal=(),
        swept=False,
    )
