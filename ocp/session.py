"""A problem under a law, a method and a policy, built once and solved as often as wanted."""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from dynamics.contact import Barrier, ContactLaw, Exact, Step
from dynamics.contact.law import Schedule
from ocp.effort import solve_memory, solve_seconds
from ocp.errors import NotConverged, choose
from ocp.policy import Feedback, Policy
from ocp.problem import Problem
from ocp.programs.solver import Point, Solver
from ocp.rollout import InitialGuess
from ocp.routes.branches import polish
from ocp.routes.complementarity import (
    ALTERNATIVES,
    FALLBACK,
    FALLBACK_SMALL,
    RELAXATIONS,
    SMALL_ITERATIONS,
    SMALL_PAIRS,
    Route,
    solve_pairs,
)
from ocp.routes.homotopy import (
    PRIMAL,
    Homotopy,
    HomotopyPath,
    HomotopyStage,
    Outcome,
    Progress,
    better,
    lower,
    translate,
)
from ocp.routes.relaxations import (
    AVERAGED_STRATEGY,
    DEFAULT_STRATEGY,
    MU_LAST,
    STAGE_ITERATIONS,
    STRATEGIES,
    L1Penalty,
    L1ThenScholtes,
    from_exact,
    law_path,
    relaxed,
)
from ocp.routes.rollouts import RolloutPolish, RolloutStarts
from ocp.transcription import Direct, Method
from ocp.transcription.compiled import StageCompiler
from ocp.transcription.nlp import NLP

_LOG = logging.getLogger(__name__)
_NEAR, _WIDE = 1e-6, 1e-3
"""Relaxations of lam gap, in characteristic units, on which an exact solve starts from a point
nearby, and from elsewhere."""
_PARTED = 1e-3
"""Relative rise of the cost from which on a rollout has parted from its plan."""


