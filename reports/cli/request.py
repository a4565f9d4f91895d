"""Checked values of a command line, and the request of a solve with its session."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from ocp import store
from ocp.errors import InputError
from ocp.routes.session import Session
from ocp.solve.solve_request import SolveRequest
from ocp.store import atomic
from ocp.transcription.factories import law_name
from problems import ProblemSpec
from problems.plugin import source
from reports.cli.options.shared import SolverOptions


def parse_assignments(option: str, words: Iterable[str] | None) -> dict[str, str]:
    """Return words such as ``a=1`` as a dictionary; raises InputError for other words and repeated names."""
    values: dict[str, str] = {}
    for item in words or ():
        name, sign, value = (piece.strip() for piece in item.partition("="))
        if not (name and sign and value):
            raise InputError(f"{option}: expected name=value, got {item!r}; write {option} name=1.0")
        if name in values:
            raise InputError(f"{option}: {name} is given twice; give it once")
        values[name] = value
    return values


@contextmanager
def input_errors(prefix: str = "") -> Iterator[None]:
    """Convert a ValueError in the context to an InputError, with ``prefix`` before its message."""
    try:
        yield
    except ValueError as error:
        raise InputError(f"{prefix}{error}") from error


EXAMPLES = {
    "PDF": "report.pdf",
    "C file": "rollout.c",
    "transitions": "data.nc",
    "model": "model.nc",
    "figure": "figure.pdf",
    "data": "data.csv",
}
"""Mapping from each kind of output to an example of a file name."""
_FIXED_SUFFIX = ("PDF", "C file", "transitions", "model")
"""Kinds of output whose files must have the suffix of the example."""


def check_outputs(out: Path, pdf: Path | None) -> None:
    """Raise InputError if ``out`` cannot store a run, or ``pdf`` cannot be written."""
    store.check_writable(out)
    if pdf is not None:
        check_output_file(pdf, "PDF")


def check_output_file(file: Path, kind: str) -> None:
    """Raise InputError if ``file`` has the wrong suffix for its kind, or cannot be written."""
    if file.is_dir():
        example = EXAMPLES.get(kind, "report.gif")
        raise InputError(f"{file} is a directory; name a file such as {file / example}")
    ending = Path(EXAMPLES[kind]).suffix if kind in _FIXED_SUFFIX else file.suffix
    # A device or a pipe may have any name.
    if file.suffix.lower() != ending and (file.is_file() or not file.exists()):
        raise InputError(
            f"the {kind} must end in {ending}, got {str(file)!r}; use {file.with_suffix(ending).name!r}, for example"
        )
    with atomic.write_errors(f"the {kind} to {file}"):
        target = atomic.replaceable_path(file)
    if target is None:
        return
    try:
        store.check_writable(target.parent)
    except InputError as error:
        message = str(error).replace("the run", f"the {kind}").replace("with --out", "for it")
        raise InputError(message) from error


@dataclass(frozen=True)
class Request:
    """Checked options of a command that solves a problem: the problem's spec, the request, and its session."""

    spec: ProblemSpec
    solve_request: SolveRequest
    session: Session

    @classmethod
    def read(cls, options: SolverOptions) -> Request:
        """Return what the options describe; raises InputError for the first invalid value."""
        spec, request = read_request(options)
        return cls(spec, request, request.session(spec))

    @cached_property
    def params(self) -> dict[str, Any]:
        """Mapping from all parameters of the problem to their values."""
        return self.spec.params(self.solve_request.params).model_dump()

    @property
    def origin(self) -> dict[str, Any]:
        """Parameters and source file from which the problem of a run is rebuilt."""
        source = None if self.spec.path is None else str(self.spec.path)
        return {"params": self.params, "source": source}


def read_request(options: SolverOptions) -> tuple[ProblemSpec, SolveRequest]:
    """Return the problem, and the request of its solve, with the absolute path of a problem file.

    Raises :class:`~ocp.errors.InputError` for an unknown problem and for malformed assignments.
    """
    spec = source(options.problem)
    return spec, SolveRequest(
        spec.name if spec.path is None else str(spec.path),
        params=parse_assignments("-p", options.params),
        contact=law_name(options.contact),
        contact_settings=parse_assignments("-c", options.law_settings),
        method=options.method,
        policy=options.policy,
        solver=options.solver,
        settings=parse_assignments("-s", options.settings),
    )
