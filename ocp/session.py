"""A problem under a law, a method and a policy, built once and solved as often as wanted."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from dynamics.contact import Barrier, ContactLaw, Exact, Step
from ocp.errors import InputError
from ocp.landing import land
from ocp.policy import Feedback, Policy
from ocp.problem import Problem
from ocp.solvers.homotopy import (
    PRIMAL,
    Homotopy,
    Path,
    Plan,
    Progress,
    Trace,
    geometric,
    translate,
)
from ocp.solvers.polish import polish
from ocp.solvers.solver import Point, Result, Solver
from ocp.solvers.strategies import AVERAGED_STRATEGY, DEFAULT_STRATEGY, STRATEGIES, CentralPath
from ocp.transcription import Direct, Method
from ocp.transcription.compiled import StageCompiler
from ocp.transcription.nlp import NLP

_STAGE_ITERATIONS = 100
"""Before the last stage of a law's path an answer need not be sharp, only nearer."""
_EXACT_ITERATIONS = 200
"""What a gradient method is given under the exact law in shooting, before the barrier path is."""
_MU_LAST = 1e-9
"""Where the barrier law is left for the exact one in shooting."""
_WIDE = 1e-3
"""Relaxation of lam gap, in characteristic units, on which an exact solve from elsewhere starts."""
_GAIN = 1e-7
"""Relative fall of the cost for which an answer is exchanged for another."""


@dataclass(frozen=True)
class Outcome:
    """What one solve left: the result and its NLP, the table, and whether the path was finished."""

    result: Result
    nlp: NLP
    finished: bool
    trace: Trace


