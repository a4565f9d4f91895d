"""The program ``ocp``: parser and execution of its commands."""

from __future__ import annotations

import inspect
import sys
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import MISSING, Field, fields
from importlib import import_module
from importlib.util import LazyLoader, find_spec, module_from_spec
from inspect import Parameter
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer
from typer.core import TyperCommand, TyperGroup

from reports.cli import interrupt, streams
from reports.cli.commands import COMMANDS
from reports.cli.completion import field_completion
from reports.cli.failures import explain
from reports.cli.options.shared import Options, decode_utf8


def execute(options: Options) -> int:
    """Check the options of a command, run it, and return its exit code; ``-v`` logs to stderr."""
    if options.as_json:
        streams.redirect_stdout()
    module, _, name = options.code.partition(":")
    with streams.log_to_stderr(options.verbose), _damage_reported(options.named_runs):
        options.check()
        if "numpy" in sys.modules and "scipy" not in sys.modules:
            # SciPy copies the namespace of NumPy, and so would load its Fortran compiler and its test framework.
            load_on_use("numpy.f2py", "numpy.testing")
        code = import_module(module)
        checked = getattr(code, f"check_{name}" if name else "check")(options)
        return run_checked(getattr(code, f"run_{name}" if name else "run"), options, checked)


def load_on_use(*names: str) -> None:
    """Put modules that their first use loads in the place of submodules that are not loaded."""
    for name in names:
        spec = None if name in sys.modules else find_spec(name)
        if spec is not None and spec.loader is not None:
            spec.loader = LazyLoader(spec.loader)
            sys.modules[name] = module = module_from_spec(spec)
            spec.loader.exec_module(module)
            package, _, attribute = name.rpartition(".")
            setattr(sys.modules[package], attribute, module)


@contextmanager
def _damage_reported(runs: Sequence[str]) -> Iterator[None]:
    """Convert an error in this context that inconsistent content of ``runs`` causes to DamagedRun."""
    try:
        yield
    except (ArithmeticError, AssertionError, AttributeError, LookupError, RuntimeError, TypeError, ValueError) as error:
        if not runs or hasattr(error, "exit_code"):
            raise
        from ocp.errors import DamagedRun

        raise DamagedRun(
            f"{', '.join(runs)} cannot be shown: its content is inconsistent"
            f" ({type(error).__name__}: {error}); if this program wrote it, that is a bug in the"
            " workbench, and --debug shows its location"
        ) from error


def run_checked(run: Callable[[Any, Any], int], options: Options, checked: Any) -> int:
    """Run a checked command and return its exit code; tests replace this function to stop after the checks."""
    return run(options, checked)


def click_command(name: str, options: type[Options]) -> Any:
    """Return the parser of a command, with one option for each field of its options class."""
    option_fields = [field for field in fields(options) if field.name != "explicit"]
    # The options that all commands share come last in every help text.
    option_fields.sort(key=lambda field: field.name in {common.name for common in fields(Options)})
    hints = get_type_hints(options)
    parameters = [Parameter("context", Parameter.KEYWORD_ONLY, annotation=typer.Context)]
    parameters += [_parameter(field, hints[field.name]) for field in option_fields]

    def run_options(context: typer.Context, **values: Any) -> int:
        parameter_sources = {key: context.get_parameter_source(key) for key in values}
        explicit = (k for k, source in parameter_sources.items() if source and source.name == "COMMANDLINE")
        expanded_values = {key: _at_home(value) for key, value in values.items()}
        return execute(options(**expanded_values, explicit=frozenset(explicit)))

    run_options.__doc__ = options.__doc__
    run_options.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    run_options.__signature__ = inspect.Signature(parameters)
    parser = type("Parser", (StrictCommand,), {"declared": options, "hints": hints})
    single = typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False, add_completion=False)
    single.command(name, cls=parser)(run_options)
    return typer.main.get_command(single)


def _parameter(field: Field[Any], hint: Any) -> Parameter:
    """Return a typer parameter for a field of options; its flag is ``--name`` unless the field declares a long flag."""
    metadata, flags = dict(field.metadata), field.metadata["flags"]
    parameter_class = metadata.pop("make")
    del metadata["flags"]
    limits = metadata.pop("limits")
    # Typer only shows these limits; the numbers are checked when the words are parsed.
    metadata |= {key: limits[name] for key, name in (("min", "least"), ("max", "most")) if name in limits}
    if parameter_class is typer.Argument:
        metadata.setdefault("metavar", field.name.upper())
    elif not any(flag.startswith("--") for flag in flags):
        flags = (f"--{field.name.replace('_', '-')}", *flags)
    default = Parameter.empty if field.default is MISSING else field.default
    annotation = Annotated[hint, parameter_class(*flags, **metadata, autocompletion=field_completion(field.name))]
    return Parameter(field.name, Parameter.KEYWORD_ONLY, annotation=annotation, default=default)


def _at_home(value: Any) -> Any:
    """Return the value of an option, with a leading ~ replaced by the home directory."""
    if isinstance(value, list):
        return [_at_home(entry) for entry in value]
    if not (isinstance(value, str | Path) and str(value).startswith("~")):
        return value
    from ocp.validation import expand_path

    return type(value)(expand_path(value))


