"""``ocp mpc PROBLEM``: a receding-horizon controller on a plant, stored as a closed loop."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from dynamics.contact import ContactLaw
from dynamics.settings import read_value
from ocp import store
from ocp.errors import InputError, choose, did_you_mean
from ocp.mpc.controller import Command, Controller
from ocp.mpc.phases import PHASES
from ocp.mpc.plants import Disturbance, Plant, check_mismatch, deviations
from ocp.mpc.rates import samples_per_step
from ocp.mpc.receding import Receding
from ocp.mpc.simulate import ClosedLoop, simulate
from ocp.problem.problem import Problem
from ocp.problem.resources import check_memory
from ocp.store.stored_run import StoredRun
from ocp.transcription.factories import law_record, make_law
from problems.plugin import edited, known_parameters, problem_of, source
from problems.spec import ProblemSpec
from reports.cli import interrupt
from reports.cli.options.mpc import MpcOptions
from reports.cli.request import check_outputs, parse_assignments
from reports.tables.closed_loop import count_table, labelled_arrays, loop_notes, loop_summary, loop_table
from reports.tables.console import live

NOT_SURVIVED = 3
"""Exit code of a closed loop that did not reach its end."""
_DEFAULT_STEPS = 100
"""Minimum of the default number of samples of a closed loop."""


@dataclass(frozen=True)
class MpcRequest:
    """Checked request of ``ocp mpc``: problem, law, disturbances, number of samples, and the run to be tracked."""

    spec: ProblemSpec
    params: dict[str, Any]
    problem: Problem
    law: ContactLaw
    disturbance: Disturbance
    steps: int
    plan: StoredRun | None

    def record(self, options: MpcOptions) -> dict[str, Any]:
        """Return the values that determine the result, as the run stores them."""
        path = self.spec.path
        return {
            "params": self.params,
            "source": None if path is None else str(path),
            **law_record(self.law),
            **{
                key: getattr(options, key)
                for key in ("phase", "plant", "iterations", "budget", "trust", "deadline", "seeds", "seed", "rate")
            },
            "certify": options.certify,
            "samples": self.steps,
            "plan": None if self.plan is None else self.plan.path.name,
            "delay": options.delay or None,
            **{
                key: ", ".join(getattr(options, key) or ()) or None
                for key in ("noise_state", "noise_input", "mismatch", "push")
            },
        }


def check(options: MpcOptions) -> MpcRequest:
    """Build the problem, and check law, rate, plant, disturbances and the plan to be tracked."""
    entry = choose("phase", options.phase, PHASES)
    for flag in ("rate", "deadline"):
        value = getattr(options, flag)
        if value is not None and not value > 0:
            raise InputError(f"--{flag} must be above 0, got {value:g}")
    spec = source(options.problem)
    plan, values, problem = _planned_problem(options, spec)
    receding = Receding.of(problem)
    settings, name = parse_assignments("-c", options.law_settings), options.contact
    if name == "own":
        name = "barrier" if entry.exact is False else "exact"
    is_default_law = options.contact == "own" and not settings
    law = entry.law(None if is_default_law else make_law(name, settings, receding.problem.system))
    r = samples_per_step(problem, options.rate, {})
    steps = options.steps or r * (problem.N if plan else max(_DEFAULT_STEPS, problem.N))
    disturbance = _disturbance(options, problem, steps)
    # The plant's parameters have the same ranges as the problem's parameters.
    spec.params({**values, **disturbance.mismatch})
    Plant(problem, options.plant, disturbance.mismatch, r)
    system = problem.system
    numbers = steps * ((problem.N + 4) * system.nx + 2 * system.nu + 2 * system.nlam + 30)
    check_memory(f"{options.seeds} seeds of {steps} samples", 16.0 * options.seeds * numbers)
    check_outputs(options.out, options.pdf)
    return MpcRequest(spec, spec.params(values).model_dump(), problem, law, disturbance, steps, plan)


def _planned_problem(options: MpcOptions, spec: ProblemSpec) -> tuple[StoredRun | None, dict[str, Any], Problem]:
    """Return the run of ``--plan`` (None without it), and the parameters and the problem, which are those of the run.

    Raises InputError for a run of another problem, and for parameters besides those of the run.
    """
    values = parse_assignments("-p", options.params)
    if options.plan is None:
        return None, values, spec.problem(values)
    plan = options.stored(options.plan)
    plan.check_solve()
    if plan.meta["problem"] != spec.name:
        raise InputError(f"--plan {options.plan}: the run solves {plan.meta['problem']}, not {spec.name}")
    if values:
        raise InputError("-p: the parameters are those of the run of --plan; drop -p")
    if warning := edited(plan, spec):
        options.output.say(f"--plan {options.plan}: {warning}")
    return plan, known_parameters(plan, spec), problem_of(plan, spec)[2]


def _disturbance(options: MpcOptions, problem: Problem, steps: int) -> Disturbance:
    states, inputs = ([signal.name for signal in signals] for signals in (problem.system.states, problem.system.inputs))
    state_noise = _deviation("--noise-state", options.noise_state)
    input_noise = _deviation("--noise-input", options.noise_input)
    deviations(state_noise, states, "--noise-state")
    deviations(input_noise, inputs, "--noise-input")
    mismatch = {
        name: read_value(f"--mismatch {name}", text, float)
        for name, text in parse_assignments("--mismatch", options.mismatch).items()
    }
    check_mismatch(problem, mismatch)
    pushes = _pushes(options.push or (), states, steps)
    return Disturbance(state_noise, input_noise, mismatch, options.delay, pushes)


def _deviation(flag: str, words: Sequence[str] | None) -> float | dict[str, float]:
    """Return one standard deviation for all signals, or a mapping from signal names to standard deviations."""
    words = list(words or ())
    if len(words) == 1 and "=" not in words[0]:
        return read_value(flag, words[0], float)
    if any("=" not in assignment for assignment in words):
        raise InputError(
            f"{flag} takes one number for all signals or name=value for each, got"
            f" {', '.join(words)}; drop one of the two"
        )
    return {name: read_value(f"{flag} {name}", text, float) for name, text in parse_assignments(flag, words).items()}


def _pushes(words: Iterable[str], states: list[str], steps: int) -> dict[int, np.ndarray]:
    """Return a mapping from the index of a sample to the change of the state (nx,) just before this sample."""
    push_at: dict[int, np.ndarray] = {}
    for assignment in words:
        sample, sign, change = assignment.partition(":")
        if not sign:
            raise InputError(f"--push: expected K:name=value, got {assignment!r}; write 20:{states[0]}=1")
        k = read_value(f"--push {assignment}: the sample", sample.strip(), int, least=0, most=steps - 1)
        for name, text in parse_assignments("--push", [change]).items():
            if name not in states:
                raise InputError(
                    f"--push: unknown state {name!r}{did_you_mean(name, states)}; available: {', '.join(states)}"
                )
            push_at.setdefault(k, np.zeros(len(states)))
            push_at[k][states.index(name)] += read_value(f"--push {name}", text, float)
    return push_at


def run(options: MpcOptions, request: MpcRequest) -> int:
    """Build the controller, simulate the closed loop, and store it."""
    with _progress(options, request.steps) as report:
        names = "phase", "iterations", "trust", "deadline", "budget", "rate"
        settings = {name: getattr(options, name) for name in names}
        controller = Controller(request.problem, request.law, plan=request.plan, **settings)
        interrupt.raise_if_interrupted()
        # A KeyboardInterrupt that is raised within a sample could become an error of compiled code.
        with interrupt.defer_interrupts():
            loop = simulate(
                controller,
                request.steps,
                options.plant,
                request.disturbance,
                seeds=options.seeds,
                seed=options.seed,
                certify=options.certify,
                progress=report,
            )
            stored = _store_loop(options, request, controller, loop)
    output = options.output
    output.note(loop_table(stored.meta))
    output.note(count_table(stored.meta["counts"]))
    output.say(stored.meta["verdict"])
    for line in (*controller.notes, *loop_notes(stored.meta)):
        output.say(line)
    findings = [finding.document for finding in loop.verdict.findings]
    output.finish(stored, {**stored.meta, "findings": findings}, options.pdf, request.spec)
    output.note(f"Look at it with ocp report {stored.path.name} -o loop.pdf, or ocp animate.")
    interrupt.raise_if_interrupted()
    return 0 if stored.meta["status"] in ("done", "warnings") else NOT_SURVIVED


def _store_loop(options: MpcOptions, request: MpcRequest, controller: Controller, loop: ClosedLoop) -> StoredRun:
    """Store the simulated samples and return the run; raises KeyboardInterrupt if there are none."""
    data = labelled_arrays(loop, request.disturbance.mismatch)
    if not data.sizes["seed"]:
        raise KeyboardInterrupt
    meta = {
        "kind": "closed-loop",
        "argv": options.argv,
        "tags": options.tags,
        "seed": options.seed,
        "record": request.record(options),
        "source_digest": request.spec.digest,
        **loop_summary(loop, data, controller.notes),
    }
    first_seed = data.isel(node=slice(0, int(data["ended"].values[0]) + 1))
    problem_part = store.problem_parts(request.problem, first_seed)
    return store.write_run(options.out, request.spec.name, data, meta, problem_part)


@contextmanager
def _progress(options: MpcOptions, steps: int) -> Iterator[Any]:
    """Yield a callback that reports samples: a live line on a terminal, otherwise a line every two seconds."""
    with live(not options.output.progress, every_s=2.0) as show:
        show(f"{options.problem}: building the controller", now=True)

        def report(seed: int, k: int, command: Command) -> None:
            interrupt.raise_if_interrupted()
            merit = f", merit {command.merit:.5g}" if math.isfinite(command.merit) else ""
            progress = f"seed {seed + 1} of {options.seeds}, sample {k + 1} of {steps}"
            show(f"{progress}, {1e3 * command.seconds:.1f} ms{merit}")

        yield report
