"""The request of ``ocp estimate``: objective, estimators and sweep from the options."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dynamics.settings import read_count, settings_of
from ocp.errors import InputError, choose, did_you_mean
from ocp.gradients.case import ObjectiveCase
from ocp.gradients.estimation import Sampling
from ocp.gradients.estimators import RULES
from ocp.gradients.objective import SampledObjective
from ocp.gradients.sampling import reference_kind
from ocp.gradients.sweep import SAMPLING_AXES, read_sweep
from ocp.jobs.estimate_parts import JobWorkers
from ocp.jobs.scheduling import Workers
from ocp.store.json_values import to_json
from ocp.store.provenance import content_digest
from ocp.store.stored_run import StoredRun
from ocp.transcription.factories import contact_law, law_digest, law_name, law_record, split_policy_settings
from ocp.validation import Axis
from problems.registry import ObjectiveSpec, named
from problems.spec import ProblemSpec
from reports.cli.commands import EstimateOptions
from reports.cli.request import parse_assignments

_ROLLOUT_OPTIONS = {"contact": "--contact", "law_settings": "-c", "policy": "--policy", "decision_run": "--at"}
"""Mapping from options that apply only to objectives with rollouts to their flags."""


@dataclass(frozen=True)
class EstimateRequest:
    """Checked request of ``ocp estimate``; ``params`` are all parameters of the objective."""

    options: EstimateOptions
    spec: ObjectiveSpec | ProblemSpec
    case: ObjectiveCase
    objective: SampledObjective
    params: dict[str, Any]
    sampling: Sampling
    sweep: Axis | None

    @classmethod
    def read(cls, options: EstimateOptions) -> EstimateRequest:
        """Return the request described by the options; raise InputError for the first invalid value."""
        spec = named(options.problem)
        parameter_texts = parse_assignments("-p", options.params)
        is_static = isinstance(spec, ObjectiveSpec)
        if is_static and "sigma" in parameter_texts and options.sigma is not None:
            raise InputError("--sigma and -p sigma set the same value; drop one of them")
        estimators = tuple(n.strip() for n in options.estimators.split(",") if n.strip())
        rules = _rules(split_policy_settings(parse_assignments("-s", options.settings))[1], estimators)
        reference_samples = options.reference_samples
        sweep = None if options.sweep is None else read_sweep(options.sweep)
        case = objective_case(spec, parameter_texts, options)
        built = case.build(spec)
        objective, params = built.objective, built.params
        sampling = Sampling(
            estimators,
            settings_of(Sampling)["samples"].read(options.samples, "--"),
            built.sigma if options.sigma is None else options.sigma,
            options.seed,
            rules,
            options.reference,
            None if reference_samples is None else read_count("--reference-samples", reference_samples),
        )
        swept = sweep.values if sweep is not None and sweep.name == "sigma" else ()
        built.check_sigma([sampling.sigma, *swept])
        kind = reference_kind(objective, sampling.sigma, sampling.reference)
        if reference_samples is not None and kind != "zobg":
            raise InputError(
                f"the reference of {spec.name} is not sampled; drop --reference-samples or choose --reference zobg"
            )
        if is_static:
            params["sigma"] = sampling.sigma
        if sweep is not None:
            _check_sweep(sweep, spec, parameter_texts, options)
        return cls(options, spec, case, objective, params, sampling, sweep)

    @property
    def record(self) -> dict[str, Any]:
        """Values that determine the result, as the run stores them."""
        options, sampling, swept = self.options, self.sampling, self.sweep
        path = getattr(self.spec, "path", None)
        record = {
            "problem": self.spec.name,
            "params": self.params,
            "estimators": list(sampling.estimators),
            "samples": sampling.samples,
            "sigma": sampling.sigma,
            "seed": sampling.seed,
            "reference": sampling.reference,
            "reference_samples": sampling.n_reference_samples,
            "rules": {rule.name: vars(rule) for rule in sampling.rules},
            "sweep": None if swept is None else {"name": swept.name, "values": swept.values},
            "source": None if path is None else str(path),
        }
        if hasattr(self.objective, "problem"):
            law = contact_law(options.contact, parse_assignments("-c", options.law_settings))
            record |= {
                **law_record(law),
                "law_settings": list(options.law_settings or ()),
                "policy": options.policy,
                "policy_settings": _policy_settings(options),
                "at": options.decision_run,
            }
        return record

    @property
    def decisive(self) -> dict[str, Any]:
        """Values that must be unchanged for a stopped study to resume; ``content`` is a digest of the user's files.

        The run in ``--at`` is replaced by a digest of its decision, since ``@last`` may refer to a different run
        each time.
        """
        decision = hashlib.sha256(self.objective.theta.tobytes()).hexdigest()
        return {**self.record, "source": None, "at": None, "decision": decision}

    @property
    def content(self) -> str:
        """Digest of the user's files: the problem, the contact law, and files named in the law's settings."""
        law_settings = parse_assignments("-c", self.options.law_settings)
        digests = getattr(self.spec, "digest", None), law_digest(self.options.contact)
        return content_digest(digests, law_settings)

    def rebuilt(self, changed: Mapping[str, float]) -> SampledObjective:
        """Return the objective, rebuilt for changed structural values such as a number of steps."""
        parameter_fields = self.spec.Params.model_fields
        for name in changed:
            if name not in parameter_fields:
                names = dict.fromkeys(["sigma", "samples", *parameter_fields, *self.objective.parameters])
                raise InputError(
                    f"--sweep: {self.spec.name} has no parameter {name!r}"
                    f"{did_you_mean(name, names)}; available: {', '.join(names)}"
                )
        return self.changed(changed).build(self.spec).objective

    def changed(self, values: Mapping[str, float]) -> ObjectiveCase:
        """Return the case with other values of the swept quantity."""
        objective = self.objective
        graph_parameters = {*objective.parameters, *(signal.name for signal in objective.decision)}
        if values.keys() <= graph_parameters:
            return replace(self.case, at=values)
        return replace(self.case, params={**self.case.params, **values})

    @property
    def workers(self) -> Callable[[Mapping[str, float]], JobWorkers] | None:
        """Function from the swept values to worker processes; None if samples are drawn in this process."""
        options = self.options
        if not options.parallel:
            return None
        threads = options.threads or max(1, len(os.sched_getaffinity(0)) // options.jobs)

        def workers(values: Mapping[str, float]) -> JobWorkers:
            case = self.changed(values)
            case = replace(case, engine={**case.engine, "threads": threads})
            return JobWorkers(case, Workers(options.jobs, options.scheduler))

        return workers

    def unit(self) -> str:
        """Return the unit of the swept quantity, "1" without a sweep."""
        if self.sweep is None or self.sweep.name == "samples":
            return "1"
        parameter = settings_of(self.spec.Params).get(_swept_parameter(self.sweep, self.spec))
        if parameter is not None:
            return parameter.unit
        units = {s.name: s.unit for s in self.objective.decision}
        step = getattr(self.objective, "step", None)
        if step is not None:
            units |= step.p.units
        return units.get(self.sweep.name, "1")


def objective_case(
    spec: ObjectiveSpec | ProblemSpec, parameter_texts: Mapping[str, Any], options: EstimateOptions
) -> ObjectiveCase:
    """Return a case from which any process can build the objective; raises InputError for options without effect."""
    engine: dict[str, Any] = {"backend": options.backend, "threads": options.threads}
    policy_settings, path = _policy_settings(options), getattr(spec, "path", None)
    name = spec.name if path is None else str(path)
    if not isinstance(spec, ObjectiveSpec):
        theta = None if options.decision_run is None else _stored_decision(options, spec, parameter_texts)
        settings = parse_assignments("-c", options.law_settings)
        law = law_name(options.contact)
        content = content_digest([spec.digest, law_digest(law)], settings)
        return ObjectiveCase(
            name, parameter_texts, law, settings, options.policy, policy_settings, theta, engine, content=content
        )
    unused = [_ROLLOUT_OPTIONS[name] for name in _ROLLOUT_OPTIONS if name in options.explicit]
    unused += [f"-s policy.{name}" for name in policy_settings]
    if unused:
        raise InputError(f"{spec.name} is an objective without dynamics, {unused[0]} has no effect; drop it")
    return ObjectiveCase(name, parameter_texts, engine=engine)


def _policy_settings(options: EstimateOptions) -> dict[str, str]:
    return split_policy_settings(parse_assignments("-s", options.settings))[0]


def _swept_parameter(swept: Axis, spec: ObjectiveSpec | ProblemSpec) -> str:
    """Return the name of the swept parameter; "" if noise or the number of samples is swept."""
    of_noise = isinstance(spec, ProblemSpec) and swept.name in SAMPLING_AXES
    return "" if of_noise else swept.name.removeprefix("problem.")


def _check_sweep(
    swept: Axis, spec: ObjectiveSpec | ProblemSpec, parameter_texts: Mapping[str, Any], options: EstimateOptions
) -> None:
    """Raise InputError for swept values out of range, and for a swept quantity that is also set."""
    law, sign, parameter = swept.name.partition(".")
    of_law = (law, sign) == ("contact", ".")
    name = _swept_parameter(swept, spec)
    other_options = {swept.name: f"-p {name}"} if name in parameter_texts else {}
    law_settings = parse_assignments("-c", options.law_settings)
    other_options |= {f"contact.{name}": "-c " + name for name in law_settings}
    other_options |= {name: f"--{name}" for name in ("sigma", "samples") if name in options.explicit}
    if swept.name in other_options:
        raise InputError(f"--sweep sets {swept.name}; drop {other_options[swept.name]}")
    for value in swept.values:
        if name in spec.Params.model_fields:
            spec.params({**parameter_texts, name: value})
        elif of_law:
            contact_law(options.contact, {**law_settings, parameter: str(value)})
    if isinstance(spec, ProblemSpec) and name in spec.Params.model_fields:
        # The range of a user's parameter may include values that mechanics excludes, such as a negative mass.
        for value in (min(swept.values), max(swept.values)):
            spec.problem({**parameter_texts, name: value})


def _stored_decision(options: EstimateOptions, spec: ProblemSpec, parameter_texts: Mapping[str, Any]) -> np.ndarray:
    """Return the inputs (N, nu), or gains and offsets (N, nu nx + nu), of a stored run of this problem."""
    run = options.stored(str(options.decision_run))
    if run.kind != "solve":
        raise InputError(f"--at {options.decision_run}: it is a run of ocp {run.kind}; give a run of ocp solve")
    _check_same(run, options, spec, parameter_texts)
    if options.policy == "open-loop":
        return run.data["u"].values[0]
    if "K" not in run.data:
        raise InputError(f"{options.decision_run} has no gains; solve it with --policy feedback")
    K, k = run.data["K"].values, run.data["k"].values
    return np.concatenate([K.reshape(len(K), -1), k], axis=1)


def _check_same(
    run: StoredRun, options: EstimateOptions, spec: ProblemSpec, parameter_texts: Mapping[str, Any]
) -> None:
    """Raise InputError unless a run solves this problem with the same parameters, except the swept one."""
    complaint = f"--at {options.decision_run}: the run is of"
    if run.meta["problem"] != spec.name:
        raise InputError(f"{complaint} {run.meta['problem']}, not of {spec.name}; give a run of {spec.name}")
    if run.meta.get("source_digest") != spec.digest:
        raise InputError(
            f"{complaint} another {spec.name}: {spec.path or 'the problem'}, or a file it imports, has"
            " changed since; solve it again"
        )
    swept = "" if options.sweep is None else options.sweep.partition("=")[0].strip()
    stored_params = run.record.get("params", {})
    expected_params = to_json(spec.params(parameter_texts).model_dump())
    differing = [
        f"{name}={stored_params.get(name)}"
        for name, value in expected_params.items()
        if name != swept and stored_params.get(name) != value
    ]
    if differing:
        raise InputError(
            f"{complaint} {spec.name} at other parameters; give those of the run: -p {' -p '.join(differing)}"
        )


def _rules(setting_texts: Mapping[str, str], estimators: tuple[str, ...]) -> list[Any]:
    """Return the rules of estimators from settings such as ``alpha.gamma=0.1``."""
    declared = {f"{rule}.{name}": setting for rule, cls in RULES.items() for name, setting in settings_of(cls).items()}
    settings: dict[str, dict[str, float]] = {}
    for key, text in setting_texts.items():
        setting, rule = choose("setting", key, declared), key.partition(".")[0]
        if rule not in estimators:
            raise InputError(f"-s {key} has no effect: {rule} is not among --estimators")
        settings.setdefault(rule, {})[setting.name] = setting.read(text, f"-s {rule}.")
    return [RULES[rule](**values) for rule, values in settings.items()]
