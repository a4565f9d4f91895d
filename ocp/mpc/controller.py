"""A receding-horizon controller, built once and then asked at every sample."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated, Any

import casadi as ca
import numpy as np
from pydantic import Field, InstanceOf

from dynamics.contact import ContactLaw, Exact
from ocp.errors import InputError, choose
from ocp.mpc.full_phase import Full
from ocp.mpc.measurement import Measurement
from ocp.mpc.newton_phase import NewtonPhase
from ocp.mpc.phase import Answer, Phase, Sample, numbers
from ocp.mpc.phases import NEWTON, PHASES
from ocp.mpc.policy_phase import FixedPolicy, Law
from ocp.mpc.receding import Receding, Values, horizon_rows
from ocp.mpc.rollouts import Roller
from ocp.mpc.stages import Plan, StageModel
from ocp.problem.policy import OpenLoop
from ocp.problem.problem import Problem
from ocp.problem.rollout import Gains
from ocp.routes.session import Session
from ocp.transcription import Direct
from ocp.transcription.factories import closing_law
from ocp.transcription.nlp import StageCompiler, trajectories
from ocp.validation import Count, Positive, validated

_WARM_UP = 30
"""Programs at most before the first answer, which starts from another law's or state's plan."""


@dataclass(frozen=True)
class Command:
    """What a controller answers: the input, the plan behind it, and how it came about.

    ``status`` is ``solved``, ``plan before`` (no step improved on the shifted plan), ``kept`` (no
    new plan could be made; the shifted one goes on) or ``late`` (the deadline was missed and the
    shifted plan's input is sent); ``why`` says what was not as usual, in sentences. ``seconds`` is
    the whole work of the sample, preparation and feedback. ``merit`` is the plan's cost, with the
    penalty of violated constraints.
    """

    u: np.ndarray
    plan: Plan | None
    status: str
    seconds: float
    why: str = ""
    merit: float = np.nan


@dataclass
class Controller:
    """Answer each measured state with an input, by a plan that recedes with the horizon.

        controller = Controller(problems.get("soft-walls"))
        command = controller.step(x, u_before)

    ``contact``, a law or its name, closes the contact of the plans: the exact one, or for the phase
    ``relaxed`` a smoothed one. ``phase`` is one of :data:`~ocp.mpc.phases.PHASES`;
    ``policy`` is what the phase ``policy`` evaluates: a function ``(x, k) -> u``,
    :class:`~ocp.problem.rollout.Gains`, or None for the regulator's gains along the first plan.
    ``iterations`` is the number of quadratic programs a sample. ``trust``, of (0, 1], is how much
    of a measurement's difference from the state that the law predicts from the sample before is
    believed: below 1 it averages noise out, as an observer of constant gain does. ``deadline`` (s)
    is optional: an answer that comes later is replaced by the shifted plan's input, and counted in
    ``misses``. ``told`` are sentences on what a receding horizon had to change of the problem.

    Everything symbolic happens here, and functions are compiled once and cached. Measured state,
    last input, parameters and the law's mu are parameters of the one program.

    Raises :class:`~ocp.errors.InputError` for an unknown phase, a law that the phase cannot use,
    numbers out of their range, and a problem whose step size is free.
    """

    problem: Problem
    contact: ContactLaw | str | None = None
    phase: str = "qpcc"
    policy: Law | Gains | None = None
    iterations: int = 1
    trust: float = 1.0
    deadline: float | None = None
    parameters: Values = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._check()
        self.receding = Receding.of(self.problem)
        self.told = list(self.receding.told)
        planned = self.receding.problem
        exact = isinstance(self.law, Exact)
        self._softer = NEWTON["qpcc" if exact else "relaxed"]
        self.session = Session(planned, self.law, Direct(), OpenLoop(), compiled=StageCompiler())
        self.model = StageModel(planned, planned.exact_step if exact else self.session.step)
        self.roller = Roller(self.model)
        if self.model.backend != "c":
            self.told.append(f"There is no C compiler: steps are evaluated by {self.model.backend}.")
        self._base = np.array([self.session.values[name] for name in self.model.names])
        step = self.model.step
        dynamics = ca.vertcat(step.residual, step.gap, step.mu)
        self._dynamics = {n for n in step.p.names if ca.depends_on(dynamics, step.p[n])}
        places = [self.model.names.index(name) for name in self.receding.added]
        self._places, self._last = np.array(places), ({}, *self._asked({}))
        p, limits = self._last[1:]
        self.start, self._u_start = limits[:2]
        self.measurement = Measurement(planned)
        self._first = self._first_plan(p)
        self._regulated = self._regulator(p) if self.phase == "policy" and not self.policy else None
        self.reset()

    def _check(self) -> None:
        """Read the arguments, with one sentence for what is wrong."""
        entry = choose("phase", validated("phase", self.phase, str), PHASES)
        law = validated("contact", self.contact, InstanceOf[ContactLaw] | str | None)
        law = closing_law(law, {}, self.problem.system) if isinstance(law, str) else law
        self.law: ContactLaw = entry.law(law)
        self.iterations = validated("iterations", self.iterations, Count)
        self.trust = validated("trust", self.trust, Annotated[Positive, Field(le=1)])
        self.deadline = validated("deadline", self.deadline, Positive | None)
        if self.policy is not None and self.phase != "policy":
            raise InputError(f'a policy is for the phase "policy", not for {self.phase}')
        validated("policy", self.policy, InstanceOf[Gains] | Callable[..., Any] | None)

    def reset(self) -> None:
        """Start again from the first plan, as if no sample had been answered."""
        self.plan, self.u_before = self._first, self._u_start
        self.misses, self.samples = 0, 0
        self._phase = self._built()

    def _asked(self, values: Values) -> tuple[np.ndarray, list[np.ndarray]]:
        """Parameters (N+1, np), and the problem's limits at them."""
        values = {**self.parameters, **values}
        p = horizon_rows(self.receding, self.model.names, self._base, values, self._dynamics)
        limits = self.receding.problem.limits(p[0, self.model.of_problem])
        return p, [np.array(v).ravel() for v in limits]

    def _first_plan(self, p: np.ndarray) -> Plan:
        """Solve the problem once, from its own start; a given policy needs no plan."""
        if self.phase == "policy" and self.policy:
            x, u = self.receding.problem.initial_guess(p[0, self.model.of_problem])
            none = np.zeros((self.model.N, self.model.n))
            return Plan(np.asarray(x), np.asarray(u), none, none)
        self.session.values |= dict(zip(self.model.names, p[0], strict=True))
        self._solved = self.session.solve()
        nlp, result = self._solved.nlp, self._solved.result
        if not result.ok:
            self.told.append(f"The first plan did not converge: {result.status.value}.")
        found = trajectories(nlp, result, nlp.parameter_vector(self.session.values))
        return Plan(found.x[0], found.u[0], found.lam[0], found.gap[0])

    def _built(self) -> Phase:
        if self.phase == "full":
            softer = self._softer(self.model, self.roller, _WARM_UP)
            return Full(self.session, self.model, self._solved, softer)
        if self.phase != "policy":
            return NEWTON[self.phase](self.model, self.roller, self.iterations)
        if callable(self.policy):
            return FixedPolicy(self.policy, self.model.nu)
        gains = self.policy or self._regulated
        assert gains is not None
        return FixedPolicy(lambda x, k: gains.input(k, x), self.model.nu)

    def _regulator(self, p: np.ndarray) -> Gains:
        """Gains of the linear-quadratic regulator along the first plan, its contacts held."""
        limits, plan = self._last[2], self._first
        phase = self._softer(self.model, self.roller)
        phase.prepare(plan, Sample(limits[0], limits[1], p, (limits[2], limits[3])))
        assert phase.prepared is not None
        K = phase.regulator.gains(phase.prepared.lin)
        return Gains(K, plan.u - np.einsum("kij,kj->ki", K, plan.x[:-1]))

    @property
    def physical(self) -> np.ndarray:
        """The problem's own parameters (np,) at the sample that was answered last."""
        return self._p[0, self.model.of_problem][: len(self.problem.parameters)]

    @property
    def values_of_sample(self) -> dict[str, float]:
        """All values of the sample that was answered last, by name."""
        return dict(zip(self.model.names, self._p[0], strict=True))

    def step(self, x: np.ndarray, u_before: np.ndarray | None = None, parameters: Values | None = None) -> Command:
        """The input for a measured state ``x`` (nx,).

        ``u_before`` (nu,) is the input that was applied last, by default the one commanded;
        ``parameters`` are values by name, numbers or, for parameters of the cost and constraints,
        arrays over the horizon (N,) or (N+1,).

        A state that is not finite is replaced by the plan's prediction, one in penetration is moved
        out, one outside its bounds is planned from as it is; ``why`` says so. Raises
        :class:`~ocp.errors.InputError` for arrays of another shape and unknown parameters.
        """
        began = time.perf_counter()
        if parameters or self._last[0]:
            self._last = (parameters or {}, *self._asked(parameters or {}))
        p, limits = self._last[1].copy(), self._last[2]
        x, before = numbers("the state", np.ravel(x), (self.model.nx,)), self.u_before
        if u_before is not None:
            given = numbers("the last input", np.ravel(u_before), (self.model.nu,))
            before = np.where(np.isfinite(given), given, before)
        ahead = self._ahead(p, limits)
        expected = self._expected(ahead, before, p)
        if self.trust < 1 and self.samples:
            x = expected + self.trust * (x - expected)
        seen, told = self.measurement.projected(x, expected, limits[4:], p[0, self.model.of_problem])
        if u_before is not None and not np.isfinite(u_before).all():
            told.append("the last input is not finite; the one commanded is used there")
        self._seen = seen
        p[:, self._places] = np.concatenate([seen, before])
        self._p = p
        sample = Sample(seen, before, p, (limits[2], limits[3]))
        self._phase.prepare(ahead, sample)
        answer = self._warm(sample) if self.samples == 0 else self._phase.feedback(sample)
        u, status, why = answer.u, answer.status, [*told, *([answer.why] if answer.why else [])]
        seconds = time.perf_counter() - began
        if self.deadline is not None and seconds > self.deadline and self.samples:
            self.misses += 1
            u, status = np.clip(ahead.u[0], *sample.bounds), "late"
        if answer.plan is not None:
            self.plan = answer.plan
        self.u_before, self.samples = u, self.samples + 1
        return Command(u, answer.plan, status, seconds, "; ".join(why), answer.merit)

    def _ahead(self, p: np.ndarray, limits: list[np.ndarray]) -> Plan:
        """The plan one step later, its last step by the last gains; itself before any sample."""
        plan = self.plan
        if self.samples == 0 or self.phase == "policy":
            return plan
        u_last = self._tail(plan, limits)
        last = self.roller.ahead(plan.x[-1:], u_last, p)
        last = last if np.isfinite(last).all() else plan.x[-1:]
        x = np.concatenate([plan.x[1:], last])
        u = np.concatenate([plan.u[1:], u_last])
        lam, gap = (np.concatenate([v[1:], v[-1:]]) for v in (plan.lam, plan.gap))
        return Plan(x, u, lam, gap)

    def _expected(self, ahead: Plan, u_before: np.ndarray, p: np.ndarray) -> np.ndarray:
        """The state that the law predicts from the sample before, or that of the first plan."""
        if not self.samples or (self.trust == 1 and self.phase != "policy"):
            return ahead.x[0]
        found = self.roller.ahead(self._seen[None], u_before[None], p)[0]
        return found if np.isfinite(found).all() else self._seen

    def _tail(self, plan: Plan, limits: list[np.ndarray]) -> np.ndarray:
        """The input of the step that the horizon gains: the last gains go on."""
        if not isinstance(self._phase, NewtonPhase):
            return plan.u[-1:]
        moved = self._phase.gain @ (plan.x[-1] - plan.x[-2])
        return np.clip(plan.u[-1:] + moved, limits[2], limits[3])

    def _warm(self, sample: Sample) -> Answer:
        """The first answer, by as many programs as it takes."""
        answer = self._phase.feedback(sample)
        for _ in range(_WARM_UP):
            if self.phase not in NEWTON or answer.plan is None or answer.status == "kept":
                break
            self._phase.prepare(answer.plan, sample)
            found = self._phase.feedback(sample)
            if not found.merit < answer.merit - 1e-6 * abs(answer.merit):
                break
            answer = found
        return answer
