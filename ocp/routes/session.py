"""A problem with a contact law, a method and a policy, built once and solved many times."""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from dynamics.contact import ContactLaw, Exact, Step
from dynamics.contact.law import Schedule
from ocp.problem.checks import check_physics
from ocp.problem.evaluation import Evaluation
from ocp.problem.policy import Feedback, Policy
from ocp.problem.problem import Problem
from ocp.problem.resources import solve_memory, solve_seconds
from ocp.problem.rollout import InitialGuess
from ocp.problem.sketch import UserGuess, Window
from ocp.programs.program import PENALTY, RELAXATION
from ocp.programs.solver import Point, Solver
from ocp.routes.homotopy import Homotopy, HomotopyPath, HomotopyStage, Progress, RouteResult, translate
from ocp.routes.relaxations import AVERAGED_STRATEGY, DEFAULT_STRATEGY, STRATEGIES, L1Penalty, L1ThenScholtes, law_path
from ocp.routes.table import Start, route_for
from ocp.transcription import Direct, Method
from ocp.transcription.common import Graph
from ocp.transcription.nlp import NLP, StageCompiler

if TYPE_CHECKING:
    from ocp.transcription.pieces import PiecewiseNLP

logger = logging.getLogger(__name__)

Effort = Literal["quick", "normal", "thorough"]
"""Additional work after the usual route: none; sampled plans; or sampled plans under two laws, and other routes."""
DEFAULT_EFFORT: Effort = "normal"
"""Effort of a single solve; solves of a sweep are quick."""


