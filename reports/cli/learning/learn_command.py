"""``ocp collect`` and ``ocp learn``: sample transitions of a problem, and fit a model of one time step."""

from __future__ import annotations

import math
import time
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import xarray as xr

from dynamics.learned.collecting import Drawn, merge_pieces, split_pieces
from dynamics.learned.ewda import EwdaModel
from dynamics.learned.files import TABLE_SUFFIXES, read_table
from dynamics.learned.fit import measure_fit
from dynamics.learned.region import Region
from dynamics.learned.training import Epoch, Recipe, Training
from dynamics.learned.transitions import MIN_ROWS_PER_COORDINATE, Transitions, split_rows
from dynamics.settings import read_count, settings_of
from ocp.errors import InputError, choose
from ocp.jobs.scheduling import Report, Workers, in_order, map_jobs
from ocp.problem.problem import Problem
from ocp.problem.resources import check_memory
from ocp.store import atomic, models
from ocp.store.checkpoint import Checkpoint, SavedWork
from ocp.store.provenance import content_digest
from problems import spec
from problems.regions import CollectJob, collect_piece, region_of
from problems.registry import objective_names
from reports.cli import interrupt
from reports.cli.options.learning import NOISE, CollectOptions, LearnOptions
from reports.cli.request import check_output_file, input_errors, parse_assignments
from reports.tables import learned_models


@dataclass(frozen=True)
class CollectRequest:
    """Checked request of ``ocp collect``: a problem, the region of its transitions, and their number."""

    name: str
    params: dict[str, Any]
    problem: Problem
    region: Region
    samples: int
    file: str
    content: str


def check_collect(options: CollectOptions) -> CollectRequest:
    """Build the problem, determine the region to sample, and check memory and the output file."""
    if options.problem in objective_names():
        raise InputError(f"{options.problem} is an objective without dynamics and has no transitions")
    problem_spec = spec(options.problem)
    parameter_texts = parse_assignments("-p", options.params)
    params, problem = problem_spec.params(parameter_texts), problem_spec.problem(parameter_texts)
    samples, system = read_count("--samples", options.samples), problem.system
    fewest_samples = MIN_ROWS_PER_COORDINATE * (system.nx + system.nu)
    if samples < fewest_samples:
        raise InputError(
            f"--samples: {samples} transitions are too few for a model; {problem_spec.name} needs at"
            f" least {fewest_samples}, ten per state and input"
        )
    check_memory(f"{samples} transitions", 32.0 * samples * (2 * system.nx + system.nu))
    region = region_of(problem_spec, params, problem)
    check_output_file(options.file, "transitions")
    file = problem_spec.name if problem_spec.path is None else str(problem_spec.path)
    return CollectRequest(
        problem_spec.name,
        params.model_dump(),
        problem,
        region,
        samples,
        file,
        content_digest([problem_spec.digest], {}),
    )


def run_collect(options: CollectOptions, request: CollectRequest) -> int:
    """Draw inputs and penetration-free states, take one step of the exact law at each, and save the transitions."""
    start_s, step = time.perf_counter(), request.problem.exact_step
    origin = {"problem": request.name, "parameters": request.params}
    with input_errors(f"{request.name}: "):
        pieces_drawn = _draw_pieces(options, request)
        data = merge_pieces(step, request.region, pieces_drawn, options.seed, origin)
    models.save(data.dataset(), options.file)
    document, seconds = learned_models.data_document(data), time.perf_counter() - start_s
    for line in learned_models.origin_lines(document):
        options.output.note(line)
    options.output.note(learned_models.coordinate_table(document))
    options.output.say(f"data: {options.file} ({len(data)} transitions, {seconds:.1f} s)")
    options.output.document({"file": str(options.file), **document, "seconds": seconds})
    return 0


def _draw_pieces(options: CollectOptions, request: CollectRequest) -> list[Drawn]:
    """Return all pieces of the sample in order, drawn by the workers chosen in the options."""
    jobs = [
        CollectJob(request.file, request.params, request.content, piece)
        for piece in split_pieces(request.samples, options.seed)
    ]
    workers = Workers(options.jobs, options.scheduler)
    return list(in_order(map_jobs(collect_piece, dict(enumerate(jobs)), workers)))