@dataclass
class Session:
    """Everything that is built once: the closed step and one NLP per reformulation, in ``nlps``.

    ``values`` are parameter values by name (problem, law, strategy); turn them and solve again.
    """

    problem: Problem
    law: ContactLaw
    method: Method
    policy: Policy
    solver: Solver = field(default_factory=Solver)
    strategy: str = DEFAULT_STRATEGY
    homotopy: bool | None = None
    factor: float | None = None
    start_value: float | None = None
    compiled: StageCompiler | None = None

    def __post_init__(self) -> None:
        began = time.perf_counter()
        plain = isinstance(self.law, Exact)
        self.step: Step = self.problem.exact_step if plain else self.law.close(self.problem.system)
        if self.step.branches > 1 and self.strategy == DEFAULT_STRATEGY:
            self.strategy = AVERAGED_STRATEGY
        self.nlps: dict[str, NLP] = {}
        self.helpers: dict[str, Session] = {}
        table = self.problem.parameters + self.step.p
        self.values = table.defaults | {"penalty": 0.0, "relaxation": 0.0}
        self.problem.check_physics()
        self.build_s = time.perf_counter() - began

    @property
    def nlp_builds(self) -> int:
        """Number of NLPs built, one per reformulation, including those of helper sessions."""
        return len(self.nlps) + sum(helper.nlp_builds for helper in self.helpers.values())

    def nlp_of(self, reformulation: str) -> NLP:
        """Build the NLP of a reformulation, or return the one that exists."""
        if reformulation not in self.nlps:
            began = time.perf_counter()
            self.nlps[reformulation] = self.method.transcribe(
                self.problem, self.step, self.policy, reformulation, self.compiled
            )
            took = time.perf_counter() - began
            self.build_s += took
            built = self.nlps[reformulation]
            _LOG.info(
                "%s by %s, %s reformulation: %d variables, %d constraints, built in %.3f s",
                self.problem.name, self.method.name, reformulation, built.n, built.m, took,
            )  # fmt: skip
        return self.nlps[reformulation]

    @property
    def complementary(self) -> bool:
        """Whether the contact stands as complementarity in the NLP itself."""
        return self.step.exact and isinstance(self.method, Direct)

    def solve(
        self, start: Point | None = None, progress: Progress | None = None,
        guess: InitialGuess | None = None, warm_from: NLP | None = None, number: int = 0,
    ) -> Outcome:  # fmt: skip
        """Solve at the present values, from a warm point of ``warm_from`` or from a guess.

        ``number`` counts several guesses: each takes another relaxation than the one before, since
        a relaxation that starts wide forgets its guess and ends in the same minimum.

        Raises :class:`~ocp.errors.InputError` at values without mechanics, as without mass.
        """
        self.problem.check_physics(self.values)
        follower = Homotopy(self.nlp_of, self.solver, self.values, progress)
        if start is not None and warm_from is not None:
            there = translate(start, warm_from, self.nlp_of("product"))
            return self._warm(follower, there, _NEAR, [{"mu_init": 1e-7}], {})
        if self.complementary:
            return Outcome(*solve_pairs(follower, self._route(guess, number)), follower.trace)
        return self._smooth(follower, guess)

    def _smooth(self, follower: Homotopy, guess: InitialGuess | None) -> Outcome:
        """Follow the law's own path, and try the exact law's answer as a start beside it."""
        nlp = self.nlp_of("product")
        if self.step.exact and self.homotopy is not False:
            return self._rolled(follower, guess, nlp)
        schedule, path = self.path()
        value = self.values[schedule.parameter] if schedule else 0.0
        result, nlp, finished = follower.follow(path, self.first_point(nlp, guess))
        if len(path.values) > 1 and self.step.branches == 1:
            exact = self._absorbed(self.helper(Exact(), Direct()), follower, guess)
            if exact.finished:
                x = translate(exact.result.point, exact.nlp, nlp).x
                below = from_exact(follower, nlp, x, schedule, value)
                if below is not None and (not finished or lower(below, result)):
                    result, finished = below, True
        return Outcome(result, nlp, finished, follower.trace)

    def path(self) -> tuple[Schedule | None, HomotopyPath]:
        """The law's own path and how it falls; one stage, and None, where none is followed.

        Raises :class:`~ocp.errors.InputError` for one of too many stages.
        """
        schedule = None if self.step.exact or self.homotopy is False else self.schedule()
        if schedule is None:
            return None, HomotopyPath([0.0], lambda _: HomotopyStage(self.step.law.name, 0.0))
        value = self.values[schedule.parameter]
        return schedule, law_path(schedule, value, self.start_value, self.factor)

    @property
    def from_afar(self) -> bool:
        """Whether a solve follows a smoothing, which feels contact where the guess has none."""
        if self.complementary:
            return not isinstance(STRATEGIES[self.strategy], L1Penalty | L1ThenScholtes)
        return self.homotopy is not False and (self.step.exact or self.schedule() is not None)

    @property
    def seconds(self) -> float:
        """What a solve takes, about (:mod:`ocp.effort`)."""
        path = 1 if self.complementary else len(self.path()[1].values)
        return solve_seconds(self.problem, self.policy, self.law, path)

    @property
    def memory(self) -> float:
        """Bytes that a solve takes, about (:mod:`ocp.effort`)."""
        return solve_memory(self.problem, self.policy, self.law)

    def schedule(self) -> Schedule | None:
        """How the law's parameter is followed down, if it has one."""
        sizes = self.problem.scales
        return self.step.law.schedule(sizes.impulse, sizes.gap)

    def _absorbed(self, helper: Session, follower: Homotopy, guess: InitialGuess | None) -> Outcome:
        """Solve by a helping session, whose table and work are added to the follower's."""
        found = helper.solve(guess=guess, progress=follower.progress)
        follower.trace.absorb(found.trace)
        return found

    def _rolled(self, follower: Homotopy, guess: InitialGuess | None, nlp: NLP) -> Outcome:
        """Exact law in shooting: a plan made otherwise, rolled out exactly and polished.

        At a kink of the exact law no gradient vanishes, so a gradient method cannot end there. The
        plan is the complementarity problem's own, by direct transcription; with ``homotopy``, or
        where its relaxation was hard to follow or it parts from its rollout, the barrier law's path
        leads to one. Of plans that their rollouts keep to, the cheapest is the answer.
        """
        direct, best = self.judging_nlp(), None
        polisher = RolloutPolish(nlp, direct, self.step, Homotopy(
            lambda _: direct, self.solver, self.values, follower.progress, follower.trace
        ))  # fmt: skip
        helpers = [self.helper(self.law, Direct())]
        if self.step.branches == 1:
            barrier = self.helper(Barrier(mu=MU_LAST), self.method)
            helpers = [barrier] if self.homotopy else [*helpers, barrier]
        for helper in helpers:
            if helper.method is self.method:
                start = helper.first_point(helper.nlp_of("product"), guess)
                within = Homotopy(helper.nlp_of, self.solver, helper.values, follower.progress,
                                  follower.trace)  # fmt: skip
                plan = polisher.along(within, helper.path()[1], start)
            else:
                plan = self._absorbed(helper, follower, guess)
            try:
                polished, solved = polisher.polish(plan.nlp, plan.result)
            except NotConverged:
                continue
            ended = solved or plan.result
            polished = replace(polished, status=ended.status, word=ended.word)
            kept = solved is not None and not lower(solved, polished, _PARTED)
            best = better(best, Outcome(polished, nlp, kept, follower.trace, solved))
            hard = any(line.label == "t" and not line.accepted for line in follower.trace.records)
            if plan.finished and kept and not hard:
                break
        assert best is not None
        return best

    def helper(self, law: ContactLaw, method: Method) -> Session:
        """Return the session of the same problem under another law, at the values both have."""
        key = f"{law.name} {method.name}"
        if key not in self.helpers:
            self.helpers[key] = Session(
                self.problem, law, method, self.policy, self.solver, compiled=self.compiled
            )
        helper = self.helpers[key]
        helper.values |= {name: v for name, v in self.values.items() if name in helper.values}
        return helper

    def judging_nlp(self) -> NLP:
        """Return the NLP in which an answer is judged: the one that was asked.

        Under the exact law that is the complementarity problem by direct transcription, whatever
        the method: only there do the pairs stand, and a kink of shooting is seen for what it is.
        """
        if not self.step.exact:
            return self.nlp_of("product")
        direct = self if isinstance(self.method, Direct) else self.helper(self.law, Direct())
        return direct.nlp_of("none")

    @property
    def total_build_s(self) -> float:
        """Seconds of set-up, of helping sessions too."""
        return self.build_s + sum(helper.total_build_s for helper in self.helpers.values())

    def _route(self, guess: InitialGuess | None, number: int) -> Route:
        """How the exact law is reached: as asked, or by the default for many or for few pairs."""
        strategy = choose("strategy", self.strategy, STRATEGIES)
        asked = Route(strategy, self.problem.scaling, partial(self.first_point, guess=guess))
        if self.strategy != DEFAULT_STRATEGY:
            return asked
        own = guess or self.problem.initial_guess(self.problem.parameters.pack(self.values))
        rolls = RolloutStarts(self.problem, self.step, self.values, own)
        rolls = None if isinstance(self.policy, Feedback) else rolls
        if self.nlp_of("product").pairs.shape[1] > SMALL_PAIRS:
            return replace(asked, fallback=FALLBACK, rolls=rolls)
        strategy = RELAXATIONS[-number % len(RELAXATIONS)]
        return replace(
            asked,
            strategy=replace(strategy, most=SMALL_ITERATIONS),
            fallback=FALLBACK_SMALL,
            alternatives=ALTERNATIVES,
            rolls=rolls,
        )

    def resume(self, start: Point, progress: Progress | None = None) -> Outcome:
        """Solve at the present values from a point of the product NLP that came from elsewhere.

        :func:`~ocp.warm_start.carry` makes such points; unlike those of a continuation they need
        not be near. A second try therefore lets the solver's barrier parameter start high, and the
        exact law starts on a relaxation that is wide enough to exchange contacts.
        """
        follower = Homotopy(self.nlp_of, self.solver, self.values, progress)
        keep = {} if start.lam_g is not None else PRIMAL
        short = {"max_iter": STAGE_ITERATIONS, **self.solver.options}
        tries = [{**keep, "mu_init": 1e-7, **short}, {**keep, "mu_init": 1e-3}]
        return self._warm(follower, start, _WIDE, tries, keep)

    def _warm(
        self, follower: Homotopy, start: Point, share: float, tries: list[dict[str, Any]],
        keep: dict[str, Any],
    ) -> Outcome:  # fmt: skip
        """One warm stage, by the options of ``tries`` until one succeeds.

        For the exact law it is one on a relaxation of a ``share`` of the characteristic mu, and the
        polish from there, which is improved only where that is not near.
        """
        nlp = self.nlp_of("product")
        stages = [HomotopyStage(self.step.law.name, 0.0, options=options) for options in tries]
        if self.complementary:
            t = share * self.problem.scaling.mu
            stages = [relaxed(t, {**keep, "mu_init": max(t / 10, 1e-9)})]
        result = follower.solve_stage(stages[0], nlp, start, True)
        for stage in stages[1:]:
            result = result if result.ok else follower.solve_stage(stage, nlp, start, True)
        if not (self.complementary and result.ok):
            return Outcome(result, nlp, result.ok, follower.trace)
        return Outcome(*polish(follower, nlp, result, improving=share == _WIDE), follower.trace)

    def first_point(self, nlp: NLP, guess: InitialGuess | None = None) -> Point:
        """Write guessed trajectories into the NLP's variables, with contacts to match.

        Multipliers and gaps start on the central path of the homotopy's first mu, each gap at its
        contact-free value where that is open.
        """
        physical = self.problem.parameters.pack(self.values)
        X, U = guess if guess is not None else self.problem.initial_guess(physical)
        blocks: dict[str, np.ndarray] = {"x0": X[None, :1], "x": X[None, 1:], "u": U[None]}
        if isinstance(self.policy, Feedback):
            blocks["k"] = U[:1] if self.policy.stationary else U
        if "lam" in nlp.variables:
            scaling, units = self.problem.scaling, nlp.variables.unpack(nlp.natural.x)
            mu = scaling.mu
            free = self._free_gaps(X, U) / units["gap"][0]
            gap = np.maximum(free, np.sqrt(mu * scaling.gap))
            blocks["gap"], blocks["lam"] = gap * units["gap"], mu / gap * units["lam"]
        return Point(nlp.variables.pack({k: v for k, v in blocks.items() if k in nlp.variables}))

    def _free_gaps(self, X: np.ndarray, U: np.ndarray) -> np.ndarray:
        step = self.step
        values = step.p.pack(self.values)
        zeros = np.zeros((step.n, len(U)))
        _, gap, _ = step.relation.map(len(U))(X[:-1].T, U.T, X[1:].T, zeros, values)
        return np.array(gap).T