class StrictCommand(TyperCommand):
    """Typer command that rejects repeated options, empty texts and malformed numbers."""

    declared: type[Options]
    hints: dict[str, Any]

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        """Write the examples and the epilog below the options."""
        formatter.write("\nExamples:\n")
        formatter.write("".join(f"  ocp {line}\n" for line in self.declared.examples))
        formatter.write(self.declared.epilog())

    def make_parser(self, ctx: Any) -> Any:
        """Return a parser that reads numbers like settings (1e5 as an integer) and rejects malformed words."""
        parser = super().make_parser(ctx)
        parse = parser.parse_args

        def parse_args(args: list[str]) -> Any:
            # During completion the last option has no value yet, and with it typer would read none of the options.
            completes_option = ctx.resilient_parsing and bool(args) and args[-1].startswith("-")
            words_by_name, remaining, order = parse(args=args[:-1] if completes_option else args)
            numbers = {name: self._number(ctx, name, word) for name, word in words_by_name.items()}
            self._check(ctx, words_by_name, order)
            return numbers, remaining, order

        parser.parse_args = parse_args
        return parser

    def _number(self, ctx: Any, name: str, word: Any) -> Any:
        """Return the word of an option; a number is rewritten in the form that typer's parser expects."""
        hint = self.hints.get(name)
        if hint is None or not isinstance(word, str) or not word.strip():
            return word
        from dynamics.errors import InputError
        from dynamics.settings import parse_number, read_value

        label = next(_label(parameter) for parameter in self.params if parameter.name == name)
        limits = next(field.metadata["limits"] for field in fields(self.declared) if field.name == name)
        try:
            return str(read_value(label, word, hint, **limits) if limits else parse_number(word, hint))
        except InputError as error:
            return ctx.fail(str(error))
        except ValueError as error:
            return ctx.fail(f"{label} must be {error}, got {word!r}")

    def _check(self, ctx: Any, raw: dict[str, Any], order: list[Any]) -> None:
        """Reject repeated options, empty words, and words that are not UTF-8."""
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


def _is_text(word: str) -> bool:
    try:
        decode_utf8(word)
    except UnicodeError:
        return False
    return True


def _label(parameter: Any) -> str:
    return parameter.opts[0] if parameter.param_type_name == "option" else parameter.name.upper()


DISTRIBUTION = "centralpath"
"""Name of the distribution; ``--version`` prints its version."""
EXAMPLES = ("list", "show push-disc", "solve push-disc --contact exact", "runs", "solve --help")
"""Commands for a first try, printed below the help of ``ocp``."""


class CommandGroup(TyperGroup):
    """Group of all commands; the name of a command may have two words, such as ``runs rm``."""

    def __init__(self, **group_options: Any) -> None:
        super().__init__(**group_options)
        self.commands = dict.fromkeys(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return the parser of a command, built at its first use; None for an unknown command."""
        if cmd_name in COMMANDS and self.commands[cmd_name] is None:
            self.commands[cmd_name] = click_command(cmd_name, COMMANDS[cmd_name])
        return self.commands.get(cmd_name)

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[Any, Any, list[str]]:
        """Return name, parser and arguments of the command given by the first two words or, failing that, the first."""
        two = " ".join(args[:2])
        if len(args) > 1 and two in COMMANDS:
            args = [two, *args[2:]]
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write every command with the first paragraph of its help."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, first_paragraph(self.get_command(ctx, name).help)) for name in COMMANDS])

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        """Write the commands for a first try."""
        formatter.write("\nExamples:\n")
        formatter.write("".join(f"  ocp {line}\n" for line in EXAMPLES))


def first_paragraph(text: str | None) -> str:
    """Return the first paragraph of a help text on one line."""
    return " ".join((text or "").partition("\n\n")[0].split())


def _print_version(is_requested: bool) -> None:
    if is_requested:
        from importlib.metadata import version

        print(f"{DISTRIBUTION} {version(DISTRIBUTION)}")
        raise typer.Exit


app = typer.Typer(
    cls=CommandGroup,
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)


@app.callback()
def _program(
    version: Annotated[
        bool, typer.Option("--version", is_eager=True, callback=_print_version, help="Show the version.")
    ] = False,
) -> None:
    """Optimal control through contact: solve, replay, continue and report named problems."""


def load_commands() -> dict[str, Any]:
    """Return a mapping from the name of each command to its parser."""
    group: Any = typer.main.get_command(app)
    return {name: group.get_command(None, name) for name in COMMANDS}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code: 0 done, 2 usage, 3 not converged, 4 damaged run.

    After Ctrl-C a solve that stored its best iterate returns 3, and any other command returns 130. Errors are
    printed on stderr in one or two lines; ``--debug`` adds the traceback.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    streams.set_error_handler()
    quiet = "-q" in words or "--quiet" in words
    try:
        with streams.libraries_silenced(quiet), interrupt.watch_interrupts():
            command = typer.main.get_command(app)
            code = command.main(args=words, prog_name="ocp", standalone_mode=False)
            interrupt.raise_if_interrupted()
            # Flush here, where a failure to write can still be reported.
            sys.stdout.flush()
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt) or interrupt.was_interrupted():
            streams.discard_buffers()
            print("stopped by the user; finished work is kept", file=sys.stderr)
            return interrupt.EXIT_CODE
        if "--debug" in words:
            traceback.print_exc()
        message, code = explain(error)
        if message:
            print(f"error: {message}", file=sys.stderr)
        return code
    finally:
        # Without ``arguments`` the process ends next, and stdout stays redirected, since libraries print at exit.
        if arguments is not None:
            streams.restore_stdout()
    return code if isinstance(code, int) else 0