MODELS = {"ewda": "weighted average of the data", "mlp": "network trained on noised data"}
"""Mapping from each kind of model to its summary."""
NETWORK_OPTIONS = ("hidden", "epochs", "seeds", "jobs", "scheduler")
"""Options that apply only to networks."""
HELD_OUT = 0.1
"""Fraction of the rows that is held out to measure the fit."""
_COPIES = 6
"""Number of copies of all weights in training: current, best, gradient, two moments of Adam, update."""


@dataclass(frozen=True)
class LearnRequest:
    """Checked request of ``ocp learn``: data, network settings (None for an average), and a checkpoint per seed."""

    data: Transitions
    recipe: Recipe | None
    checkpoints: list[Checkpoint]


def check(options: LearnOptions) -> LearnRequest:
    """Read the data, and check the settings of the model."""
    choose("model", options.model, MODELS)
    network = options.model == "mlp"
    misplaced_options = [f"--{name}" for name in NETWORK_OPTIONS if name in options.explicit and not network]
    if misplaced_options:
        raise InputError(f"{misplaced_options[0]} is a setting of networks; drop it or use --model mlp")
    if options.noise < 0 or (options.noise == 0 and not network):
        smallest_sigma = "at least 0" if network else "above 0"
        raise InputError(
            f"--noise: sigma, in normalised units, must be {smallest_sigma}, got {options.noise:g};"
            f" {NOISE:g} is a common choice"
        )
    if options.noise > 1e3:
        raise InputError(
            f"--noise: sigma {options.noise:g} is in standard deviations of the data, at most 1000;"
            " choose a value such as 0.2"
        )
    hidden = settings_of(Recipe)["hidden"].read(options.hidden, "--")
    data = _read_data(options)
    check_output_file(options.file, "model")
    recipe = _recipe(options, data, hidden) if network else None
    key = {"data": data.hash, "sigma": options.noise, "hidden": hidden, "epochs": options.epochs}
    target = atomic.replaceable_path(options.file)
    # Checkpoints are stored next to the file, but not for a device or a FIFO.
    root = target.parent if network and target is not None else None
    seeds = range(options.seed, options.seed + options.seeds)
    return LearnRequest(data, recipe, [Checkpoint(root, "", {**key, "seed": seed}) for seed in seeds])


def _recipe(options: LearnOptions, data: Transitions, hidden: tuple[int, ...]) -> Recipe:
    sizes = pairwise((data.z.shape[1], *hidden, data.x.shape[1]))
    weights = sum(n_inputs * n_outputs for n_inputs, n_outputs in sizes)
    check_memory(f"--hidden: a network of {weights:.3g} weights", _COPIES * 4.0 * weights)
    with input_errors():
        return Recipe(hidden, options.epochs, held_out=HELD_OUT)


def _read_data(options: LearnOptions) -> Transitions:
    """Return the transitions in the file; with ``--problem``, check that they have the problem's states and inputs."""
    problem = None if options.problem is None else spec(options.problem)
    system = None if problem is None else problem.problem().system
    signals = None if system is None else (system.states, system.inputs)
    if options.data.suffix not in TABLE_SUFFIXES:
        if options.columns is not None:
            raise InputError(f"--columns is for tables, and {options.data} is not a table; drop it")
        data = models.load_transitions(options.data)
    else:
        pairs = None if options.columns is None else options.columns.split(",")
        columns = parse_assignments("--columns", pairs)
        origin = {} if problem is None else {"problem": problem.name}
        with input_errors():
            data = read_table(options.data, columns, signals, origin)
    with input_errors(f"{options.data}: "):
        if problem is not None and signals is not None:
            data.check_signals(*signals, problem.name)
        _ = data.samples().scales
    return data


