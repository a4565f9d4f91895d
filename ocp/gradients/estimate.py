"""``ocp.estimate``: gradient estimators of a named objective or problem."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike, fspath
from typing import Any

import numpy as np

from dynamics.contact import ContactLaw
from ocp.distribution import load_plugin
from ocp.effort import check_memory, sampling_memory
from ocp.errors import InputError, input_errors
from ocp.factories import closing_law, policy_of
from ocp.gradients.estimation import Estimate, Sampling, run_sampling
from ocp.gradients.estimators import CHUNK, Rule
from ocp.gradients.objective import SampledObjective
from ocp.gradients.rollout_objective import RolloutObjective
from ocp.gradients.sampling import Progress
from ocp.policy import Policy

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
