"""``ocp.estimate``: gradient estimators of a named objective, or of a problem's rollouts."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from os import PathLike, fspath
from typing import Any

import casadi as ca
import numpy as np

from dynamics.batch import Gaussian, Moments, RolloutFunction, RolloutPolicy, affine, open_loop
from dynamics.contact import ContactLaw
from dynamics.systems import Signal
from ocp.distribution import load_plugin
from ocp.effort import check_memory, sampling_memory
from ocp.errors import InputError, input_errors
from ocp.factories import closing_law, policy_of
from ocp.gradients.estimation import Estimate, Sampling, run_sampling
from ocp.gradients.estimators import CHUNK, Rule
from ocp.gradients.objective import Bulk, CostSamples, Order, SampledObjective, without_warnings
from ocp.gradients.sampling import Progress
from ocp.policy import Feedback, OpenLoop, Policy
from ocp.problem import Problem


class RolloutObjective(SampledObjective):
    """Cost of a problem's rollout under a law, with noise added to the input of every step.

        V(theta, w) = sum_k l(x_k, u_k, du_k) + l_N(x_N),   u_k = pi(x_k, theta) + w_k

    (pathologies, eq. 1). ``theta`` holds the inputs of all steps, or the gains of every step as
    rows of K and then k (of one step where the feedback is stationary). Without a given ``theta``
    it is the problem's guess, with K = 0. Bounds on inputs do not clip: the estimators' theory is
    about the unclipped policy. With several scenarios sample i starts in scenario i modulo their
    number, so the mean over samples is the mean over scenarios too. ``parameters`` are those of the
    problem and the parameters of the law, ``contact.mu`` and the like.

    Raises ``ValueError`` where the law cannot close the system.
    """

    def __init__(
        self,
        problem: Problem,
        law: ContactLaw,
        policy: Policy | None = None,
        theta: np.ndarray | None = None,
        **engine: Any,
    ) -> None:
        policy = OpenLoop() if policy is None else policy
        self.problem, self.policy = problem, policy
        self.step = law.close(replace(problem.system, parameters=problem.parameters))
        self.name, self.n_noise = problem.name, problem.N * problem.system.nu
        # Shared by all copies that differ in values alone, so that nothing is compiled twice.
        self._compiled: list[RolloutFunction] = []
        self._engine = engine
        self.parameters = self.step.p.defaults
        shape = self._policy.shape(problem.N)
        self.theta = (
            self._guess(shape) if theta is None else np.asarray(theta, float).reshape(shape)
        ).ravel()
        self.decision = _decision(problem, policy, shape)

    def costs(self, noise: np.ndarray) -> np.ndarray:
        """Cost at given noise (n, N nu), in the order of steps."""
        n, system = len(noise), self.problem.system
        given = np.ascontiguousarray(noise.reshape(n, self.problem.N, system.nu))
        return self._rolled(n, 0, noise=given, gradient=False).cost

    def nominal(self) -> float:
        """Cost without noise, its mean over scenarios."""
        return float(self.costs(np.zeros((self.problem.scenarios.n, self.n_noise))).mean())

    def slope(self, theta: np.ndarray) -> tuple[float, np.ndarray]:
        """Mean cost over the scenarios, without noise, at ``theta``, and its gradient."""
        shaped = theta.reshape(self._policy.shape(self.problem.N))
        found = self._rolled(self.problem.scenarios.n, 0, theta=shaped)
        gradient = found.gradient.reshape(len(found.cost), -1)
        return float(found.cost.mean()), gradient.mean(axis=0)

    def scored(self, noise: Gaussian, n: int) -> CostSamples:
        """Costs and ``sum_t D_theta pi(x_t)' w_t / sigma^2``."""
        found = self._rolled(n, noise.first, noise=noise, gradient=False, score=True)
        return CostSamples(found.cost, found.score.reshape(n, -1))

    def differentiated(self, noise: Gaussian, n: int) -> CostSamples:
        """Costs and their exact gradients through contact."""
        found = self._rolled(n, noise.first, noise=noise)
        return CostSamples(found.cost, found.gradient.reshape(n, -1))

    def perturbed(self, noise: Gaussian, n: int) -> CostSamples:
        """Costs of policies with disturbed parameters, which act without noise."""
        d = len(self.theta)
        e = noise.draw(n, 1, d)[:, 0]
        theta = (self.theta + e).reshape(n, *self._policy.shape(self.problem.N))
        found = self._rolled(n, noise.first, theta=theta, gradient=False)
        acts = self._forward.acting[1].ravel()
        return CostSamples(found.cost, acts * e / noise.scales(d) ** 2)

    def moments(self, noise: Gaussian, n: int, order: Order, baseline: float = 0.0) -> Bulk | None:
        """Moments computed inside the kernel that rolls out and draws the noise."""
        found = without_warnings(
            self._forward.moments, **self._arguments(n, noise.first), noise=noise,
            gradient=order == "first", score=order == "zeroth", baseline=baseline,
        )  # fmt: skip
        part = {"cost": found.value, "zeroth": found.zeroth, "first": found.gradient}[order]
        flat = Moments(part.n, np.ravel(part.mean), np.ravel(part.m2))
        return flat, found.nonfinite.indices

    def _rolled(self, n: int, first: int, **how: Any) -> Any:
        return without_warnings(self._forward, **self._arguments(n, first) | how)

    def _arguments(self, n: int, first: int) -> dict[str, Any]:
        problem = self.problem
        physical = problem.parameters.pack(self.parameters)
        x0 = problem.initial_states(physical)
        rows = (first + np.arange(n)) % len(x0)
        call: dict[str, Any] = {
            "n_samples": n,
            "x0": x0[rows] if len(x0) > 1 else x0[0],
            "theta": self.theta.reshape(self._policy.shape(problem.N)),
            "p": self.values,
        }
        if problem.uses_du:
            call["u_before"] = np.array(problem.limits(physical)[1]).ravel()
        return call

    def _guess(self, shape: tuple[int, ...]) -> np.ndarray:
        physical = self.problem.parameters.pack(self.parameters)
        inputs = self.problem.initial_guess(physical)[1]
        if isinstance(self.policy, OpenLoop):
            return inputs
        theta = np.zeros(shape)
        theta[..., -self.problem.system.nu :] = inputs if self._policy.per_step else inputs[0]
        return theta

    @cached_property
    def _policy(self) -> RolloutPolicy:
        nx, nu = self.problem.system.nx, self.problem.system.nu
        if isinstance(self.policy, Feedback):
            return affine(nx, nu, per_step=not self.policy.stationary)
        return open_loop(nx, nu)

    @property
    def _forward(self) -> RolloutFunction:
        if not self._compiled:
            problem, p = self.problem, self.step.p.vector
            x, u = problem.system.x, problem.system.u
            extra = {} if problem.du is None else {"du": problem.du}
            extra |= {"lam": problem.system.lam} if problem.uses_impulses else {}
            given = {"x": x, "u": u, **extra, "p": p}
            stage = [_dense(problem.stage_cost)]
            costs: tuple[Callable[..., Any], ...] = (
                ca.Function("stage_cost", [*given.values()], stage, [*given], ["cost"]),
                ca.Function("terminal_cost", [x, p], [_dense(problem.terminal_cost)]),
            )
            made = RolloutFunction(self.step, *costs, problem.N, self._policy, **self._engine)
            self._compiled.append(made)
        return self._compiled[0]


