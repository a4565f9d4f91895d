"""The options of all commands: one class each, derived from :class:`Options`, and one parser.

What belongs to every command, or to several, is declared here and checked here: an option given
twice, an empty value and a number that is not finite are refused whatever the command.
"""

from __future__ import annotations

import inspect
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from copy import copy
from dataclasses import MISSING, Field, dataclass, field, fields
from inspect import Parameter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Generic, TypeVar, get_type_hints

import typer
from typer.core import TyperCommand
from typer.models import ArgumentInfo

from reports.cli import streams
from reports.cli.output import Output

if TYPE_CHECKING:
    from ocp.store.stored_run import StoredRun
    from problems.spec import ProblemSpec

T = TypeVar("T")
RUN = "A run: its path, part of its name, or @last, @2, ... from the latest back."
PROBLEM = "Registered name or path/to/file.py."


def option(default: Any, *flags: str, **shown: Any) -> Any:
    """Declare a field as an option: ``MISSING`` or its default, and as ``typer.Option`` has it."""
    return field(default=default, metadata={"typer": typer.Option(*flags, **shown)})


def argument(default: Any = MISSING, **shown: Any) -> Any:
    """Declare a field as a word without a flag, shown as ``typer.Argument`` has it."""
    return field(default=default, metadata={"typer": typer.Argument(**shown)})


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of every command; ``given`` names those on the command line."""

    as_json: bool = option(False, "--json", help="Print one JSON document on stdout.")
    quiet: bool = option(False, "--quiet", "-q", help="No progress and no tables.")
    verbose: int = option(
        0, "--verbose", "-v", count=True, show_default=False,
        help="Log to stderr; -vv for all details.",
    )  # fmt: skip
    debug: bool = option(False, "--debug", help="Show the traceback of an error.")
    given: frozenset[str] = frozenset()

    def check(self) -> None:
        """Raise InputError for values that all commands with these options refuse."""

    @property
    def output(self) -> Output:
        """Streams for results and progress."""
        return Output(self.as_json, self.quiet, self.verbose > 0)

    @property
    def argv(self) -> list[str]:
        """The command line, for a run's record."""
        return ["ocp", *map(_text, sys.argv[1:])]


@dataclass(frozen=True, kw_only=True)
class StoreOptions(Options):
    """Where runs are kept."""

    out: Path = option(Path("runs"), "--out", envvar="OCP_RUNS", help="Directory of the run store.")


@dataclass(frozen=True, kw_only=True)
class RunOptions(StoreOptions):
    """A stored run."""

    run: str = argument(help=RUN)

    @property
    def named_runs(self) -> list[str]:
        """Runs that the command reads, as given."""
        return [self.run]


@dataclass(frozen=True, kw_only=True)
class SourceOptions(StoreOptions):
    """The file of a run's problem: a run is data, and code that it names is never loaded."""

    source: str | None = option(
        None, "--source", metavar="FILE", help="File that defines the problem of the run."
    )

    def own(self, runs: Sequence[StoredRun]) -> ProblemSpec | None:
        """The problem in that file, None without one; warns where it has changed since.

        Raises :class:`~ocp.errors.InputError` where it cannot be read, or is not the runs' problem.
        """
        from problems.plugin import edited, named_file

        found = named_file(self.source, runs)
        for run in runs:
            if warning := edited(run, found):
                self.output.say(warning)
        return found


@dataclass(frozen=True, kw_only=True)
class TagOptions(StoreOptions):
    """Tags of the stored run."""

    tags: list[str] | None = option(
        None, "--tag", metavar="WORD", help="Tag the run; ocp runs --tag WORD finds it."
    )

    def check(self) -> None:
        """Raise InputError for a tag that is not a single word."""
        from ocp.store.meta import check_tags

        super().check()
        check_tags(self.tags or ())