def run(options: LearnOptions, request: LearnRequest) -> int:
    """Learn a time step from transitions: a weighted average, or a network on noised inputs."""
    start_s = time.perf_counter()
    if request.recipe is None:
        trained_models = [Learned(_average_model(options, request.data), options.seed)]
    else:
        trained_models = _train_networks(options, request, request.recipe)
    best = min(trained_models, key=lambda learned_model: learned_model.error)
    models.save(best.dataset, options.file)
    for checkpoint in request.checkpoints:
        with checkpoint:
            checkpoint.discard()
    document = learned_models.model_document(best.dataset)
    for table in (learned_models.fit_table, learned_models.outside_table):
        options.output.note(table(document))
    for learned_model in trained_models if len(trained_models) > 1 else ():
        suffix = ", kept" if learned_model is best else ""
        options.output.say(f"seed {learned_model.seed}: held-out error {learned_model.error:.4g}{suffix}")
    if best.resumed:
        options.output.say(f"resumed after epoch {best.resumed}")
    seconds = time.perf_counter() - start_s
    epochs_text = "" if best.epochs is None else f", {best.epochs} epochs"
    options.output.say(f"model: {options.file} ({options.model}{epochs_text}, {seconds:.1f} s)")
    content = {
        "seconds": seconds,
        "epochs": best.epochs,
        "resumed": best.resumed,
        "seeds": {learned_model.seed: learned_model.error for learned_model in trained_models},
    }
    options.output.document({"file": str(options.file), **document, **content})
    return 0


@dataclass(frozen=True)
class Learned:
    """A fitted model; ``error`` is the lowest held-out error in the training of a network, NaN for an average."""

    dataset: xr.Dataset
    seed: int
    error: float = math.nan
    epochs: int | None = None
    resumed: int = 0


@dataclass(frozen=True)
class NetworkJob:
    """Job that trains one network; ``checkpoint_folder`` is None if the output file is a device."""

    data: Transitions
    noise: float
    recipe: Recipe
    seed: int
    checkpoint_folder: Path | None


def train_network(job: NetworkJob, report: Report) -> Learned:
    """Return a trained network and report every epoch (a :data:`~ocp.jobs.scheduling.Function`).

    Raises :class:`~ocp.errors.InputError` for data that a network cannot learn from.
    """
    checkpoint, data = SavedWork(job.checkpoint_folder), job.data.samples()
    with input_errors():
        training = Training(data, job.noise, job.recipe, job.seed, checkpoint.state("training"))
    resumed = training.epoch
    try:
        for epoch in training.epochs():
            report(asdict(epoch))
            if checkpoint.due():
                checkpoint.save_state("training", **training.state)
    except KeyboardInterrupt:
        checkpoint.save_state("training", **training.state)
        raise
    dataset = _with_fit(job.data, training.model(), training.held_out, job.noise, job.seed)
    return Learned(dataset, job.seed, training.error, training.epoch, resumed)


def _train_networks(options: LearnOptions, request: LearnRequest, recipe: Recipe) -> list[Learned]:
    """Return a trained network for each seed, in the order of the seeds."""
    with ExitStack() as resources:
        for checkpoint in request.checkpoints:
            resources.enter_context(checkpoint)
            for line in checkpoint.notes:
                options.output.say(line)
        jobs = [
            NetworkJob(request.data, options.noise, recipe, options.seed + k, checkpoint.directory)
            for k, checkpoint in enumerate(request.checkpoints)
        ]
        show = resources.enter_context(learned_models.show_epochs(options.quiet, options.epochs))

        def callback(index: int, message: Any) -> None:
            interrupt.raise_if_interrupted()
            show(Epoch(**message), f"seed {jobs[index].seed}: " if len(jobs) > 1 else "")

        workers = Workers(options.jobs, options.scheduler)
        return list(in_order(map_jobs(train_network, dict(enumerate(jobs)), workers, callback=callback)))


def _with_fit(data: Transitions, model: Any, held_out: Any, noise: float, seed: int) -> xr.Dataset:
    """Return a model as a dataset with its errors on the held-out rows."""
    fitted = measure_fit(model, data.samples(), held_out, noise or NOISE, seed)
    return learned_models.model_dataset(model.dataset(), fitted.dataset(), data, len(held_out))


def _average_model(options: LearnOptions, data: Transitions) -> xr.Dataset:
    """Return the weighted-average model of all rows that are not held out, with its errors on the held-out rows."""
    training_rows, held_out = split_rows(len(data), HELD_OUT, options.seed)
    z, y = data.z[training_rows], data.x_next[training_rows]
    scales, sigma = data.normalisation, options.noise
    model = EwdaModel(z, y, scales, sigma, data.origin, options.seed)
    return _with_fit(data, model, held_out, options.noise, options.seed)