def _dense(cost: ca.SX | float) -> ca.SX:
    return ca.densify(ca.SX(cost))


def _decision(problem: Problem, policy: Policy, shape: tuple[int, ...]) -> tuple[Signal, ...]:
    """Names of theta's components: ``u[3]``, or ``K[3].u.x`` and ``k[3].u``."""
    system = problem.system
    if isinstance(policy, OpenLoop):
        row = [(s.name, s.unit) for s in system.inputs]
        return tuple(Signal(f"{n}[{t}]", unit) for t in range(shape[0]) for n, unit in row)
    gains = [
        (f".{u.name}.{x.name}", f"{u.unit}/({x.unit})")
        for u in system.inputs
        for x in system.states
    ]
    offsets = [(f".{u.name}", u.unit) for u in system.inputs]
    steps = [f"[{t}]" for t in range(shape[0])] if len(shape) == 2 else [""]
    return tuple(
        Signal(f"{head}{step}{tail}", unit)
        for step in steps
        for head, row in (("K", gains), ("k", offsets))
        for tail, unit in row
    )


SIGMA_SHARE = 0.1
"""Default noise on a problem's inputs, as a share of their characteristic size."""
SIGMA_RATIO = 1e9
"""Largest ratio of noise to default noise: beyond it, rounding hides one size behind the other."""


@dataclass(frozen=True)
class NamedObjective:
    """An objective, all its parameters, and the noise ``sigma`` where none is chosen.

    ``usual`` is the noise that the limits of :meth:`check_sigma` are relative to.
    """

    objective: SampledObjective
    params: dict[str, Any]
    sigma: float
    usual: float

    def check_sigma(self, values: Iterable[float]) -> None:
        """Raise InputError for noise so small or large that rounding hides its effect."""
        low, high = self.usual / SIGMA_RATIO, self.usual * SIGMA_RATIO
        for value in values:
            if not low <= value <= high:
                raise InputError(
                    f"sigma of {self.objective.name} must be from {low:.3g} to {high:.3g} (beyond,"
                    f" rounding errors dominate), got {value:g}"
                )


