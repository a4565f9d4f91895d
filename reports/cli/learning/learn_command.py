"""``ocp learn DATA --model NAME -o FILE``: a model of a step, from transitions."""

from __future__ import annotations

from dataclasses import MISSING, dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

from reports.cli.options import PROBLEM, Command, Options, argument, option

if TYPE_CHECKING:
    import xarray as xr

    from dynamics.learned.training import Recipe, Training
    from dynamics.learned.transitions import Transitions
    from ocp.store.checkpoint import Checkpoint
    from problems.spec import ProblemSpec

MODELS = {"ewda": "weighted average of the data", "mlp": "network trained on noised data"}
NETWORK = ("hidden", "epochs")
HELD_OUT = 0.1
NOISE = 0.2
_COPIES = 6
"""Of all weights while they are trained: now and best, slopes, Adam's moments, what is to come."""


@dataclass(frozen=True, kw_only=True)
class LearnOptions(Options):
    """From what, which model, and where to."""

    data: Path = argument(help="What ocp collect wrote, a .csv or a .parquet.")
    model: str = option(MISSING, "--model", help="ewda or mlp.")
    file: Path = option(MISSING, "--output", "-o", help="The netCDF file to write.")
    noise: float = option(NOISE, "--noise", help="sigma, in normalised units; 0: clean data (mlp).")
    hidden: str = option(
        "128,128,128,128", "--hidden", help="Units of each hidden layer of the mlp."
    )
    epochs: int = option(200, "--epochs", min=1, help="Most passes of training the mlp.")
    seed: int = option(0, "--seed", min=0, help="Seed of everything random.")
    problem: str | None = option(None, "--problem", help=f"Whose data they are. {PROBLEM}")
    columns: str | None = option(
        None, "--columns", metavar="NAME=COLUMN,...", help="Names in a table."
    )


@dataclass(frozen=True)
class Asked:
    """Data, the recipe of a network on them where one is asked for, and where it is kept."""

    data: Transitions
    recipe: Recipe | None
    checkpoint: Checkpoint


def check(options: LearnOptions) -> Asked:
    """Read the data, and see that the model can be made of them."""
    from ocp.errors import InputError, choose
    from ocp.store import atomic
    from ocp.store.checkpoint import Checkpoint
    from reports.cli.request import check_place

    choose("model", options.model, MODELS)
    network = options.model == "mlp"
    foreign = [f"--{name}" for name in NETWORK if name in options.given and not network]
    if foreign:
        raise InputError(f"{foreign[0]} belongs to a network; drop it or say --model mlp")
    if options.noise < 0 or (options.noise == 0 and not network):
        least = "at least 0" if network else "above 0"
        raise InputError(
            f"--noise: sigma, in normalised units, must be {least}, got {options.noise:g};"
            f" {NOISE:g} is a common choice"
        )
    if options.noise > 1e3:
        raise InputError(
            f"--noise: sigma {options.noise:g} is in standard deviations of the data, which it"
            " would drown; give one such as 0.2"
        )
    hidden = _hidden(options.hidden)
    data = _data(options)
    check_place(options.file, "model")
    recipe = _recipe(options, data, hidden) if network else None
    request = {"data": data.hash, "sigma": options.noise, "hidden": hidden,
               "epochs": options.epochs, "seed": options.seed}  # fmt: skip
    place = atomic.destination(options.file)
    # Beside the file, and nowhere for one that is a device or a FIFO.
    root = place.parent if network and place is not None else None
    return Asked(data, recipe, Checkpoint(root, "", request))


def _recipe(options: LearnOptions, data: Transitions, hidden: tuple[int, ...]) -> Recipe:
    from dynamics.learned.training import Recipe
    from ocp.effort import check_memory
    from ocp.errors import InputError

    layers = pairwise((data.z.shape[1], *hidden, data.x.shape[1]))
    weights = sum(before * after for before, after in layers)
    check_memory(f"--hidden: a network of {weights:.3g} weights", _COPIES * 4.0 * weights)
    try:
        return Recipe(hidden, options.epochs, held_out=HELD_OUT)
    except ValueError as error:
        raise InputError(str(error)) from error


def _training(options: LearnOptions, asked: Asked, recipe: Recipe) -> Training:
    from dynamics.learned.training import Training
    from ocp.errors import InputError

    state, samples = asked.checkpoint.state("training"), asked.data.samples()
    try:
        return Training(samples, options.noise, recipe, options.seed, state)
    except ValueError as error:
        raise InputError(str(error)) from error


