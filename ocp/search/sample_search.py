"""Search by sampled input sequences for any system; the best of each contact schedule is solved on its branch."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from dataclasses import dataclass, field
from functools import cached_property, partial

import numpy as np

from dynamics.contact import Barrier, Exact
from ocp.judge.route_report import SearchedPlan, SearchReport
from ocp.problem.rollout import Rollout
from ocp.routes.homotopy import StageRecord
from ocp.routes.schedules import acting, are_distinct
from ocp.routes.session import Session
from ocp.search.perturbed_plans import perturbed_plans
from ocp.search.plan_solver import PlanSolver, exact_rollout, is_less
from ocp.search.sampling import MAX_SAMPLES, InputSampler
from ocp.search.sampling_runs import SampledPlan
from ocp.search.search import (
    FEW_PAIRS,
    OTHER_ROUTES,
    SAMPLED,
    Search,
    can_roll_out,
    idles,
    is_doubtful,
    is_poor,
    replay_cost,
)
from ocp.solution import Solution

NORMAL_FAILING_SHARE = 0.4
"""Fraction of samples with a failing step above which sampling ends at normal effort."""
THOROUGH_CANDIDATES = 6
"""Maximum number of sampled plans, with different contact schedules, that are solved locally at thorough effort."""
NORMAL_CANDIDATES = 3
"""Maximum number of sampled plans that are solved locally at normal effort."""
BOTH_LAWS = (Exact(), Barrier(mu=1.0))
"""Laws of all samples at thorough effort."""
THOROUGH_AROUND = 3
"""Number of times that the rounds of the sampling run around an answer are increased at thorough effort."""
PASSES_NEAR = 12
"""Maximum number of passes that solve plans near the search's best answer."""
FRUITLESS_PASSES = 4
"""Number of passes in a row that may not pay, after one that did, before the search near an answer ends."""
CANDIDATES_NEAR = 20
"""Maximum number of plans near an answer whose contact schedules are compared."""
NEAR_STREAM = 1
"""Number of the stream of random numbers for plans near answers."""
CATCHING_UP = 0.5
"""Ratio of the samples' excess costs after and before a stage, above which sampling at normal effort ends."""
CERTIFIED_SAMPLES = 500
"""Maximum number of samples in a round at normal effort beside an answer that is certified and does not idle."""
UNPROMISING = 2.0
"""Excess cost of the cheapest sample, relative to what a plan can change, above which normal effort ends."""
SAME_COST = 1e-3
"""Difference of costs, relative to what a plan can change, below which a sample or solution repeats the answer."""
PROMISING = 0.5
"""Excess cost of a sampled plan beside a certified answer, relative to what a plan can change, to be solved."""
RESTARTS = 2
"""Number of times that sampling may begin again with other draws."""
LITTLE_SHARE = 0.5
"""Share of the cost of standing still above which, or relative gain below which, sampling begins again."""
LEAST_GAIN = 0.01
"""Relative gain above which samples or a pass pay, so that the search near their answer goes on."""
MANY_ITERATIONS = 1000
"""Number of the solver's iterations for an answer above which one pass is made near it, even if no sample is better."""
HEAVY_PAIRS = 40
"""Number of contact pairs from which compiling rollouts takes longer than most solves."""


