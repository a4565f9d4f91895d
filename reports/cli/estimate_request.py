"""What a person asked to be estimated: the objective, its sampling, the sweep, all checked."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ocp.errors import InputError
from reports.cli.choices import (
    BACKENDS,
    assignments,
    choose,
    contact_law,
    policy,
    split_policy_settings,
)

if TYPE_CHECKING:
    import numpy as np

    from ocp.gradients.estimation import Sampling
    from ocp.gradients.objective import SampledObjective
    from ocp.gradients.sweep import Sweep
    from problems.objectives import ObjectiveSpec
    from problems.spec import ProblemSpec

SIGMA_SHARE = 0.1
"""Noise on a problem's inputs where none is asked for, as a share of their characteristic size."""


@dataclass(frozen=True)
class EstimateRequest:
    """One study, nothing unchecked; ``record`` is what determines its answer."""

    name: str
    objective: SampledObjective
    sampling: Sampling
    sweep: Sweep | None
    record: dict[str, Any]
    values: dict[str, Any]
    spec: ObjectiveSpec | ProblemSpec
    how: dict[str, Any]

    @classmethod
    def read(
        cls,
        *,
        problem: str,
        params: Iterable[str] | None,
        contact: str,
        law_settings: Iterable[str] | None,
        policy_name: str,
        settings: Iterable[str] | None,
        estimators: str,
        samples: str,
        sigma: float | None,
        sweep: str | None,
        seed: int,
        reference: str,
        reference_samples: str | None,
        at: Path | None,
        engine: Mapping[str, Any],
    ) -> EstimateRequest:
        """Check the words of a command line; raises InputError for the first that does not fit."""
        from ocp.gradients.estimation import Sampling
        from ocp.gradients.sweep import Sweep
        from problems.objectives import named

        spec = named(problem)
        choose("backend", engine["backend"], dict.fromkeys(BACKENDS))
        given = {k: v for k, v in assignments("-p", params).items() if k != "sigma"}
        of_noise = assignments("-p", params).get("sigma")
        if of_noise is not None and "sigma" in spec.Params.model_fields and sigma is None:
            sigma = spec.params({"sigma": of_noise}).model_dump()["sigma"]
        elif of_noise is not None:
            given["sigma"] = of_noise
        own, others = split_policy_settings(assignments("-s", settings))
        how = {
            "contact": contact, "law_settings": list(law_settings or ()), "policy": policy_name,
            "policy_settings": own, "at": at, "engine": dict(engine),
        }  # fmt: skip
        objective, values, default_sigma = build(spec, given, how)
        sampling = Sampling(
            tuple(name.strip() for name in estimators.split(",") if name.strip()),
            whole("--samples", samples),
            default_sigma if sigma is None else sigma,
            seed,
            _rules(others),
            reference,
            None if reference_samples is None else whole("--reference-samples", reference_samples),
        )
        swept = None if sweep is None else Sweep.read(sweep)
        if swept is not None:
            _check_values(swept, spec, given, how)
        record = {
            "problem": spec.name, "params": values, "estimators": list(sampling.estimators),
            "samples": sampling.samples, "sigma": sampling.sigma, "seed": seed,
            "reference": reference, "reference_samples": sampling.most_reference_samples,
            "rules": {rule.name: vars(rule) for rule in sampling.rules},
            "sweep": None if swept is None else {"name": swept.name, "values": swept.values},
            "source": _source(spec),
        }  # fmt: skip
        if hasattr(objective, "problem"):
            record |= {
                "contact": contact, "law_settings": list(law_settings or ()),
                "policy": policy_name, "policy_settings": own,
                "at": None if at is None else str(at),
            }  # fmt: skip
        return cls(spec.name, objective, sampling, swept, record, given, spec, how)

    def rebuilt(self, changed: Mapping[str, float]) -> SampledObjective:
        """Build the objective again at a value that shapes it, such as a number of steps."""
        field = self.spec.Params.model_fields
        for name in changed:
            if name not in field:
                from problems.spec import did_you_mean

                known = ["sigma", "samples", *field, *self.objective.parameters]
                known = list(dict.fromkeys(known))
                raise InputError(
                    f"--sweep: {self.name} has nothing called {name!r}{did_you_mean(name, known)};"
                    f" there are {', '.join(known)}"
                )
        return build(self.spec, {**self.values, **changed}, self.how)[0]

    def unit(self) -> str:
        """Unit of what is swept."""
        from problems.parameters import unit_of

        if self.sweep is None or self.sweep.name == "samples":
            return "1"
        field = self.spec.Params.model_fields.get(self.sweep.name)
        if field is not None:
            return unit_of(field)
        units = {s.name: s.unit for s in self.objective.decision}
        step = getattr(self.objective, "step", None)
        if step is not None:
            units |= step.p.units
        return units.get(self.sweep.name, "1")