def _hidden(text: str) -> tuple[int, ...]:
    from ocp.errors import InputError
    from ocp.words.numbers import whole

    units = [whole(part) for part in text.split(",")]
    if not all(count is not None and 0 < count <= 100_000 for count in units):
        raise InputError(
            f"--hidden: expected whole numbers from 1 to 100000 with commas, such as 128,128, got"
            f" {text!r}"
        )
    return tuple(count for count in units if count is not None)


def _data(options: LearnOptions) -> Transitions:
    """Read the data; those of a problem must be of its states and inputs."""
    from dynamics.learned.tables import TABLES, read_table
    from ocp.errors import InputError
    from ocp.store import models
    from reports.cli.request import assignments

    spec = _spec(options)
    system = None if spec is None else spec.problem().system
    signals = None if system is None else (system.states, system.inputs)
    if options.data.suffix not in TABLES:
        if options.columns is not None:
            raise InputError(
                f"--columns maps those of a table, and {options.data} is none; drop it"
            )
        data = models.load_transitions(options.data)
    else:
        pairs = None if options.columns is None else options.columns.split(",")
        columns = assignments("--columns", pairs)
        told = {} if spec is None else {"problem": spec.name}
        try:
            data = read_table(options.data, columns, signals, told)
        except ValueError as error:
            raise InputError(str(error)) from error
    try:
        if spec is not None and signals is not None:
            data.check_signals(*signals, spec.name)
        _ = data.samples().scales
    except ValueError as error:
        raise InputError(f"{options.data}: {error}") from error
    return data


def _spec(options: LearnOptions) -> ProblemSpec | None:
    from problems import spec

    return None if options.problem is None else spec(options.problem)


def run(options: LearnOptions, asked: Asked) -> int:
    """Learn a step from transitions: their weighted average, or a network on noised inputs.

    A tenth of the rows is held out, and tells how well the model fits. What a network has learned
    is kept: the same command goes on after Ctrl-C.
    """
    import time

    from ocp.store import models
    from reports import learned

    began, epochs, resumed = time.perf_counter(), None, 0
    with asked.checkpoint as checkpoint:
        for line in checkpoint.notes:
            options.output.say(line)
        if asked.recipe is None:
            dataset = _described(options, asked.data, *_averaged(options, asked.data))
        else:
            training = _training(options, asked, asked.recipe)
            resumed = training.epoch
            dataset = _described(options, asked.data, *_trained(options, asked, training))
            epochs = training.epoch
        models.save(dataset, options.file)
        checkpoint.discard()
    document = learned.model_document(dataset)
    for table in (learned.fit_table, learned.outside_table):
        options.output.note(table(document))
    seconds = time.perf_counter() - began
    if resumed:
        options.output.say(f"went on after epoch {resumed}")
    how = "" if epochs is None else f", {epochs} epochs"
    options.output.say(f"model: {options.file} ({options.model}{how}, {seconds:.1f} s)")
    options.output.document(
        {
            **{"file": str(options.file), **document, "seconds": seconds},
            **{"epochs": epochs, "resumed": resumed},
        }
    )
    return 0


def _described(options: LearnOptions, data: Transitions, model: Any, held_out: Any) -> xr.Dataset:
    """A model and how well it fits."""
    from dynamics.learned.fit import fit
    from reports import learned

    fitted = fit(model, data.samples(), held_out, options.noise or NOISE, options.seed)
    return learned.model_dataset(model.dataset(), fitted.dataset(), data, len(held_out))


def _averaged(options: LearnOptions, data: Transitions) -> tuple[Any, Any]:
    """The average of all rows but those held out, and which those are."""
    from dynamics.learned.ewda import EwdaModel
    from dynamics.learned.samples import split_rows

    kept, held_out = split_rows(len(data), HELD_OUT, options.seed)
    z, y = data.z[kept], data.x_next[kept]
    scales, sigma = data.normalisation, options.noise
    return EwdaModel(z, y, scales, sigma, data.origin, options.seed), held_out


def _trained(options: LearnOptions, asked: Asked, training: Training) -> tuple[Any, Any]:
    """The network after its last epoch, and the rows that it was not trained on."""
    from reports import learned
    from reports.cli import interrupt

    try:
        with learned.training_progress(options.quiet, training.epoch, options.epochs) as report:
            for epoch in training.epochs():
                report(epoch)
                interrupt.check()
                if asked.checkpoint.due():
                    asked.checkpoint.save_state("training", **training.state)
    except KeyboardInterrupt:
        asked.checkpoint.save_state("training", **training.state)
        raise
    return training.model(), training.held_out


COMMAND = Command(
    LearnOptions,
    check,
    run,
    examples=(
        "learn data.nc --model ewda -o model.nc",
        "learn data.nc --model mlp --hidden 64,64 --epochs 100 -o model.nc",
    ),
)
