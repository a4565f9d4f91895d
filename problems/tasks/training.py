"""Jobs that train a policy on a named task in any process, and the training data that a run stores."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dynamics.contact import ContactLaw
from ocp.errors import InputError
from ocp.judge.contact_report import least_slip
from ocp.learning.experiment import EXACT, Experiment
from ocp.learning.protocol import Algorithm, Normaliser, TrainedPolicy
from ocp.learning.training import CHECKPOINT_KEY, evaluate, read_checkpoint, train
from ocp.learning.unroll_gradients import FOPG
from ocp.problem.task import Task
from ocp.solution import units_of
from ocp.store.checkpoint import Checkpoint, SavedWork
from ocp.store.json_values import to_json
from ocp.store.provenance import content_digest
from ocp.store.stored_run import StoredRun
from ocp.transcription.factories import law_record
from problems.tasks import registry

if TYPE_CHECKING:
    import xarray as xr


def policy_of(data: xr.Dataset | Mapping[str, np.ndarray]) -> TrainedPolicy:
    """Return the policy of a stored run of ``ocp train``: parameters and normaliser, exactly as trained."""
    theta, mean, scale = (np.asarray(data[name]) for name in ("theta", "mean", "scale"))
    # In binary floating point the square root of a square is exact.
    return TrainedPolicy(theta, Normaliser(2.0, mean, 2.0 * scale**2))


def with_episode(experiment: Experiment, data: xr.Dataset) -> xr.Dataset:
    """Return the results of :func:`~ocp.learning.training.train` with units, and with an episode added.

    The episode is the first of the evaluations, with the best policy, under the exact law: ``x`` (scenario, node,
    state), ``u`` (scenario, interval, control), ``lam`` (scenario, interval, contact), one scenario, and ``time``, up
    to the episode's end.
    """
    labelled = data.drop_attrs().assign(_episode(experiment, policy_of(data)))
    return _with_units(experiment, labelled)


def _episode(experiment: Experiment, policy: TrainedPolicy) -> dict[str, Any]:
    task = experiment.task
    episode = evaluate(experiment, policy, EXACT, 1)
    length = int(episode.lengths[0])
    x, u = episode.states[0, : length + 1], episode.inputs[0, :length]
    step = EXACT.close(task.system)
    p = step.p.pack(dict(zip(task.parameters.names, task.parameters.values, strict=True)))
    solved = [[np.array(value).ravel() for value in step.solve(*pair, p)[1:3]] for pair in zip(x, u, strict=False)]
    pairs = np.array(solved).reshape(length, 2, step.n)
    lam, _ = least_slip(step, pairs[:, 0], pairs[:, 1])
    signals = {"state": task.system.states, "control": task.system.inputs, "contact": task.system.contacts}
    units, attributes = units_of(signals)
    return {
        "x": (("scenario", "node", "state"), x[None], attributes["state"]),
        "u": (("scenario", "interval", "control"), u[None], attributes["control"]),
        "lam": (("scenario", "interval", "contact"), lam.reshape(1, length, step.n), attributes["contact"]),
        **{key: (key, [signal.name for signal in group]) for key, group in signals.items()},
        **{f"{key}_unit": (key, entries) for key, entries in units.items()},
        "time": ("node", _h(experiment) * np.arange(length + 1), {"units": "s"}),
    }


def _h(experiment: Experiment) -> float:
    """Return the step size [s] of the experiment's task."""
    import casadi as ca

    task = experiment.task
    h = ca.Function("h", [task.parameters.vector], [ca.SX(task.system.h)])
    return float(h(task.parameters.values))


def _with_units(experiment: Experiment, data: xr.Dataset) -> xr.Dataset:
    task = experiment.task
    units = {f"evaluation_{measure.signal.name}": measure.signal.unit for measure in task.measures}
    units |= {"wall_s": "s"}
    data = data.assign(
        observation_unit=("observation", [signal.unit for signal in task.observations]),
        physical_unit=("physical", [task.parameters.get(str(name)).unit for name in data["physical"].values]),
    )
    for name in ("mean", "scale"):
        data[name].attrs["units"] = "see observation_unit"
    data["psi"].attrs["units"] = "see physical_unit"
    for name, variable in data.data_vars.items():
        variable.attrs.setdefault("units", units.get(str(name), "1"))
    return data


SAME_TRAINING = ("task", "algorithm", "seed")
"""Settings that an unfinished training must share with a job to be reported at the start of the job."""
KIND = "train"
"""Kind of a stored run that contains a trained policy."""


