"""Receding-horizon controller, which is built once and then evaluated at every sample."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from pydantic import InstanceOf

from dynamics.contact import ContactLaw, Exact
from dynamics.limits import QP_BUDGET, QP_ITERATIONS, TRUST
from dynamics.settings import read_value
from ocp.errors import InputError, choose
from ocp.judge.step_size import step_size_kind
from ocp.mpc.measurement import Measurement
from ocp.mpc.newton_phase import NewtonPhase
from ocp.mpc.phase import Law, Sample, numbers
from ocp.mpc.phases import PHASES, PhaseParts, soft_phase
from ocp.mpc.rates import gains_along, interpolate_plan, samples_per_step
from ocp.mpc.receding import Receding, Values, horizon_rows
from ocp.mpc.rollouts import CandidateRollouts
from ocp.mpc.stages import Plan, StageModel
from ocp.mpc.tracking import TrackedPlan, read_plan
from ocp.problem.policy import OpenLoop
from ocp.problem.problem import Problem
from ocp.problem.rollout import Gains
from ocp.routes.homotopy import RouteResult
from ocp.routes.session import Session
from ocp.transcription import Direct
from ocp.transcription.factories import make_law
from ocp.transcription.nlp import StageCompiler, trajectories
from ocp.validation import Positive, validated


@dataclass(frozen=True)
class Command:
    """Output of a controller at one sample: the input ``u`` (nu,), the plan with this input, and a status.

    ``status`` is ``solved``; ``not improved`` (the shifted plan is better than all steps of the program);
    ``kept`` (no new plan could be computed, and the shifted plan is used); or ``late`` (the deadline was
    missed, and the input of the shifted plan is used). ``note`` describes anything unusual in sentences.
    ``seconds`` is the computing time [s] of preparation and feedback. ``merit`` is the plan's cost plus the
    penalty of violated constraints. ``programs`` is the number of quadratic programs that were solved, and
    ``qp_iterations`` the number of their iterations.
    """

    u: np.ndarray
    plan: Plan | None
    status: str
    seconds: float
    note: str = ""
    merit: float = np.nan
    programs: int = 0
    qp_iterations: int = 0


@dataclass
class Controller:
    """Receding-horizon controller, which computes a plan at every sample and applies its first input.

        controller = Controller(problems.get("soft-walls"))
        command = controller.step(x, u_before)

    ``contact`` is the contact law of the plans, or its name: the exact law, or a smoothed law for the phase
    ``relaxed``. ``phase`` is a name in :data:`~ocp.mpc.phases.PHASES`. ``policy`` is used only by the phase
    ``policy``: a function ``(x, k) -> u``, :class:`~ocp.problem.rollout.Gains`, or None for the gains of a
    linear-quadratic regulator along the first plan. ``iterations`` is the number of quadratic programs per
    sample. ``budget`` is the maximum number of iterations of these programs per sample (None: no limit): further
    programs are omitted once it is spent, and the last iterate of an unfinished program is used only if its
    rollout is better. So the worst case of a sample is bounded by a count. ``trust`` in (0, 1] is the weight of
    a measurement relative to the state that the law predicts from the previous sample; a value below 1 averages
    out noise, like an observer with constant gain. If the optional ``deadline`` [s] is exceeded, the input of
    the shifted plan is applied instead, and ``misses`` is increased. ``notes`` are sentences on how the problem
    was changed for the receding horizon.

    ``plan`` is a solution or a stored run to be tracked: it is the first plan, and the horizon shrinks as samples
    pass, so that it ends where the stored plan ends. ``samples_left`` samples remain until then.

    ``rate`` [Hz] is the rate of samples, by default one per step h of the plans. With ``r = rate h`` samples per
    step, a sample starts from the better of two plans: that of the last whole step and that of the last sample, both
    shifted by the time since then and interpolated. Changes of the input are counted from the input r samples
    before. A user's ``policy`` gets the number of the plan's step.

    All symbolic work is done on construction, and functions are compiled once and cached. The measured state,
    the last input, the problem's parameters and the law's mu are parameters of a single program.

    Raises :class:`~ocp.errors.InputError` for an unknown phase, a law that the phase cannot use,
    numbers out of range, a problem with a free step size, a plan of another size, and a rate that is no multiple
    of 1 / h.
    """

    problem: Problem
    contact: ContactLaw | str | None = None
    phase: str = "qpcc"
    policy: Law | Gains | None = None
    iterations: int = 1
    trust: float = 1.0
    deadline: float | None = None
    budget: int | None = None
    parameters: Values = field(default_factory=dict)
    plan: TrackedPlan | None = None
    rate: float | None = None

    def __post_init__(self) -> None:
        self._check()
        self.receding = Receding.of(self.problem)
        self.notes = list(self.receding.notes)
        planned = self.receding.problem
        exact = isinstance(self.law, Exact)
        self.session = Session(planned, self.law, Direct(), OpenLoop(), compiled=StageCompiler())
        self.model = StageModel(planned, planned.exact_step if exact else self.session.step)
        self.rollouts = CandidateRollouts(self.model)
        if self.model.backend != "c":
            self.notes.append(f"There is no C compiler: steps are evaluated by {self.model.backend}.")
        self._base = np.array([self.session.values[name] for name in self.model.names])
        step = self.model.step
        dynamics = ca.vertcat(step.residual, step.gap, step.mu)
        self._dynamics = {n for n in step.p.names if ca.depends_on(dynamics, step.p[n])}
        first = self.model.names.index(self.receding.added[0])
        self._measured_columns = slice(first, first + len(self.receding.added))
        limits = planned.limits
        sparsities = [limits.jac_sparsity(i, 0) for i in range(2, limits.n_out())]
        self._limiting = np.unique([column for sparsity in sparsities for column in sparsity.get_col()]).astype(int)
        self._limits: tuple[np.ndarray, list[np.ndarray]] | None = None
        self._horizon = ({}, *self._evaluate_parameters({}))
        p, values = self._horizon[1:]
        self.start, self._u_start = values[:2]
        self.measurement = Measurement(self.model)
        solved, self._first = self._first_plan(p)
        parts = PhaseParts(self.session, self.model, self.rollouts, exact, self.iterations, self.budget, solved)
        self._law = None if self._entry.plans else self._feedback_law(p)
        self._build_phase = lambda: self._entry.build(parts, self._law)
        self.reset()

    def _check(self) -> None:
        """Check the controller's arguments, and replace the names of phase and law by the objects."""
        self._entry = choose("phase", validated("phase", self.phase, str), PHASES)
        law = validated("contact", self.contact, InstanceOf[ContactLaw] | str | None)
        law = make_law(law, {}, self.problem.system) if isinstance(law, str) else law
        self.law: ContactLaw = self._entry.law(law)
        self.iterations = read_value("iterations", self.iterations, int, **QP_ITERATIONS)
        if self.budget is not None:
            self.budget = read_value("budget", self.budget, int, **QP_BUDGET)
        self.trust = read_value("trust", self.trust, float, **TRUST)
        self.deadline = validated("deadline", self.deadline, Positive | None)
        self.rate = validated("rate", self.rate, Positive | None)
        self.samples_per_step = samples_per_step(self.problem, self.rate, self.parameters)
        if self.phase == "full" and (self.plan is not None or self.samples_per_step > 1):
            raise InputError(
                "phase full plans whole steps of the whole horizon; for a stored plan or a rate above 1 / h"
                " choose qpcc, qp, relaxed or policy"
            )
        if self.policy is not None and self._entry.plans:
            raise InputError(f'a policy is for the phase "policy", not for {self.phase}')
        validated("policy", self.policy, InstanceOf[Gains] | Callable[..., Any] | None)

    def reset(self) -> None:
        """Reset the controller to its state before the first sample, with the first plan."""
        self.current_plan, self._step_plan, self.u_before = self._first, self._first, self._u_start
        self._inputs = deque([self._u_start] * self.samples_per_step, self.samples_per_step)
        self.misses, self.samples = 0, 0
        self._phase = self._build_phase()

    def _evaluate_parameters(self, values: Values) -> tuple[np.ndarray, list[np.ndarray]]:
        """Return the parameters over the horizon (N+1, np), and the resulting start, last input and bounds."""
        values = {**self.parameters, **values}
        p = horizon_rows(self.receding, self.model.names, self._base, values, self._dynamics)
        physical = p[0, self.model.of_problem]
        if self._limits is None or (physical != self._limits[0])[self._limiting].any():
            self._limits = physical, [np.array(v).ravel() for v in self.receding.problem.limits(physical)]
        return p, self._limits[1]

    def _first_plan(self, p: np.ndarray) -> tuple[RouteResult | None, Plan]:
        """Return the stored plan, the unsolved guess with a user's policy, or solve from the problem's start."""
        if self.plan is not None:
            plan = read_plan(self.model, self.plan)
            self.start = plan.x[0]
            return None, plan
        if self.policy is not None:
            x, u = self.receding.problem.initial_guess(p[0, self.model.of_problem])
            zeros = np.zeros((self.model.N, self.model.n))
            return None, Plan(np.asarray(x), np.asarray(u), zeros, zeros)
        self.session.values |= dict(zip(self.model.names, p[0], strict=True))
        solved = self.session.solve()
        nlp, result = solved.nlp, solved.result
        if not result.ok:
            self.notes.append(f"The first plan did not converge: {result.status.value}.")
        solution = trajectories(nlp, result, nlp.parameter_vector(self.session.values))
        return solved, Plan(solution.x[0], solution.u[0], solution.lam[0], solution.gap[0])

    def _feedback_law(self, p: np.ndarray) -> Law | Gains:
        """Return the law of the phase without plans, whose gains have one row per sample."""
        policy, r = self.policy, self.samples_per_step
        if policy is None:
            limits = self._horizon[2]
            gains = self._regulator(self._first, Sample(limits[0], limits[1], p, (limits[2], limits[3])))
            if gains is None:
                raise InputError("a step of the plan has no linearisation, and so no regulator; choose another phase")
            return gains
        if isinstance(policy, Gains):
            return Gains(np.repeat(policy.K, r, axis=0), np.repeat(policy.k, r, axis=0))
        return lambda x, k: policy(x, k // r)

    @cached_property
    def _regulating(self) -> NewtonPhase:
        """Phase that linearises a plan for its regulator, apart from the phase whose next program has exchanges."""
        return soft_phase(self.model, self.rollouts, isinstance(self.law, Exact))

    def _regulator(self, plan: Plan, sample: Sample) -> Gains | None:
        """Return gains of the linear-quadratic regulator along a plan, with its active set fixed; None without one."""
        phase = self._regulating
        phase.prepare(plan, sample)
        return gains_along(plan, phase.gains, self.samples_per_step) if phase.is_prepared else None

    @property
    def gains(self) -> Gains | None:
        """Gains of the phase ``policy``, or of the regulator along the last plan, with one row per sample.

        They are None for a policy that is a function, for a plan without linearisation, and before the first plan.
        """
        if not self._phase.plans:
            return self._law if isinstance(self._law, Gains) else None
        return self._regulator(self.current_plan, self._sample) if self.samples else None

    @property
    def samples_left(self) -> int | None:
        """Number of samples until the end of the tracked plan; None without one."""
        return None if self.plan is None else self.model.N * self.samples_per_step - self.samples

    @property
    def physical(self) -> np.ndarray:
        """Values (np,) of the problem's physical parameters at the last sample."""
        return self._p[0, self.model.of_problem][: len(self.problem.parameters)]

    @property
    def values_of_sample(self) -> dict[str, float]:
        """Mapping from names to values of all parameters at the last sample."""
        return dict(zip(self.model.names, self._p[0], strict=True))

    def step(self, x: np.ndarray, u_before: np.ndarray | None = None, parameters: Values | None = None) -> Command:
        """Return the input for a measured state ``x`` (nx,).

        ``u_before`` (nu,) is the input that was applied last (default: the last command).
        ``parameters`` is a mapping from names to numbers or, for parameters of the cost and constraints,
        to arrays over the horizon (N,) or (N+1,).

        Entries of the state that are not finite are replaced by predictions, and a penetrating state is moved
        out of contact; a state outside its bounds is used unchanged. The command's ``note`` mentions each of
        these changes. Raises :class:`~ocp.errors.InputError` for arrays of another shape, unknown parameters, and
        samples after the end of a tracked plan.
        """
        start_time = time.perf_counter()
        if self.samples_left == 0:
            raise InputError(f"the plan ends after {self.samples} samples; reset the controller")
        if parameters or self._horizon[0]:
            self._horizon = (parameters or {}, *self._evaluate_parameters(parameters or {}))
        p, limits = self._horizon[1].copy(), self._horizon[2]
        x = numbers("the state", np.ravel(x), (self.model.nx,))
        self._inputs[-1] = last_input = self._applied_input(u_before)
        starts = self._shifted_plans(p, limits)
        shifted = starts[0]
        p = p[: len(shifted.u) + 1]
        expected = self._expected_state(shifted, last_input, p)
        if self.trust < 1 and self.samples:
            x = expected + self.trust * (x - expected)
        physical, phase = p[0, self.model.of_problem], self._phase
        state, notes = self.measurement.project(x, expected, limits[4:], physical, phase.compiled)
        if u_before is not None and not np.isfinite(u_before).all():
            notes.append("the last input is not finite; the one commanded is used there")
        self._state = state
        p[:, self._measured_columns] = np.concatenate([state, self._inputs[0]])
        self._p = p
        shift = int(self.samples % self.samples_per_step == 0)
        self._sample = sample = Sample(state, self._inputs[0], p, (limits[2], limits[3]), shift)
        phase.prepare_best(starts, sample)
        answer = phase.warm_up(sample) if self.samples == 0 else phase.feedback(sample)
        u, status = answer.u, answer.status
        seconds = time.perf_counter() - start_time
        if self.deadline is not None and seconds > self.deadline and self.samples:
            self.misses += 1
            u, status = np.clip(shifted.u[0], *sample.bounds), "late"
        if answer.plan is not None:
            self.current_plan = answer.plan
        self.u_before, self.samples = u, self.samples + 1
        self._inputs.append(u)
        note = "; ".join(filter(None, [*notes, answer.note]))
        return Command(u, answer.plan, status, seconds, note, answer.merit, phase.programs, phase.qp_iterations)

    def _applied_input(self, u_before: np.ndarray | None) -> np.ndarray:
        """Return the input (nu,) that was applied last, with the commanded entries where it is not finite."""
        if u_before is None:
            return self.u_before
        applied = numbers("the last input", np.ravel(u_before), (self.model.nu,))
        return np.where(np.isfinite(applied), applied, self.u_before)

    def _shifted_plans(self, p: np.ndarray, limits: list[np.ndarray]) -> list[Plan]:
        """Return the plans from which a sample may start; at the first sample, the first plan.

        The first one is the plan of the last whole step, the second one that of the last sample. Both are shifted by
        the time since then, and interpolated.
        """
        plan, r = self.current_plan, self.samples_per_step
        if self.samples == 0 or not self._phase.plans:
            return [plan]
        since_step = self.samples % r or r
        if since_step == 1:
            self._step_plan = plan
        pairs = ((self._step_plan, since_step / r), (plan, 1 / r))
        return [self._shifted_plan(*pair, p, limits) for pair in pairs[: 1 + (since_step > 1)]]

    def _shifted_plan(self, plan: Plan, share: float, p: np.ndarray, limits: list[np.ndarray]) -> Plan:
        """Return a plan shifted by a share of a step, and extended, or shortened at each step of a tracked plan."""
        if self.plan is None:
            return interpolate_plan(plan, self._extended_plan(plan, p, limits), share)
        held = Plan(*(np.concatenate([v[1:], v[-1:]]) for v in (plan.x, plan.u, plan.lam, plan.gap)))
        shifted = interpolate_plan(plan, held, share)
        last = -1 if self.samples % self.samples_per_step == 0 else None
        return Plan(*(v[:last] for v in (shifted.x, shifted.u, shifted.lam, shifted.gap)))

    def _extended_plan(self, plan: Plan, p: np.ndarray, limits: list[np.ndarray]) -> Plan:
        """Return the plan shifted by one step and extended by the phase's gain."""
        if self._phase.compiled is not None:
            return self._phase.compiled.extended(plan, p, (limits[2], limits[3]))
        u_last = plan.u[-1:]
        if self._phase.gain is not None:
            u_last = np.clip(u_last + self._phase.gain @ (plan.x[-1] - plan.x[-2]), limits[2], limits[3])
        x_last = self.rollouts.step(plan.x[-1:], u_last, p)
        x_last = x_last if np.isfinite(x_last).all() else plan.x[-1:]
        x = np.concatenate([plan.x[1:], x_last])
        u = np.concatenate([plan.u[1:], u_last])
        lam, gap = (np.concatenate([v[1:], v[-1:]]) for v in (plan.lam, plan.gap))
        return Plan(x, u, lam, gap)

    def _expected_state(self, shifted: Plan, u_before: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Return the expected state (nx,): the law's prediction if ``trust < 1`` or without plans, else the plan's."""
        if not self.samples or (self.trust == 1 and self._phase.plans):
            return shifted.x[0]
        if self.samples_per_step > 1:
            p = p.copy()
            p[:, self.model.names.index(step_size_kind(self.problem.system).parameter)] /= self.samples_per_step
        if self._phase.compiled is not None:
            return self._phase.compiled.step(self._state, u_before, p)
        predicted = self.rollouts.step(self._state[None], u_before[None], p)[0]
        return predicted if np.isfinite(predicted).all() else self._state