def build(
    spec: ObjectiveSpec | ProblemSpec, given: Mapping[str, Any], how: Mapping[str, Any]
) -> tuple[SampledObjective, dict[str, Any], float]:
    """Return the objective, all its parameters by name, and the noise to take by default."""
    from ocp.gradients.rollout_objective import RolloutObjective
    from problems.objectives import ObjectiveSpec

    checked = spec.params(given)
    values = checked.model_dump()
    if isinstance(spec, ObjectiveSpec):
        objective = spec.build(checked, **how["engine"])
        return objective, values, float(values["sigma"])
    law = contact_law(how["contact"], how["law_settings"])
    chosen = policy(how["policy"], how["policy_settings"])
    problem = spec.problem(given)
    try:
        law.knobs(problem.system)
    except ValueError as error:
        raise InputError(str(error)) from error
    theta = None if how["at"] is None else _stored_decision(how["at"], how["policy"])
    try:
        objective = RolloutObjective(problem, law, chosen, theta, **how["engine"])
    except ValueError as error:
        raise InputError(str(error)) from error
    return objective, values, SIGMA_SHARE * float(problem.sizes.u.max())


def _check_values(
    swept: Sweep,
    spec: ObjectiveSpec | ProblemSpec,
    given: Mapping[str, Any],
    how: Mapping[str, Any],
) -> None:
    """Raise InputError where a swept value is out of its parameter's range."""
    from dynamics.systems import KNOB

    knob = swept.name.removeprefix(KNOB)
    for value in swept.values:
        if swept.name in spec.Params.model_fields:
            spec.params({**given, swept.name: value})
        elif swept.name.startswith(KNOB):
            own = [item for item in how["law_settings"] if not item.startswith(f"{knob}=")]
            contact_law(how["contact"], [*own, f"{knob}={value}"])


def _source(spec: ObjectiveSpec | ProblemSpec) -> str | None:
    """The user's file, where the problem comes from one."""
    path = getattr(spec, "path", None)
    return None if path is None else str(path)


def _stored_decision(at: Path, policy_name: str) -> np.ndarray:
    """Inputs, or gains, of a stored run, in the order of a decision."""
    import numpy as np

    from ocp import store

    data = store.load(at).data
    if policy_name == "open-loop":
        return data["u"].values[0]
    if "K" not in data:
        raise InputError(f"{at} holds no gains; solve it with --policy feedback")
    K, k = data["K"].values, data["k"].values
    return np.concatenate([K.reshape(len(K), -1), k], axis=1)


def _rules(given: Mapping[str, str]) -> list[Any]:
    """Read ``alpha.gamma=0.1`` and the like into the rules that they set."""
    from dataclasses import fields

    from ocp.gradients.interpolation import RULES

    settings: dict[str, dict[str, float]] = {}
    for key, value in given.items():
        name, _, setting = key.partition(".")
        known = [field.name for field in fields(RULES[name])] if name in RULES else []
        if setting not in known:
            listed = [f"{rule}.{f.name}" for rule, cls in RULES.items() for f in fields(cls)]
            raise InputError(
                f"-s: there is no setting {key!r}; there are {', '.join(listed)} and those of the"
                " policy"
            )
        try:
            settings.setdefault(name, {})[setting] = float(value)
        except ValueError:
            raise InputError(f"-s {key}: expected a number, got {value!r}") from None
    return [RULES[name](**values) for name, values in settings.items()]


def whole(option: str, text: str) -> int:
    """Read a count such as ``100000`` or ``1e5``; raises InputError for anything else."""
    try:
        value = float(text)
        if value.is_integer():
            return int(value)
    except (ValueError, OverflowError):
        pass
    raise InputError(f"{option} must be a whole number such as 100000 or 1e5, got {text!r}")