@dataclass(frozen=True, kw_only=True)
class TrainingJob:
    """Job that trains a policy: an algorithm with its settings and a seed, on a named task.

    ``options`` are fields of :class:`~ocp.learning.experiment.Experiment`. ``checkpoint_folder`` is the folder of
    the checkpoint, which other workers may share; results do not depend on the folder or on ``threads``.
    ``model_params`` are the model's physical parameters that differ from the task's.
    """

    task: str
    params: Mapping[str, Any]
    algorithm: Algorithm
    law: ContactLaw
    seed: int
    checkpoint_folder: Path | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    model_params: Mapping[str, float] = field(default_factory=dict)
    threads: int | None = None

    @property
    def name(self) -> str:
        """Algorithm and seed as text, for messages on the terminal."""
        collection = self.algorithm.settings().get("of")
        return f"{f'{collection} with psi' if collection else self.algorithm.name} seed {self.seed}"

    def experiment(self, task: Task | None = None) -> Experiment:
        """Build the experiment, on ``task`` if that is already built; raises :class:`~ocp.errors.InputError`."""
        spec = registry.spec(self.task)
        params = spec.params(self.params)
        task = task or spec.build(params)
        model_params = task.parameters.pack(self.model_params) if self.model_params else None
        return Experiment(
            task=task,
            model_params=model_params,
            algorithm=self.algorithm,
            law=self.law,
            seed=self.seed,
            params=params.model_dump(),
            threads=self.threads,
            **self.options,
        )

    def checkpoint(self, experiment: Experiment, store: Path) -> Checkpoint:
        """Return the checkpoint in a store, identified by all settings that affect the result."""
        decisive = {**experiment.settings(), "iterations": experiment.iterations}
        content = content_digest([self.law.source_digest], self.law.settings())
        return Checkpoint(store, self.task, {"training": decisive}, content)


def unfinished(job: TrainingJob, experiment: Experiment, checkpoint: Checkpoint) -> list[str]:
    """Return messages on the iteration at which the job resumes, and on similar unfinished jobs.

    Similar jobs have the same task, algorithm and seed, but other settings.
    """
    state, own_settings = checkpoint.state(CHECKPOINT_KEY), to_json(experiment.settings())
    lines = [f"{job.name}: {note}" for note in checkpoint.notes]
    if state is not None:
        lines.append(f"{job.name} resumes after {read_checkpoint(state)[0]} iterations")
    for stored_state in checkpoint.other_states(CHECKPOINT_KEY):
        done, settings = read_checkpoint(stored_state)
        if [settings.get(key) for key in SAME_TRAINING] == [own_settings[key] for key in SAME_TRAINING]:
            names = [name for name in {**settings, **own_settings} if settings.get(name) != own_settings.get(name)]
            changes = (f"{name} = {settings.get(name)} instead of {own_settings.get(name)}" for name in names)
            lines.append(
                f"another training by {job.name} is unfinished after {done} iterations, with"
                f" {', '.join(changes) or 'other iterations'}; run its own command to resume it"
            )
    return lines


def run_training(job: TrainingJob, report: Callable[[dict[str, float]], None]) -> xr.Dataset:
    """Run a job, or continue it from its checkpoint, and return the data to store (a worker's job function).

    ``report`` is called with the numbers of every iteration.
    """
    experiment = job.experiment()
    # A worker on another computer may not have the folder.
    folder = job.checkpoint_folder
    checkpoint = SavedWork(folder if folder is not None and folder.is_dir() else None)
    data = train(experiment, checkpoint, lambda k, row: report({"iteration": float(k), **row}))
    return with_episode(experiment, data)


def record(experiment: Experiment) -> dict[str, Any]:
    """Return the description of an experiment for the record of a run; :func:`rebuilt` reads it."""
    names = ("hidden", "initial", "rest", "normalise", "discount", "iterations", "evaluate_every")
    return {
        "problem": experiment.task.name,
        "params": dict(experiment.params),
        "algorithm": experiment.algorithm.name,
        "algorithm_settings": experiment.algorithm.settings(),
        **law_record(experiment.law),
        **{name: getattr(experiment, name) for name in (*names, "episodes")},
    }


def rebuilt(run: StoredRun) -> tuple[Experiment, TrainedPolicy]:
    """Return the experiment and the policy of a stored run of ``ocp train``, for another evaluation.

    Raises :class:`~ocp.errors.InputError` for a run of another kind, and if the policy does not fit
    the named task.
    """
    if run.kind != KIND:
        raise InputError(f"{run.path} is a run of ocp {run.kind}, which holds no policy; give one of ocp train")
    record, data = run.record, run.data
    spec = registry.spec(str(run.meta["problem"]))
    params = spec.params(record["params"])
    hidden = record["hidden"]
    experiment = Experiment(
        task=spec.build(params),
        # The algorithm does not affect the evaluation of a policy.
        algorithm=FOPG(),
        hidden=None if hidden is None else tuple(hidden),
        discount=record["discount"],
        params=params.model_dump(),
    )
    policy, observations = policy_of(data), [str(name) for name in data["observation"].values]
    names = [signal.name for signal in experiment.task.observations]
    if observations != names or policy.theta.size != experiment.policy.n_theta:
        raise InputError(
            f"{run.path}: its policy has {policy.theta.size} parameters and {len(observations)}"
            f" observations, {', '.join(observations)}; a policy of {spec.name} has"
            f" {experiment.policy.n_theta} parameters and {len(names)} observations, {', '.join(names)};"
            " train one for this task"
        )
    return experiment, policy
