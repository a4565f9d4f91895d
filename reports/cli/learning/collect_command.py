"""``ocp collect PROBLEM --samples n -o FILE``: transitions of a problem, to learn from."""

from __future__ import annotations

from dataclasses import MISSING, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from reports.cli.options import PROBLEM, Command, Options, argument, option

if TYPE_CHECKING:
    from dynamics.learned.region import Region
    from ocp.problem import Problem


@dataclass(frozen=True, kw_only=True)
class CollectOptions(Options):
    """Of what, how much, and where to."""

    problem: str = argument(help=PROBLEM)
    file: Path = option(MISSING, "--output", "-o", help="The netCDF file to write.")
    params: list[str] | None = option(
        None, "--param", "-p", metavar="K=V", help="Parameter of the problem."
    )
    samples: str = option("1e5", "--samples", "-n", help="Transitions.")
    seed: int = option(0, "--seed", min=0, help="Seed of what is drawn.")


@dataclass(frozen=True)
class Asked:
    """A problem at parameters, where its transitions are drawn, and how many."""

    name: str
    params: dict[str, Any]
    problem: Problem
    region: Region
    samples: int


def check(options: CollectOptions) -> Asked:
    """Build the problem, find its region, and see that there is room for so many rows."""
    from dynamics.learned.transitions import LEAST
    from ocp.effort import check_memory
    from ocp.errors import InputError
    from problems import spec
    from problems.objectives import objective_names
    from problems.regions import region_of
    from reports.cli.request import assignments, check_place, whole

    if options.problem in objective_names():
        raise InputError(
            f"{options.problem} is an objective without dynamics: it has no steps to collect"
        )
    found = spec(options.problem)
    given = assignments("-p", options.params)
    params, problem = found.params(given), found.problem(given)
    samples, system = whole("--samples", options.samples), problem.system
    least = LEAST * (system.nx + system.nu)
    if samples < least:
        raise InputError(
            f"--samples: {samples} transitions are too few to learn from; {found.name} needs at"
            f" least {least}, ten for each of its states and inputs"
        )
    check_memory(f"{samples} transitions", 32.0 * samples * (2 * system.nx + system.nu))
    region = region_of(found, params, problem)
    check_place(options.file, "data")
    return Asked(found.name, params.model_dump(), problem, region, samples)


def run(options: CollectOptions, asked: Asked) -> int:
    """Draw states without penetration and inputs, and step each once under the exact law.

    Half are drawn in the problem's region, half in a tube around the way from start to goal.
    """
    import time

    from dynamics.learned.collecting import collect
    from ocp.errors import InputError
    from ocp.store import models
    from reports import learned

    began, step = time.perf_counter(), asked.problem.exact_step
    told = {"problem": asked.name, "parameters": asked.params}
    try:
        data = collect(step, asked.region, asked.samples, options.seed, provenance=told)
    except ValueError as error:
        raise InputError(f"{asked.name}: {error}") from error
    models.save(data.dataset(), options.file)
    document, seconds = learned.data_document(data), time.perf_counter() - began
    for line in learned.lines(document):
        options.output.note(line)
    options.output.note(learned.coordinate_table(document))
    options.output.say(f"data: {options.file} ({len(data)} transitions, {seconds:.1f} s)")
    options.output.document({"file": str(options.file), **document, "seconds": seconds})
    return 0


COMMAND = Command(
    CollectOptions,
    check,
    run,
    examples=("collect push-1d --samples 1e5 -o data.nc",),
)
