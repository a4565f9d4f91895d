"""``ocp collect PROBLEM --samples n -o FILE``: transitions of a problem as training data."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

from dynamics.learned.collecting import collect
from dynamics.learned.region import Region
from dynamics.learned.transitions import LEAST
from ocp.effort import check_memory
from ocp.errors import InputError
from ocp.problem import Problem
from ocp.store import models
from problems import spec
from problems.objectives import objective_names
from problems.regions import region_of
from reports import learned
from reports.cli.learning.options import CollectOptions
from reports.cli.request import assignments, check_place, input_errors, whole


@dataclass(frozen=True)
class CollectRequest:
    """A problem at parameters, the region of its transitions, and their number."""

    name: str
    params: dict[str, Any]
    problem: Problem
    region: Region
    samples: int


def check(options: CollectOptions) -> CollectRequest:
    """Build the problem, find its region, and check memory and file."""
    if options.problem in objective_names():
        raise InputError(
            f"{options.problem} is an objective without dynamics and has no transitions"
        )
    found = spec(options.problem)
    given = assignments("-p", options.params)
    params, problem = found.params(given), found.problem(given)
    samples, system = whole("--samples", options.samples), problem.system
    least = LEAST * (system.nx + system.nu)
    if samples < least:
        raise InputError(
            f"--samples: {samples} transitions are too few for a model; {found.name} needs at"
            f" least {least}, ten per state and input"
        )
    check_memory(f"{samples} transitions", 32.0 * samples * (2 * system.nx + system.nu))
    region = region_of(found, params, problem)
    check_place(options.file, "data")
    return CollectRequest(found.name, params.model_dump(), problem, region, samples)


def run(options: CollectOptions, request: CollectRequest) -> int:
    """Draw states without penetration and inputs, and advance each by one step of the exact law."""
    began, step = time.perf_counter(), request.problem.exact_step
    origin = {"problem": request.name, "parameters": request.params}
    with input_errors(f"{request.name}: "):
        data = collect(step, request.region, request.samples, options.seed, provenance=origin)
    models.save(data.dataset(), options.file)
    document, seconds = learned.data_document(data), time.perf_counter() - began
    for line in learned.lines(document):
        options.output.note(line)
    options.output.note(learned.coordinate_table(document))
    options.output.say(f"data: {options.file} ({len(data)} transitions, {seconds:.1f} s)")
    options.output.document({"file": str(options.file), **document, "seconds": seconds})
    return 0