@dataclass
class Session:
    """A problem with a contact law, method and policy: its step and one NLP per reformulation, built once.

    ``values`` maps names of parameters (problem, law, strategy) to values; change them and solve again.
    ``rollout_steps`` is the budget of samples in steps, None for the usual one. ``user_guess`` is the user's guess,
    near which a solution is searched. ``windows`` maps blocks of variables to narrower bounds, in every NLP.
    """

    problem: Problem
    law: ContactLaw
    method: Method
    policy: Policy
    solver: Solver = field(default_factory=Solver)
    strategy: str = DEFAULT_STRATEGY
    homotopy: bool | None = None
    factor: float | None = None
    homotopy_start: float | None = None
    search: bool | None = None
    effort: Effort = "quick"
    rollout_steps: int | None = None
    user_guess: UserGuess | None = None
    windows: dict[str, Window] = field(default_factory=dict)
    compiled: StageCompiler | None = None

    def __post_init__(self) -> None:
        start_time = time.perf_counter()
        is_exact = isinstance(self.law, Exact)
        self.step: Step = self.problem.exact_step if is_exact else self.law.close(self.problem.system)
        if self.step.branches > 1 and self.strategy == DEFAULT_STRATEGY:
            self.strategy = AVERAGED_STRATEGY
        self.nlps: dict[str, NLP] = {}
        self.sub_sessions: dict[str, Session] = {}
        table = self.problem.parameters + self.step.p
        self.values = table.defaults | {PENALTY: 0.0, RELAXATION: 0.0}
        check_physics(self.problem)
        self.build_s = time.perf_counter() - start_time

    @property
    def evaluation(self) -> Evaluation:
        """The problem at the current parameter values."""
        return Evaluation(self.problem, dict(self.values))

    @property
    def nlp_builds(self) -> int:
        """Number of NLPs built, one per reformulation, including those of sub-sessions."""
        return len(self.nlps) + sum(sub_session.nlp_builds for sub_session in self.sub_sessions.values())

    def nlp_of(self, reformulation: str) -> NLP:
        """Return the NLP of a reformulation; it is built at its first use."""
        if reformulation not in self.nlps:
            start_time = time.perf_counter()
            graph = Graph(self.problem, self.step, self.policy)
            self.nlps[reformulation] = self.method.transcribe(graph, reformulation, self.compiled)
            self.nlps[reformulation].windows = self.windows
            seconds = time.perf_counter() - start_time
            self.build_s += seconds
            nlp = self.nlps[reformulation]
            logger.info(
                "%s by %s, %s reformulation: %d variables, %d constraints, built in %.3f s",
                self.problem.name,
                self.method.name,
                reformulation,
                nlp.n,
                nlp.m,
                seconds,
            )
        return self.nlps[reformulation]

    @property
    def pieces(self) -> PiecewiseNLP:
        """The complementarity problem of the exact law by direct transcription, whose kinks have sides."""
        from ocp.transcription.pieces import PiecewiseNLP

        nlp = self._direct.nlp_of("pieces")
        assert isinstance(nlp, PiecewiseNLP)
        return nlp

    @property
    def complementary(self) -> bool:
        """Whether the NLP has complementarity constraints, as for the exact law in direct transcription."""
        return self.step.exact and isinstance(self.method, Direct)

    def solve(
        self,
        start: Point | None = None,
        progress: Progress | None = None,
        guess: InitialGuess | None = None,
        warm_from: NLP | None = None,
        number: int = 0,
    ) -> RouteResult:
        """Solve at the current values, from a warm point of ``warm_from`` or from a guess.

        ``number`` is the index among several guesses: each uses a different relaxation, since a
        relaxation with a large initial value does not depend on its guess and ends in the same minimum.

        Raises :class:`~ocp.errors.InputError` for values that are not physical, such as a zero mass.
        """
        if start is not None and warm_from is not None:
            point = translate(start, warm_from, self.nlp_of("product"))
            return self._solve(Start(point=point), progress)
        return self._solve(Start(guess, number), progress)

    def resume(self, start: Point, progress: Progress | None = None) -> RouteResult:
        """Solve at the current values from a point of the product NLP, which need not be near a solution.

        :func:`~ocp.solve.warm_start.carry` makes such points from other solutions.
        """
        return self._solve(Start(point=start, near=False), progress)

    def _solve(self, start: Start, progress: Progress | None) -> RouteResult:
        check_physics(self.problem, self.values)
        follower = Homotopy(self.nlp_of, self.solver, self.values, progress)
        route = route_for(self, start)
        return replace(route.apply(self, start, follower), route=route.name)

    def path(self) -> tuple[Schedule | None, HomotopyPath]:
        """Return the law's schedule and its homotopy path; without a schedule, None and a path of a single stage.

        Raises :class:`~ocp.errors.InputError` for a path of too many stages.
        """
        schedule = None if self.step.exact or self.homotopy is False else self.schedule()
        if schedule is None:
            return None, HomotopyPath([0.0], lambda _: HomotopyStage(self.step.law.name, 0.0))
        value = self.values[schedule.parameter]
        return schedule, law_path(schedule, value, self.homotopy_start, self.factor)

    @property
    def follows_smoothing(self) -> bool:
        """Whether a solve follows a path of smoothed problems, which have contact forces at a distance."""
        if self.complementary:
            return not isinstance(STRATEGIES[self.strategy], L1Penalty | L1ThenScholtes)
        return self.homotopy is not False and (self.step.exact or self.schedule() is not None)

    @property
    def seconds(self) -> float:
        """Rough estimate of the time of a solve [s] (:mod:`ocp.problem.resources`)."""
        path = 1 if self.complementary else len(self.path()[1].values)
        return solve_seconds(self.problem, self.policy, self.law, path)

    @property
    def memory(self) -> float:
        """Rough estimate of the memory of a solve [bytes] (:mod:`ocp.problem.resources`)."""
        return solve_memory(self.problem, self.policy, self.law)

    def schedule(self) -> Schedule | None:
        """Return the schedule of the law's parameter, None for a law without one."""
        sizes = self.problem.scales
        return self.step.law.schedule(sizes.impulse, sizes.gap)

    def with_changes(self, values: Mapping[str, float] | None = None, **fields: Any) -> Session:
        """Return a session with other ``fields``, such as the problem, at the values of common parameters.

        ``values`` replace some of these.
        """
        session = replace(self, **fields)
        session.set_common({**self.values, **(values or {})})
        return session

    def as_swept(self) -> Session:
        """Return the session of the same problem with ``swept`` set, at the same values, without further search."""
        if self.problem.swept:
            return self
        return self.with_changes(problem=replace(self.problem, swept=True), search=False)

    def set_common(self, values: Mapping[str, float]) -> None:
        """Set the values of those parameters in ``values`` that the session has."""
        self.values |= {name: value for name, value in values.items() if name in self.values}

    def sub_session(self, law: ContactLaw, method: Method) -> Session:
        """Return a session of the same problem with another law and method, at the values of the common parameters."""
        key = f"{law.name} {method.name}"
        if key not in self.sub_sessions:
            self.sub_sessions[key] = Session(
                self.problem, law, method, self.policy, self.solver, compiled=self.compiled
            )
        sub_session = self.sub_sessions[key]
        sub_session.set_common(self.values)
        return sub_session

    def judging_nlp(self) -> NLP:
        """Return the NLP in which a solution is audited and certified.

        Under the exact law this is the complementarity problem by direct transcription for every method, since
        only its variables contain the pairs.
        """
        if not self.step.exact:
            return self.nlp_of("product")
        return self._direct.nlp_of("none")

    @property
    def _direct(self) -> Session:
        return self if isinstance(self.method, Direct) else self.sub_session(self.law, Direct())

    @property
    def total_build_s(self) -> float:
        """Set-up time [s], including that of sub-sessions."""
        return self.build_s + sum(sub_session.total_build_s for sub_session in self.sub_sessions.values())

    def first_point(self, nlp: NLP, guess: InitialGuess | None = None) -> Point:
        """Return a starting point of the NLP from guessed trajectories, including multipliers and gaps.

        Multipliers and gaps start on the central path of the homotopy's first mu. Each gap is the gap without
        contact forces if that is positive.
        """
        X, U = guess if guess is not None else self.evaluation.initial_guess
        blocks: dict[str, np.ndarray] = {"x0": X[None, :1], "x": X[None, 1:], "u": U[None]}
        if isinstance(self.policy, Feedback):
            blocks["k"] = U[:1] if self.policy.stationary else U
        if "lam" in nlp.variables:
            sizes, units = self.problem.natural_scales, nlp.variables.unpack(nlp.natural.x)
            mu = sizes.mu
            free = self._free_gaps(X, U) / units["gap"][0]
            gap = np.maximum(free, np.sqrt(mu * sizes.gap))
            blocks["gap"], blocks["lam"] = gap * units["gap"], mu / gap * units["lam"]
        return Point(nlp.variables.pack({k: v for k, v in blocks.items() if k in nlp.variables}))

    def _free_gaps(self, X: np.ndarray, U: np.ndarray) -> np.ndarray:
        step = self.step
        values = step.p.pack(self.values)
        zeros = np.zeros((step.n, len(U)))
        _, gap, _ = step.relation.map(len(U))(X[:-1].T, U.T, X[1:].T, zeros, values)
        return np.array(gap).T
