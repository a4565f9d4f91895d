"""The options of all commands: one class each, derived from :class:`Options`, and one parser.

What belongs to every command, or to several, is declared here and checked here: an option given
twice, an empty value and a number that is not finite are refused whatever the command.
"""

from __future__ import annotations

import inspect
import math
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import MISSING, Field, dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Generic, TypeVar, get_type_hints

import typer
from typer.core import TyperCommand

from reports.cli.output import Output

T = TypeVar("T")
RUN = "A run: its path, or part of its name."
PROBLEM = "Registered name or path/to/file.py."


@dataclass(frozen=True, kw_only=True)
class Options:
    """What every command takes; ``given`` names what stood on the command line."""

    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON document on stdout.")] = (
        False
    )
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress and no tables.")] = False
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False
    given: frozenset[str] = frozenset()

    @property
    def output(self) -> Output:
        """Where results and progress go."""
        return Output(self.as_json, self.quiet)

    @property
    def argv(self) -> list[str]:
        """The command line, for a run's record."""
        return ["ocp", *sys.argv[1:]]


@dataclass(frozen=True, kw_only=True)
class StoreOptions(Options):
    """Where runs are kept."""

    out: Annotated[Path, typer.Option("--out", help="Directory of the run store.")] = Path("runs")


@dataclass(frozen=True, kw_only=True)
class LawOptions(StoreOptions):
    """A contact law and its settings."""

    contact: Annotated[str, typer.Option("--contact", help="Contact law; ocp list shows them.")] = (
        "barrier"
    )
    law_settings: Annotated[
        list[str] | None,
        typer.Option("--contact-setting", "-c", metavar="K=V", help="Setting of the contact law."),
    ] = None


@dataclass(frozen=True, kw_only=True)
class ProblemOptions(LawOptions):
    """A problem under a law and a policy, and a report of what comes out."""

    problem: Annotated[str, typer.Argument(help=PROBLEM)]
    params: Annotated[
        list[str] | None,
        typer.Option("--param", "-p", metavar="K=V", help="Parameter of the problem."),
    ] = None
    policy: Annotated[str, typer.Option("--policy", help="open-loop or feedback.")] = "open-loop"
    settings: Annotated[
        list[str] | None,
        typer.Option("--setting", "-s", metavar="K=V", help="Setting of the method or the solver."),
    ] = None
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of everything random.")] = 0
    pdf: Annotated[Path | None, typer.Option("--pdf", help="Write a report here.")] = None


@dataclass(frozen=True, kw_only=True)
class SolverOptions(ProblemOptions):
    """A method and a solver."""

    method: Annotated[str, typer.Option("--method", help="direct, multiple-shooting, ...")] = (
        "direct"
    )
    solver: Annotated[str, typer.Option("--solver", help="ipopt, fatrop, uno or sleqp.")] = "ipopt"


@dataclass(frozen=True)
class Command(Generic[T]):
    """One command: its options, what checks all of them before any work, and the work.

    ``check(options)`` raises :class:`~ocp.errors.InputError`, or its kin, for whatever cannot be;
    ``run(options, checked)`` returns the exit code. Its docstring is the command's help.
    """

    options: type[Any]
    check: Callable[[Any], T]
    run: Callable[[Any, T], int]


def carry_out(command: Command[T], options: Options) -> int:
    """Check the options of a command, then do its work."""
    return work(command, options, command.check(options))


def work(command: Command[T], options: Options, checked: T) -> int:
    """Do what was asked and checked; every command passes here, and nothing is refused after."""
    return command.run(options, checked)


def register(app: typer.Typer, name: str, command: Command[Any]) -> None:
    """Add a command to the program: each field of its options is an option there."""
    hints = get_type_hints(command.options, include_extras=True)
    shown = [field for field in fields(command.options) if field.name != "given"]
    # Those of all commands stand last, as they do in every help text.
    shown.sort(key=lambda field: field.name in {common.name for common in fields(Options)})
    parameters = [inspect.Parameter("context", inspect.Parameter.KEYWORD_ONLY,
                                    annotation=typer.Context)]  # fmt: skip
    parameters += [_parameter(field, hints[field.name]) for field in shown]

    def called(context: typer.Context, **values: Any) -> int:
        sources = {key: context.get_parameter_source(key) for key in values}
        given = (k for k, source in sources.items() if source and source.name == "COMMANDLINE")
        return carry_out(command, command.options(**values, given=frozenset(given)))

    called.__doc__ = command.run.__doc__
    called.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    called.__signature__ = inspect.Signature(parameters)
    app.command(name, cls=Strict)(called)


def _parameter(field: Field[Any], annotation: Any) -> inspect.Parameter:
    default = inspect.Parameter.empty if field.default is MISSING else field.default
    return inspect.Parameter(
        field.name, inspect.Parameter.KEYWORD_ONLY, annotation=annotation, default=default
    )


class Strict(TyperCommand):
    """A command that takes each option once, texts that are not empty, and finite numbers."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Read the words of the command line, and refuse them as a usage error."""
        raw, _, order = self.make_parser(ctx).parse_args(args=list(args))
        for parameter, times in Counter(order).items():
            label = _label(parameter)
            if times > 1 and not parameter.multiple:
                ctx.fail(f"{label} is given {times} times; give it once")
            value = raw.get(parameter.name)
            for word in value if isinstance(value, list | tuple) else [value]:
                if isinstance(word, str) and not word.strip():
                    ctx.fail(f"{label} is empty; give it a value")
                if isinstance(word, str) and not _is_text(word):
                    ctx.fail(f"{label} holds bytes that are no UTF-8 text, which no run can record")
        rest = super().parse_args(ctx, args)
        for parameter in self.params:
            value = ctx.params.get(parameter.name)
            if isinstance(value, float) and not math.isfinite(value):
                ctx.fail(f"{_label(parameter)} must be a finite number, got {value}")
        return rest


def _is_text(word: str) -> bool:
    # What the system could not decode stands in the word as lone surrogates.
    return not any("\ud800" <= character <= "\udfff" for character in word)


def _label(parameter: Any) -> str:
    return parameter.opts[0] if parameter.param_type_name == "option" else parameter.name.upper()
