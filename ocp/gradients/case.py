"""Description of an objective by names and numbers, from which other processes can build it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from dynamics.contact import ContactLaw
from ocp import plugins
from ocp.errors import InputError, input_errors
from ocp.gradients.chunks import CHUNK
from ocp.gradients.objective import SampledObjective
from ocp.gradients.rollouts import RolloutObjective
from ocp.problem.policy import Policy
from ocp.problem.resources import check_memory, sampling_memory
from ocp.store.provenance import check_content
from ocp.transcription.factories import law_digest, make_law, policy_of

SIGMA_SHARE = 0.1
"""Default standard deviation of the noise on a problem's inputs, as a fraction of their characteristic size."""
SIGMA_RATIO = 1e9
"""Maximum ratio of noise and default noise, in either direction; beyond it rounding errors dominate."""


@dataclass(frozen=True)
class NamedObjective:
    """An objective with the values of all its parameters and its default noise ``sigma``.

    ``usual`` is the standard deviation to which the limits of :meth:`check_sigma` are relative.
    """

    objective: SampledObjective
    params: dict[str, Any]
    sigma: float
    usual: float

    def check_sigma(self, values: Iterable[float]) -> None:
        """Raise InputError for a noise so small or large that rounding errors dominate its effect."""
        smallest, largest = self.usual / SIGMA_RATIO, self.usual * SIGMA_RATIO
        for value in values:
            if not smallest <= value <= largest:
                raise InputError(
                    f"sigma of {self.objective.name} must be from {smallest:.3g} to {largest:.3g} (beyond,"
                    f" rounding errors dominate), got {value:g}"
                )


@dataclass(frozen=True)
class ObjectiveCase:
    """Description of an objective by names and numbers, from which any process can build it.

    ``theta`` is the decision. ``at`` maps names of parameters and of components of the decision to values that
    are set after the build. ``content`` is the digest of the user's files that define the problem and a learned
    law.
    """

    problem: str
    params: Mapping[str, Any] = field(default_factory=dict)
    contact: ContactLaw | str = "barrier"
    contact_settings: Mapping[str, Any] = field(default_factory=dict)
    policy: Policy | str = "open-loop"
    policy_settings: Mapping[str, Any] = field(default_factory=dict)
    theta: np.ndarray | None = None
    engine: Mapping[str, Any] = field(default_factory=dict)
    at: Mapping[str, float] = field(default_factory=dict)
    content: str | None = None

    def build(self, spec: Any = None) -> NamedObjective:
        """Build the objective from the problem's ``spec``, which is looked up by name if not passed.

        The default noise on the inputs of rollouts is a tenth of the inputs' largest characteristic size.

        Raises :class:`~ocp.errors.InputError` for a law that cannot close the system, for a policy
        setting other than ``stationary``, and for a decision that needs more memory than there is;
        :class:`~ocp.store.provenance.FilesChanged` if a file has changed since the description was made.
        """
        spec = plugins.problems.named(self.problem) if spec is None else spec
        digests = getattr(spec, "digest", None), law_digest(self.contact)
        check_content(self.problem, self.content, digests, self.contact_settings)
        named_objective = self._static(spec) if hasattr(spec, "objective") else self._rollouts(spec)
        return replace(named_objective, objective=named_objective.objective.at(self.at)) if self.at else named_objective

    def _static(self, spec: Any) -> NamedObjective:
        """Build an objective without dynamics; its default noise is the value of its parameter ``sigma``."""
        values = spec.params(self.params).model_dump()
        usual = float(spec.Params.model_fields["sigma"].default)
        objective = spec.objective(self.params, **self.engine)
        if self.theta is not None:
            self._check_decision(spec.name, len(objective.decision))
            names = [signal.name for signal in objective.decision]
            decision = dict(zip(names, self.theta.tolist(), strict=True))
            if repeated := sorted(decision.keys() & self.params.keys()):
                raise InputError(f"{repeated[0]} is set by theta and by params; give one of them")
            objective = objective.at(decision)
            values |= decision
        return NamedObjective(objective, values, float(values["sigma"]), usual)

    def _check_decision(self, name: str, expected: int) -> None:
        if self.theta is not None and self.theta.size != expected:
            raise InputError(
                f"the decision has {self.theta.size} variables, {name} needs {expected}; give the"
                " parameters of the run that it is from"
            )

    def _rollouts(self, spec: Any) -> NamedObjective:
        """Build an objective that consists of the cost of a problem's rollouts."""
        values, problem = spec.params(self.params).model_dump(), spec.problem(self.params)
        law = make_law(self.contact, self.contact_settings, problem.system)
        policy_settings = self.policy_settings
        policy = policy_of(self.policy, policy_settings)
        if unused := policy_settings.keys() - {"stationary"}:
            raise InputError(f"-s policy.{min(unused)} has no effect: an estimate has no gains to limit; drop it")
        per_step = problem.system.nu * (1 if policy.name == "open-loop" else problem.system.nx + 1)
        needed_bytes = sampling_memory(float(problem.N) * per_step, CHUNK)
        check_memory(f"{spec.name} with N = {problem.N}", needed_bytes)
        if not policy_settings.get("stationary"):
            self._check_decision(spec.name, problem.N * per_step)
        with input_errors():
            objective = RolloutObjective(problem, law, policy, self.theta, **self.engine)
        sigma = SIGMA_SHARE * float(problem.scales.u.max())
        return NamedObjective(objective, values, sigma, sigma)