@dataclass
class Session:
    """Everything that is built once: the closed step and one NLP per form, in ``nlps``.

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
        self.values = {parameter.name: float(parameter.value) for parameter in table}
        self.values |= {"penalty": 0.0, "relaxation": 0.0}
        self.problem.check_step_size()
        self.build_s = time.perf_counter() - began

    @property
    def nlp_builds(self) -> int:
        """Number of NLPs built, one a form, those of helping sessions included."""
        return len(self.nlps) + sum(helper.nlp_builds for helper in self.helpers.values())

    def nlp_of(self, form: str) -> NLP:
        """Build the NLP of a form, or return the one that exists."""
        if form not in self.nlps:
            began = time.perf_counter()
            self.nlps[form] = self.method.transcribe(
                self.problem, self.step, self.policy, form, self.compiled
            )
            self.build_s += time.perf_counter() - began
        return self.nlps[form]

    @property
    def complementary(self) -> bool:
        """Whether the contact stands as complementarity in the NLP itself."""
        return self.step.exact and isinstance(self.method, Direct)

    def solve(
        self, start: Point | None = None, progress: Progress | None = None,
        guess: tuple[np.ndarray, np.ndarray] | None = None, warm_from: NLP | None = None,
    ) -> Outcome:  # fmt: skip
        """Solve at the present values, from a warm point of ``warm_from`` or from a guess."""
        follower = Homotopy(self.nlp_of, self.solver, self.values, progress)
        if start is not None and warm_from is not None:
            return self._continue(follower, start, warm_from)
        if self.complementary:
            return self._exact(follower, guess)
        return self._smooth(follower, guess)

    def _smooth(self, follower: Homotopy, guess: tuple[np.ndarray, np.ndarray] | None) -> Outcome:
        nlp = self.nlp_of("product")
        averaged = self.step.branches > 1 and self.homotopy is not False
        if self.step.exact and (self.homotopy or averaged):
            return self._through_barrier(follower, guess, nlp)
        point = self.first_point(nlp, guess)
        path = self._law_path()
        result, nlp, finished = follower.follow(path, point)
        if self.step.exact and self.homotopy is None and not finished:
            return self._through_barrier(follower, guess, nlp)
        if len(path.values) > 1 and self.step.branches == 1:
            below = self._from_exact(follower, guess)
            if below is not None and (not finished or below.f < result.f - _GAIN * abs(result.f)):
                result, finished = below, True
        return Outcome(result, nlp, finished, follower.trace)

    def _from_exact(
        self, follower: Homotopy, guess: tuple[np.ndarray, np.ndarray] | None
    ) -> Result | None:
        """Solve at the law's value once more, from the exact law's answer instead of a wide start.

        The path from a wide law may end in a worse minimum, one with another contact schedule, and
        then the exact optimum is the better neighbour.
        """
        helper = self._helper(Exact(), Direct())
        exact = helper.solve(guess=guess, progress=follower.progress)
        follower.trace.absorb(exact.trace)
        if not exact.finished:
            return None
        nlp = self.nlp_of("product")
        x = translate(exact.result.point, exact.nlp, nlp).x
        knob = self.step.law.homotopy_knob
        value = self.values[knob] if knob else 0.0
        if nlp.pairs.size:
            mu = max(value, _MU_LAST) if knob == "contact.mu" else _MU_LAST
            lam, gap = np.maximum(x[nlp.pairs], np.sqrt(mu) * 1e-3)
            acts = lam > gap
            x[nlp.pairs] = np.where(acts, lam, mu / gap), np.where(acts, mu / lam, gap)
        plan = Plan("from exact", value, options={"mu_init": 1e-3})
        found = follower.stage(plan, nlp, Point(x), False)
        return found if found.ok else None

    def _law_path(self) -> Path:
        """The law's own knob from a wide start to its value, or the one value."""
        knob = self.step.law.homotopy_knob
        if knob is None or self.homotopy is False or self.step.exact:
            tries = self.step.exact and self.homotopy is None
            limit = {"max_iter": _EXACT_ITERATIONS, **self.solver.options} if tries else {}
            return Path([0.0], lambda _: Plan(self.step.law.name, 0.0, options=limit))
        target = self.values[knob]
        reference = self.problem.reference
        spatial = knob.endswith("sigma")
        wide = 3 * reference.gap if spatial else reference.impulse * reference.gap
        factor = self.factor or (0.55 if spatial else 0.2)
        values = geometric(self.start_value or wide, target, factor)
        label = knob.removeprefix("contact.")

        def plan(value: float) -> Plan:
            options: dict[str, Any] = {}
            if value != values[0]:
                options["mu_init"] = 1e-5
            last = value == target
            if not last:
                options |= {"tol": 1e-6, "max_iter": _STAGE_ITERATIONS}
            return Plan(label, value, parameters={knob: value}, options=options, partial=not last)

        return Path(values, plan)

    def _through_barrier(
        self, follower: Homotopy, guess: tuple[np.ndarray, np.ndarray] | None, nlp: NLP
    ) -> Outcome:
        """Exact law in shooting: follow the barrier law down, then roll its plan out exactly.

        At a kink of the exact law no gradient vanishes, so a gradient method cannot end there; the
        limit of the smoothed optima can, and is taken as the answer. An average of exact steps has
        kinks all over, and its own optimum by direct transcription is the plan instead.
        """
        if self.step.branches > 1:
            helper = self._helper(self.law, Direct())
            helper.values |= {name: self.values[name] for name in self.step.p.names}
        else:
            helper = self._helper(Barrier(mu=_MU_LAST), self.method)
        smooth = helper.solve(guess=guess, progress=follower.progress)
        result, source, finished = smooth.result, smooth.nlp, smooth.finished
        follower.trace.absorb(smooth.trace)
        settling = Homotopy(lambda _: direct, self.solver, self.values, follower.progress)
        direct = self.judging_nlp()
        landed = land(source, result.point.x, nlp, direct, settling, self.step)
        follower.trace.absorb(settling.trace)
        landed = replace(landed, status=result.status, word=result.word)
        return Outcome(landed, nlp, finished, follower.trace)

    def _helper(self, law: ContactLaw, method: Method) -> Session:
        """Return the session of the same problem under another law, at the same values."""
        key = f"{law.name} {method.name}"
        if key not in self.helpers:
            self.helpers[key] = Session(
                self.problem, law, method, self.policy, self.solver, compiled=self.compiled
            )
        helper = self.helpers[key]
        helper.values |= {name: self.values[name] for name in self.problem.parameters.names}
        return helper

    def judging_nlp(self) -> NLP:
        """Return the NLP in which an answer is judged: the one that was asked.

        Under the exact law that is the complementarity problem by direct transcription, whatever
        the method: only there do the pairs stand, and a kink of shooting is seen for what it is.
        """
        if not self.step.exact:
            return self.nlp_of("product")
        direct = self if isinstance(self.method, Direct) else self._helper(self.law, Direct())
        direct.values |= {name: self.values[name] for name in self.step.p.names}
        return direct.nlp_of("none")

    @property
    def total_build_s(self) -> float:
        """Seconds of set-up, of helping sessions too."""
        return self.build_s + sum(helper.total_build_s for helper in self.helpers.values())

    def _exact(self, follower: Homotopy, guess: tuple[np.ndarray, np.ndarray] | None) -> Outcome:
        if self.strategy not in STRATEGIES:
            raise InputError(
                f"unknown strategy {self.strategy!r}; there are {', '.join(STRATEGIES)}"
            )
        outcome = self._by_strategy(self.strategy, follower, guess)
        if outcome.finished or self.strategy != DEFAULT_STRATEGY:
            return outcome
        # Slower, but it keeps to the constraints where many pairs pull off the central path.
        second = self._by_strategy(AVERAGED_STRATEGY, follower, guess)
        return second if second.finished else outcome

    def _by_strategy(
        self, name: str, follower: Homotopy, guess: tuple[np.ndarray, np.ndarray] | None
    ) -> Outcome:
        strategy, reference = STRATEGIES[name](), self.problem.reference
        paths = strategy.paths(reference)
        source = self.nlp_of(paths[0].plan(paths[0].values[0]).form)
        result, source = self._along(follower, paths, self.first_point(source, guess), source)
        polished, nlp, worked = polish(follower, source, result, reference)
        if not worked and result.ok and isinstance(strategy, CentralPath):
            paths = strategy.further(reference)
            result, source = self._along(follower, paths, result.point, source, warm=True)
            polished, nlp, worked = polish(follower, source, result, reference)
        return Outcome(polished, nlp, worked, follower.trace)

    def _along(
        self, follower: Homotopy, paths: list[Path], point: Point, source: NLP, warm: bool = False
    ) -> tuple[Result, NLP]:
        """Follow paths one after the other, as far as they go."""
        result: Result | None = None
        for path in paths:
            first = self.nlp_of(path.plan(path.values[0]).form)
            usable = translate(point, source, first)
            result, source, finished = follower.follow(path, usable, warm or result is not None)
            if not finished:
                break
            point = result.point
        assert result is not None
        return result, source

    def _continue(self, follower: Homotopy, start: Point, source: NLP) -> Outcome:
        """One warm stage at the present values; for the exact law on a small relaxation first."""
        if not self.complementary:
            nlp = self.nlp_of("product")
            plan = Plan(self.step.law.name, 0.0, options={"mu_init": 1e-7})
            result = follower.stage(plan, nlp, translate(start, source, nlp), True)
            return Outcome(result, nlp, result.ok, follower.trace)
        nlp = self.nlp_of("product")
        t = 1e-6 * self.problem.reference.impulse * self.problem.reference.gap
        plan = Plan("t", t, contact=(-np.inf, t), options={"mu_init": max(t / 10, 1e-9)})
        result = follower.stage(plan, nlp, translate(start, source, nlp), True)
        if not result.ok:
            return Outcome(result, nlp, False, follower.trace)
        polished, end, worked = polish(follower, nlp, result, self.problem.reference)
        return Outcome(polished, end, worked, follower.trace)

    def resume(self, start: Point, progress: Progress | None = None) -> Outcome:
        """Solve at the present values from a point of the product NLP that came from elsewhere.

        :func:`~ocp.warm_start.carry` makes such points; unlike those of a continuation they need
        not be near. A second try therefore lets the solver's barrier parameter start high, and the
        exact law starts on a relaxation that is wide enough to exchange contacts.
        """
        follower = Homotopy(self.nlp_of, self.solver, self.values, progress)
        nlp, reference = self.nlp_of("product"), self.problem.reference
        keep = {} if start.lam_g is not None else PRIMAL
        if self.complementary:
            t = _WIDE * reference.impulse * reference.gap
            options = {**keep, "mu_init": max(t / 10, 1e-9)}
            result = follower.stage(
                Plan("t", t, contact=(-np.inf, t), options=options), nlp, start, True
            )
            if not result.ok:
                return Outcome(result, nlp, False, follower.trace)
            return Outcome(*polish(follower, nlp, result, reference), follower.trace)
        name, short = self.step.law.name, {"max_iter": _STAGE_ITERATIONS, **self.solver.options}
        result = follower.stage(
            Plan(name, 0.0, options={**keep, "mu_init": 1e-7, **short}), nlp, start, True
        )
        if not result.ok:
            high = Plan(name, 0.0, options={**keep, "mu_init": 1e-3})
            result = follower.stage(high, nlp, start, True)
        return Outcome(result, nlp, result.ok, follower.trace)

    def first_point(self, nlp: NLP, guess: tuple[np.ndarray, np.ndarray] | None = None) -> Point:
        """Write guessed trajectories into the NLP's variables, with contacts to match.

        Multipliers and gaps start on the central path of the homotopy's first mu, each gap at its
        contact-free value where that is open.
        """
        physical = np.array([self.values[name] for name in self.problem.parameters.names])
        X, U = guess if guess is not None else self.problem.initial_guess(physical)
        blocks: dict[str, np.ndarray] = {"x0": X[None, :1], "x": X[None, 1:], "u": U[None]}
        if isinstance(self.policy, Feedback):
            blocks["k"] = U[:1] if self.policy.stationary else U
        if "lam" in nlp.variables:
            mu = self.problem.reference.impulse * self.problem.reference.gap
            gap = np.maximum(self._free_gaps(X, U), np.sqrt(mu * self.problem.reference.gap))
            blocks["gap"], blocks["lam"] = gap[None], (mu / gap)[None]
        return Point(nlp.variables.pack({k: v for k, v in blocks.items() if k in nlp.variables}))

    def _free_gaps(self, X: np.ndarray, U: np.ndarray) -> np.ndarray:
        step = self.step
        values = np.array([self.values[name] for name in step.p.names])
        zeros = np.zeros((step.n, len(U)))
        _, gap, _ = step.relation.map(len(U))(X[:-1].T, U.T, X[1:].T, zeros, values)
        return np.array(gap).T
