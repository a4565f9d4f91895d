"""``ocp train`` and ``ocp evaluate``: train policies through contact, and evaluate them again."""

from __future__ import annotations

import os
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from dynamics.contact import ContactLaw
from ocp import store
from ocp.errors import InputError, interruptible
from ocp.jobs.scheduling import Workers, map_jobs
from ocp.learning.experiment import Experiment
from ocp.learning.protocol import Algorithm, TrainedPolicy
from ocp.learning.training import check_training, evaluate
from ocp.problem.resources import check_memory
from ocp.problem.task import Task
from ocp.store.checkpoint import Checkpoint
from ocp.store.stored_run import StoredRun
from ocp.transcription.factories import make_law
from problems.tasks import registry
from problems.tasks.registry import TaskSpec
from problems.tasks.training import TrainingJob, rebuilt, record, run_training, unfinished
from reports.cli import interrupt
from reports.cli.learning.training_options import algorithms, is_psi, learned_parameters
from reports.cli.options.learning import EvaluateOptions, TrainOptions
from reports.cli.request import check_outputs, parse_assignments
from reports.tables.training import (
    evaluation_sentence,
    evaluation_summary,
    evaluation_table,
    group_seeds,
    group_verdict,
    summary_table,
    training_document,
    training_meta,
)
from reports.tables.training_progress import show_trainings

_OWN_LAW = {"adaptive": {"law": "quartic"}}
"""Mapping from a law to its default settings in training, from eq. C.2 of the paper on adaptive barrier smoothing."""
_ENDED = 0
"""Index of the checkpoint entry with the path of the finished run."""


@dataclass(frozen=True)
class TrainRequest:
    """Checked request of ``ocp train``: jobs with checkpoints and experiments, and the number of processes."""

    jobs: list[TrainingJob]
    checkpoints: list[Checkpoint]
    experiments: list[Experiment]
    workers: int


def check(options: TrainOptions) -> TrainRequest:
    """Build the task and every algorithm, and check that the runs can be stored."""
    spec = registry.spec(options.task)
    task = spec.task(parse_assignments("-p", options.params))
    if options.scheduler is not None and options.jobs is not None:
        raise InputError("--jobs starts local processes, --scheduler uses a cluster; drop one")
    jobs, workers = _jobs(options, spec, task)
    check_outputs(options.out, options.pdf)
    built = [job.experiment(task) for job in jobs]
    for experiment in built[:: options.seeds]:
        experiment.algorithm.check(experiment)
        check_training(experiment, workers)
    pairs, store_folder = zip(jobs, built, strict=True), options.out.resolve()
    checkpoints = [job.checkpoint(experiment, store_folder) for job, experiment in pairs]
    return TrainRequest(jobs, checkpoints, built, workers)