@dataclass(frozen=True, kw_only=True)
class LawOptions(StoreOptions):
    """A contact law and its settings."""

    contact: str = option("barrier", "--contact", help="Contact law; list with ocp laws.")
    law_settings: list[str] | None = option(
        None, "--contact-setting", "-c", metavar="K=V",
        help="Setting of the contact law; list with ocp laws.",
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class ProblemOptions(LawOptions, TagOptions):
    """A problem under a law and a policy, and a report of the result."""

    problem: str = argument(help=PROBLEM)
    params: list[str] | None = option(
        None, "--param", "-p", metavar="K=V",
        help="Parameter of the problem; list with ocp show PROBLEM.",
    )  # fmt: skip
    policy: str = option("open-loop", "--policy", help="open-loop or feedback.")
    settings: list[str] | None = option(
        None, "--setting", "-s", metavar="K=V",
        help="Setting of method, policy or solver; list with ocp settings.",
    )  # fmt: skip
    seed: int = option(0, "--seed", min=0, help="Seed of everything random.")
    pdf: Path | None = option(None, "--pdf", help="Write a PDF report to this file.")


@dataclass(frozen=True, kw_only=True)
class SolverOptions(ProblemOptions):
    """A method and a solver."""

    method: str = option("direct", "--method", help="direct, multiple-shooting, ...")
    solver: str = option("ipopt", "--solver", help="ipopt, fatrop, uno or sleqp.")


@dataclass(frozen=True)
class Command(Generic[T]):
    """One command: its options, the check before any work, and the work.

    ``check(options)`` raises :class:`~ocp.errors.InputError` or a related error for bad input;
    ``run(options, checked)`` returns the exit code, and its docstring is the command's help. The
    help ends with ``examples``, lines without ``ocp``, and the text of ``epilog()``.
    """

    options: type[Any]
    check: Callable[[Any], T]
    run: Callable[[Any, T], int]
    epilog: Callable[[], str] | None = None
    examples: tuple[str, ...] = ()


def carry_out(command: Command[T], options: Options) -> int:
    """Check the options of a command, then do its work, with its log on stderr under ``-v``."""
    if options.as_json:
        streams.reserve()
    with streams.log_to_stderr(options.verbose), _understood(getattr(options, "named_runs", ())):
        options.check()
        return work(command, options, command.check(options))


@contextmanager
def _understood(runs: Sequence[str]) -> Iterator[None]:
    """Report a run whose content is inconsistent, though its checksums agree, as damaged."""
    try:
        yield
    except (ArithmeticError, AssertionError, AttributeError, LookupError, RuntimeError, TypeError,
            ValueError) as error:  # fmt: skip
        if not runs or hasattr(error, "exit_code"):
            raise
        from ocp.errors import DamagedRun

        raise DamagedRun(
            f"{', '.join(runs)} cannot be shown: its content is inconsistent"
            f" ({type(error).__name__}: {error}); if this program wrote it, that is a bug in the"
            " workbench, and --debug shows its location"
        ) from error


def work(command: Command[T], options: Options, checked: T) -> int:
    """Run a checked command; bad input is refused before, never after."""
    return command.run(options, checked)


def click_command(name: str, command: Command[Any]) -> Any:
    """Make what parses the command line of ``command``: each field of its options is an option."""
    shown = [field for field in fields(command.options) if field.name != "given"]
    # Those of all commands stand last, as they do in every help text.
    shown.sort(key=lambda field: field.name in {common.name for common in fields(Options)})
    hints = get_type_hints(command.options, include_extras=True)
    parameters = {"context": (typer.Context, MISSING)} | {
        field.name: (_annotation(hints[field.name], field), field.default) for field in shown
    }

    def called(context: typer.Context, **values: Any) -> int:
        sources = {key: context.get_parameter_source(key) for key in values}
        given = (k for k, source in sources.items() if source and source.name == "COMMANDLINE")
        at_home = {key: _at_home(value) for key, value in values.items()}
        return carry_out(command, command.options(**at_home, given=frozenset(given)))

    called.__doc__ = command.run.__doc__
    called.__annotations__ = {key: annotation for key, (annotation, _) in parameters.items()}
    called.__signature__ = inspect.Signature([
        Parameter(key, Parameter.KEYWORD_ONLY, annotation=annotation,
                  default=Parameter.empty if default is MISSING else default)
        for key, (annotation, default) in parameters.items()
    ])  # fmt: skip
    parser = {"command": command, "hints": get_type_hints(command.options)}
    single = typer.Typer(
        rich_markup_mode=None, pretty_exceptions_enable=False, add_completion=False
    )
    single.command(name, cls=type("Parser", (Strict,), parser))(called)
    return typer.main.get_command(single)


def _at_home(value: Any) -> Any:
    """The value of an option, with a leading ~ replaced by the home directory."""
    if isinstance(value, list):
        return [_at_home(one) for one in value]
    if not (isinstance(value, str | Path) and str(value).startswith("~")):
        return value
    from ocp.validation import expand_path

    return type(value)(expand_path(value))


def _annotation(hint: Any, field: Field[Any]) -> Any:
    if not field.metadata:
        return hint
    shown = copy(field.metadata["typer"])
    if isinstance(shown, ArgumentInfo) and shown.metavar is None:
        shown.metavar = field.name.upper()
    return Annotated[hint, shown]


class Strict(TyperCommand):
    """A command that refuses repeated options, empty texts, and malformed numbers."""

    command: Command[Any]
    hints: dict[str, Any]

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        """Write the examples and the epilog below the options."""
        if self.command.examples:
            formatter.write("\nExamples:\n")
            formatter.write("".join(f"  ocp {line}\n" for line in self.command.examples))
        if self.command.epilog is not None:
            formatter.write(f"\n{self.command.epilog()}\n")

    def make_parser(self, ctx: Any) -> Any:
        """Return the parser; it reads numbers as all settings are read."""
        parser = super().make_parser(ctx)
        apart = parser.parse_args

        def parse_args(args: list[str]) -> Any:
            raw, *rest = apart(args=args)
            return {name: self._number(ctx, name, word) for name, word in raw.items()}, *rest

        parser.parse_args = parse_args
        return parser

    def _number(self, ctx: Any, name: str, word: Any) -> Any:
        """The word of an option, a number in the form that the parser of its type accepts."""
        hint = self.hints.get(name)
        if hint is None or not isinstance(word, str) or not word.strip():
            return word
        from ocp.validation import parse_number

        try:
            return str(parse_number(word, hint))
        except ValueError as error:
            label = next(_label(one) for one in self.params if one.name == name)
            return ctx.fail(f"{label} must be {error}, got {word!r}")

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Read the command line; bad words are usage errors."""
        raw, _, order = self.make_parser(ctx).parse_args(args=list(args))
        for parameter, times in Counter(order).items():
            label = _label(parameter)
            if times > 1 and not (parameter.multiple or getattr(parameter, "count", False)):
                ctx.fail(f"{label} is given {times} times; give it once")
            value = raw.get(parameter.name)
            for word in value if isinstance(value, list | tuple) else [value]:
                if isinstance(word, str) and not word.strip():
                    ctx.fail(f"{label} is empty; give it a value")
                if isinstance(word, str) and not _is_text(word):
                    ctx.fail(f"{label} is not valid UTF-8 text, so no run can record it")
        return super().parse_args(ctx, args)


def _text(word: str) -> str:
    """The word in UTF-8; under an ASCII locale its bytes reach Python as lone surrogates.

    Raises ``UnicodeError`` for invalid UTF-8.
    """
    return word.encode("utf-8", "surrogateescape").decode("utf-8")


def _is_text(word: str) -> bool:
    try:
        _text(word)
    except UnicodeError:
        return False
    return True


def _label(parameter: Any) -> str:
    return parameter.opts[0] if parameter.param_type_name == "option" else parameter.name.upper()