@dataclass
class SampleSearch(Search):
    """Search for plans by sampled inputs, see :class:`~ocp.search.sampling.InputSampler`.

    ``thorough`` effort samples under two laws in all rounds; normal effort samples under the exact law, and, if the
    answer is certified and does not idle, ends when samples no longer improve towards the answer, are far from it, or
    repeat it. The best answer's inputs are then changed at random (:mod:`ocp.search.perturbed_plans`), and plans with
    other contact schedules are solved. All of this begins again with other draws, up to :data:`RESTARTS` times, while
    the plan beside an idling answer does little or became cheaper by that, or once if samples beat a certified answer
    by little.
    """

    thorough: bool = True
    _samplers: list[InputSampler] = field(default_factory=list, init=False)

    def is_needed(self, solution: Solution) -> bool:
        """Return whether to sample: if the search was requested, or if inputs alone determine a plan."""
        session = self.session
        if session.search:
            return True
        light = session.problem.system.nlam < HEAVY_PAIRS
        return can_roll_out(session) and (self.thorough or light or is_poor(solution))

    def solutions(self, answer: Solution) -> Iterator[Solution]:
        """Yield solutions on the branches of the cheapest sampled plans, one per contact schedule.

        In a scene, neither samples nor solutions may pass through bodies between two nodes.
        """
        best, adapts = answer, self._is_patient(answer)
        generator = np.random.default_rng([self.seed, NEAR_STREAM])
        for restart in range(1 + RESTARTS):
            sampler = self._sampler(restart, adapts)
            self._samplers.append(sampler)
            sampled = yield from self._solutions_near_samples(sampler, answer)
            gain = answer.cost_share(replay_cost(answer) - replay_cost(sampled), replay_cost(answer))
            patience = self._patience(answer, pays=not gain <= LEAST_GAIN)
            last = yield from self._passes(sampler, generator, sampled, patience)
            costs = [self._penalized_cost(sampler, solution) for solution in (last, best)]
            # Samples that beat a certified answer by little show that there are cheaper minima.
            is_doubted = not adapts and LEAST_GAIN < gain < LITTLE_SHARE
            pays = restart == 0 or is_less(*costs)
            best = last if is_less(*costs) else best
            little = idles(best, LITTLE_SHARE)
            affordable = self.session.rollout_steps is None and self.session.problem.system.nlam < HEAVY_PAIRS
            if not (affordable and (is_doubted or (idles(answer) and (little or pays)))):
                return
            adapts = True

    def _sampler(self, restart: int, adapts: bool) -> InputSampler:
        laws = BOTH_LAWS if self.thorough else (Exact(),)
        failing_share = 1.0 if self.thorough else NORMAL_FAILING_SHARE
        most = MAX_SAMPLES if adapts else CERTIFIED_SAMPLES
        evaluation, steps = self.session.evaluation, self.session.rollout_steps
        seeds = (self.seed, restart) if restart else self.seed
        return InputSampler(evaluation, seeds, laws, failing_share, steps, most, adapts)

    def _solutions_near_samples(self, sampler: InputSampler, answer: Solution) -> Generator[Solution, None, Solution]:
        """Yield solutions near the plans of a sampler, and return the cheapest of these and ``answer``."""
        rollouts = self._rollouts(sampler, self._sampled(sampler, answer))
        plans = self._distinct(self._promising(rollouts, sampler, answer), sampler, answer)
        return (yield from self._solved(sampler, plans, answer))

    def _passes(
        self, sampler: InputSampler, generator: np.random.Generator, best: Solution, patience: int
    ) -> Generator[Solution, None, Solution]:
        """Yield solutions near the best one, pass by pass, and return the cheapest.

        Passes end after ``patience`` of them in a row that do not pay; one that pays renews it.
        """
        cost, passes = self._penalized_cost(sampler, best), 0
        while patience > 0 and passes < PASSES_NEAR and np.isfinite(cost):
            cost_before, passes = cost, passes + 1
            best = yield from self._solved(sampler, self._plans_near(sampler, generator, best), best)
            cost = self._penalized_cost(sampler, best)
            pays = best.cost_share(cost_before - cost, cost_before) > LEAST_GAIN
            patience = self._patience(best, pays=True) if pays else patience - 1
        return best

    def _patience(self, answer: Solution, pays: bool) -> int:
        """Return how many passes near an answer may not pay, after samples or a pass paid or did not."""
        if self.session.problem.system.nlam > FEW_PAIRS:
            return int(pays)
        is_hard = answer.iterations > MANY_ITERATIONS and self.session.rollout_steps is None
        return FRUITLESS_PASSES if pays else int(is_hard)

    def _plans_near(self, sampler: InputSampler, generator: np.random.Generator, answer: Solution) -> list[Rollout]:
        """Return rollouts near an answer with distinct contact schedules."""
        plans = self._around(sampler, answer)
        if self.session.problem.system.nlam <= FEW_PAIRS:
            plans += perturbed_plans(sampler, answer.arrays["u"][0], generator)
        return self._distinct(self._rollouts(sampler, plans[:CANDIDATES_NEAR]), sampler, answer)

    @cached_property
    def _swept_session(self) -> Session:
        """Session in which plans are solved: bodies in a scene do not pass through each other between nodes."""
        system = self.session.problem.system
        return self.session.as_swept() if system.scene and system.phi is not None else self.session

    def _solved(
        self, sampler: InputSampler, plans: list[Rollout], best: Solution
    ) -> Generator[Solution, None, Solution]:
        """Yield solutions near rollouts that cost less than the ``best`` one, and return the cheapest.

        All plans are listed in the report.
        """
        session, least_cost = self._swept_session, self._penalized_cost(sampler, best)
        limit = least_cost if best.certificate.certified else np.inf
        roll_out = partial(exact_rollout, session)
        solved = self.report.plans if self.report is not None else list[SearchedPlan]()
        solver = PlanSolver(session, roll_out, self.judge, SAMPLED, self.seed, self.progress, limit, solved)
        steps = sum(sampler.rolled_steps for sampler in self._samplers)
        self.report = SearchReport(self.seed, steps // session.problem.N, steps, solved)
        for _, solution in solver.solve(plans):
            yield solution.with_route(swept=session.problem.swept)
            cost = self._penalized_cost(sampler, solution)
            if is_less(cost, least_cost):
                best, least_cost = solution, cost
        return best

    @staticmethod
    def _penalized_cost(sampler: InputSampler, solution: Solution) -> float:
        """Return the cost of a solution's exact replay, with the penalty of its transitions.

        It is infinite if the replay failed or violates constraints. The rollout of the batch engine would not do: where
        a step has several solutions, as behind a corner, it may end at another one than the replay.
        """
        if solution.audit.replay_broken:
            return np.inf
        states, inputs = solution.arrays["x"], solution.arrays["u"]
        return replay_cost(solution) + float(np.sum(sampler.transition_penalties(states, inputs)))

    def _sampled(self, sampler: InputSampler, answer: Solution) -> list[SampledPlan]:
        """Return the cheapest plan of each run, and a better plan near a poor solution if sampling finds one.

        Near a certified solution that does not idle, small changes of inputs find nothing better.
        """
        plans: list[SampledPlan] = []
        patient = sampler.adapts
        excess_before = answer.idle_cost - replay_cost(answer)
        for number, plans in enumerate(sampler.stages(), 1):
            best = min((plan.cost for plan in plans), default=np.inf)
            if self.progress is not None:
                nan = np.nan
                self.progress(StageRecord("samples", number, best, nan, nan, sampler.rolled_steps, nan, "sampled"))
            excess = best - replay_cost(answer)
            if not patient and self._is_fruitless(excess, excess_before, replay_cost(answer)):
                break
            excess_before = excess
        return [*plans, *self._around(sampler, answer)] if plans and patient else plans

    def _is_patient(self, answer: Solution) -> bool:
        """Return whether to sample with the whole budget, also where samples bring nothing."""
        return self.thorough or is_doubtful(answer)

    def _is_fruitless(self, excess: float, excess_before: float, cost: float) -> bool:
        """Return whether to end sampling, by the excess of the samples over ``cost`` after and before a stage."""
        share = self.session.evaluation.cost_share(excess, cost)
        return excess > 0 and (excess > CATCHING_UP * excess_before or not SAME_COST < share < UNPROMISING)

    def _around(self, sampler: InputSampler, answer: Solution) -> list[SampledPlan]:
        """Return the plan from sampling every input around a solution; empty if it is not cheaper."""
        rounds = sampler.narrowing.rounds * (THOROUGH_AROUND if self.thorough else 1)
        plan = sampler.around(answer.arrays["u"][0], rounds)
        return [plan] if is_less(plan.cost, self._penalized_cost(sampler, answer)) else []

    def _rollouts(self, sampler: InputSampler, plans: list[SampledPlan]) -> list[tuple[float, Rollout]]:
        """Return the successful exact rollouts of sampled plans, with penalized costs, the cheapest first."""
        costs = [sampler.exact_cost(plan.inputs) for plan in plans]
        rollouts = ((costs[i], exact_rollout(self.session, plans[i].inputs)) for i in np.argsort(costs, kind="stable"))
        return [(cost, rollout) for cost, rollout in rollouts if rollout is not None]

    def _promising(
        self, rollouts: list[tuple[float, Rollout]], sampler: InputSampler, answer: Solution
    ) -> list[tuple[float, Rollout]]:
        """Return the rollouts that cost little more than a certified answer; all of them beside another answer."""
        if self.thorough or not answer.certificate.certified:
            return rollouts
        cost, cost_share = self._penalized_cost(sampler, answer), self.session.evaluation.cost_share
        return [item for item in rollouts if item[0] < cost or cost_share(item[0] - cost, cost) < PROMISING]

    def _distinct(
        self, rollouts: list[tuple[float, Rollout]], sampler: InputSampler, answer: Solution
    ) -> list[Rollout]:
        """Return rollouts with distinct contact schedules, in order.

        Beside a certified answer, those that are dearer and have its schedule come last, and one of them at most.
        """
        cost, sizes = self._penalized_cost(sampler, answer), self.session.problem.scales
        answered = acting(answer.arrays["lam"][0], answer.arrays["gap"][0], sizes)
        chosen, schedules, repeated = list[Rollout](), list[np.ndarray](), list[Rollout]()
        for rollout_cost, rollout in rollouts:
            schedule = acting(rollout.lam[0], rollout.gap[0], sizes)
            if not all(are_distinct(schedule, compared) for compared in schedules):
                continue
            if answer.certificate.certified and rollout_cost > cost and not are_distinct(schedule, answered):
                repeated.append(rollout)
            else:
                chosen.append(rollout)
                schedules.append(schedule)
        return [*chosen, *repeated[:1]][: THOROUGH_CANDIDATES if self.thorough else NORMAL_CANDIDATES]


@dataclass
class NearSearch(SampleSearch):
    """Search near an answer of other routes, by the passes that :class:`SampleSearch` ends with."""

    def is_needed(self, solution: Solution) -> bool:
        """Return whether the answer is of another route, and the problem has few contact pairs."""
        few = self.session.problem.system.nlam <= FEW_PAIRS
        return solution.route.name in OTHER_ROUTES and few and can_roll_out(self.session)

    def solutions(self, answer: Solution) -> Iterator[Solution]:
        """Yield solutions near ``answer`` that cost less."""
        sampler, generator = self._sampler(0, adapts=False), np.random.default_rng([self.seed, NEAR_STREAM, 1])
        self._samplers.append(sampler)
        yield from self._passes(sampler, generator, answer, self._patience(answer, pays=True))