def static_objective(spec: Any, params: Mapping[str, Any], **engine: Any) -> NamedObjective:
    """Build an objective without dynamics; its parameter ``sigma`` is the default noise."""
    values = spec.params(params).model_dump()
    usual = float(spec.Params.model_fields["sigma"].default)
    return NamedObjective(spec.objective(params, **engine), values, float(values["sigma"]), usual)


def rollout_objective(
    spec: Any,
    params: Mapping[str, Any],
    contact: ContactLaw | str = "barrier",
    contact_settings: Mapping[str, Any] | None = None,
    policy: Policy | str = "open-loop",
    policy_settings: Mapping[str, Any] | None = None,
    theta: np.ndarray | None = None,
    **engine: Any,
) -> NamedObjective:
    """Build a problem's rollouts; the default noise is a tenth of the inputs' largest scale.

    Raises :class:`~ocp.errors.InputError` for a law that cannot close the system, for a policy
    setting other than ``stationary``, and where the decision needs more memory than there is.
    """
    values, problem = spec.params(params).model_dump(), spec.problem(params)
    law = closing_law(contact, contact_settings or {}, problem.system)
    own = policy_settings or {}
    chosen = policy_of(policy, own)
    if unused := own.keys() - {"stationary"}:
        raise InputError(
            f"-s policy.{min(unused)} has no effect: an estimate has no gains to limit; drop it"
        )
    per_step = problem.system.nu * (1 if chosen.name == "open-loop" else problem.system.nx + 1)
    needed = sampling_memory(float(problem.N) * per_step, CHUNK)
    check_memory(f"{spec.name} with N = {problem.N}", needed)
    expected = problem.N * per_step if not own.get("stationary") else None
    if theta is not None and expected is not None and theta.size != expected:
        raise InputError(
            f"the decision has {theta.size} variables, {spec.name} needs {expected}; give the"
            " parameters of the run that it is from"
        )
    with input_errors():
        objective = RolloutObjective(problem, law, chosen, theta, **engine)
    sigma = SIGMA_SHARE * float(problem.scales.u.max())
    known = spec.Params.model_fields.get("sigma")
    return NamedObjective(objective, values, sigma, known.default if known else sigma)


def estimate(
    problem: str | PathLike[str],
    estimators: Sequence[str] = ("zobg", "fobg", "alpha"),
    samples: int = 100_000,
    sigma: float | None = None,
    *,
    params: Mapping[str, Any] | None = None,
    contact: ContactLaw | str = "barrier",
    contact_settings: Mapping[str, Any] | None = None,
    policy: Policy | str = "open-loop",
    policy_settings: Mapping[str, Any] | None = None,
    theta: np.ndarray | None = None,
    seed: int = 0,
    reference: str = "auto",
    reference_samples: int | None = None,
    rules: Sequence[Rule] = (),
    progress: Progress | None = None,
    **engine: Any,
) -> dict[str, Estimate]:
    """Estimate a gradient as ``ocp estimate`` does::

        estimate("heaviside", samples=10_000, params={"theta": 0.5})["fobg"].verdict

    ``problem`` is an objective's or a problem's name, or the path of a problem's file. Without
    ``sigma`` the noise is the objective's own, or a tenth of the inputs' largest scale.
    ``theta`` are inputs or gains of all steps, by default the problem's guess; ``engine`` takes
    ``backend`` and ``threads``. Everything else is as in :class:`Sampling` and
    :func:`ocp.solve`.

    Raises :class:`~ocp.errors.InputError` for unknown names, parameters out of range, and noise
    beyond 1e9 times or below 1e-9 times the default.
    """
    spec, given = load_plugin("problems").named(fspath(problem)), dict(params or {})
    if hasattr(spec, "objective"):
        named = static_objective(spec, given, **engine)
    else:
        named = rollout_objective(
            spec, given, contact, contact_settings, policy, policy_settings, theta, **engine
        )
    noise = named.sigma if sigma is None else sigma
    sampling = Sampling(
        tuple(estimators), samples, noise, seed, rules, reference, reference_samples
    )
    named.check_sigma([noise])
    # The streams of the first point of ocp estimate, so that both print the same numbers.
    streams = np.random.SeedSequence(seed, spawn_key=(0,))
    return run_sampling(sampling, named.objective, streams, progress)