def _jobs(options: TrainOptions, spec: TaskSpec, task: Task) -> tuple[list[TrainingJob], int]:
    """Return a job for every seed of every algorithm, and the number of processes."""
    setting_texts = parse_assignments("-s", options.settings)
    psi = learned_parameters(setting_texts, task.parameters.names)
    setting_texts = {key: value for key, value in setting_texts.items() if not is_psi(key)}
    names = spec.learner if options.algorithm == "usual" else options.algorithm
    algorithm_settings = algorithms(names, setting_texts, spec)
    shared_fields = {} if options.iterations is None else {"iterations": options.iterations}
    workers = min(len(algorithm_settings) * options.seeds, options.jobs or _cpus())
    jobs = [
        TrainingJob(
            task=options.task,
            params=parse_assignments("-p", options.params),
            seed=seed,
            algorithm=psi.wrap(algorithm),
            law=_law(options, algorithm, task),
            options={**experiment_fields, **shared_fields},
            model_params=psi.guesses,
            threads=1 if options.scheduler is not None else max(1, _cpus() // workers),
        )
        for algorithm, experiment_fields in algorithm_settings
        for seed in range(options.seed, options.seed + options.seeds)
    ]
    return jobs, workers


def _law(options: TrainOptions, algorithm: Algorithm, task: Task) -> ContactLaw:
    """Return the contact law of ``--contact``; the default is the law of the algorithm."""
    name = algorithm.contact if options.contact == "own" else options.contact
    settings = parse_assignments("-c", options.law_settings) or _OWN_LAW.get(name, {})
    return make_law(name, settings, task.system)


def _cpus() -> int:
    return len(os.sched_getaffinity(0))


def run(options: TrainOptions, request: TrainRequest) -> int:
    """Train a policy through contact, with several algorithms and seeds in parallel."""
    output = options.output
    with ExitStack() as resources:
        for checkpoint in request.checkpoints:
            resources.enter_context(checkpoint)
        stored = _stored_before(request)
        if stored:
            output.say(f"resumed; {len(stored)} of {len(request.jobs)} trainings already complete")
        unfinished_jobs = [index for index in range(len(request.jobs)) if index not in stored]
        for index in unfinished_jobs:
            training = request.jobs[index], request.experiments[index], request.checkpoints[index]
            for sentence in unfinished(*training):
                output.say(sentence)
        try:
            with interruptible():
                failed = _run_jobs(options, request, unfinished_jobs, stored)
        except KeyboardInterrupt:
            output.say("the same command resumes from the last checkpoint")
            raise
        for index in stored:
            request.checkpoints[index].discard()
    _print_results(options, [stored[index] for index in sorted(stored)], request, failed)
    return 0


def _run_jobs(
    options: TrainOptions, request: TrainRequest, unfinished_jobs: list[int], stored: dict[int, Path]
) -> dict[int, Exception]:
    """Run the unfinished jobs, add the path of each run to ``stored``, and return the errors of failed jobs."""
    failed: dict[int, Exception] = {}
    jobs = {
        index: replace(request.jobs[index], checkpoint_folder=request.checkpoints[index].directory)
        for index in unfinished_jobs
    }
    workers = Workers(request.workers, options.scheduler)
    iterations_by_name = {job.name: request.experiments[index].iterations for index, job in jobs.items()}
    with show_trainings(iterations_by_name, options.quiet, interrupt.raise_if_interrupted) as callback:

        def show(index: int, row: Any) -> None:
            callback(unfinished_jobs.index(index), row)

        with closing(map_jobs(run_training, jobs, workers, callback=show, recover=failed.__setitem__)) as outcomes:
            for index, data in outcomes:
                if index not in failed:
                    stored[index] = _store(options, request, index, data)
    return failed


def _stored_before(request: TrainRequest) -> dict[int, Path]:
    """Return a mapping from jobs to paths of their runs, for jobs that an earlier, stopped command finished."""
    path_at = {}
    for index, checkpoint in enumerate(request.checkpoints):
        rows = checkpoint.rows(_ENDED)
        if rows and Path(rows[0]["run"]).is_dir():
            path_at[index] = Path(rows[0]["run"])
    return path_at


def _store(options: TrainOptions, request: TrainRequest, index: int, data: Any) -> Path:
    job, experiment = request.jobs[index], request.experiments[index]
    request_of = {"argv": options.argv, "tags": options.tags, "seed": job.seed}
    about = {**request_of, "record": record(experiment), **training_meta(data)}
    path = store.write_run(options.out, job.task, data, about).path
    request.checkpoints[index].save_rows(_ENDED, [{"run": str(path.resolve())}])
    return path


def _print_results(
    options: TrainOptions, paths: list[Path], request: TrainRequest, failed: dict[int, Exception]
) -> None:
    """Print the results, and write the PDF if requested; then raise the first failure, if there is one."""
    if not paths:
        raise next(iter(failed.values()))
    from reports.documents.pdf import write_pdf

    output, runs = options.output, [store.load(path) for path in paths]
    seed_groups = group_seeds(runs)
    output.note(summary_table(runs))
    for group in seed_groups:
        output.say(group_verdict(group))
    for stored_run in runs:
        output.say(f"run: {stored_run.path}")
    if options.pdf is not None:
        write_pdf(runs, options.pdf)
        output.say(f"PDF: {options.pdf}")
    errors = {request.jobs[index].name: str(error) for index, error in failed.items()}
    for name, message in errors.items():
        output.say(f"failed: {name}: {message}")
    pdf = None if options.pdf is None else str(options.pdf)
    output.document({"task": options.task, **training_document(seed_groups), "failed": errors, "pdf": pdf})
    if failed:
        raise next(iter(failed.values()))


EvaluateRequest = tuple[StoredRun, Experiment, TrainedPolicy, ContactLaw]


def check_evaluate(options: EvaluateOptions) -> EvaluateRequest:
    """Read the policy, build its task and the contact law, and check the required memory."""
    stored_run = options.stored(options.run)
    experiment, policy = rebuilt(stored_run)
    task = experiment.task
    law = make_law(options.contact, parse_assignments("-c", options.law_settings), task.system)
    numbers = task.horizon * (task.system.nx + task.system.nu)
    check_memory(f"--episodes {options.episodes}", 32.0 * options.episodes * numbers)
    return stored_run, experiment, policy, law


def run_evaluate(options: EvaluateOptions, request: EvaluateRequest) -> int:
    """Evaluate a trained policy: returns, lengths, measures, and violations in its episodes."""
    stored_run, experiment, policy, law = request
    evaluation = evaluate(experiment, policy, law, options.episodes, options.seed)
    content: dict[str, Any] = {
        "run": str(stored_run.path),
        "task": experiment.task.name,
        "contact": law.name,
        "contact_settings": law.settings(),
        "seed": options.seed,
        **evaluation_summary(experiment.task, evaluation),
        "own": stored_run.meta["evaluation"],
    }
    content["verdict"] = evaluation_sentence(content)
    output = options.output
    output.say(content["verdict"])
    output.note(evaluation_table(content))
    output.document(content)
    return 0
