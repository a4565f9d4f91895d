"""One parser for all commands, made from the fields of their options.

It refuses an option that is given twice, an empty value, and a number that is not finite.
"""

from __future__ import annotations

import inspect
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import MISSING, Field, fields
from importlib import import_module
from inspect import Parameter
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer
from typer.core import TyperCommand

from reports.cli import streams
from reports.cli.options import Options, decoded


def carry_out(options: Options) -> int:
    """Check the options of a command, then do its work, with its log on stderr under ``-v``."""
    if options.as_json:
        streams.reserve()
    module, _, name = options.code.partition(":")
    with streams.log_to_stderr(options.verbose), _damage_reported(options.named_runs):
        options.check()
        code = import_module(module)
        checked = getattr(code, f"check_{name}" if name else "check")(options)
        return work(getattr(code, f"run_{name}" if name else "run"), options, checked)


@contextmanager
def _damage_reported(runs: Sequence[str]) -> Iterator[None]:
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


def work(run: Callable[[Any, Any], int], options: Options, checked: Any) -> int:
    """Run a checked command; tests replace it to end after the checks."""
    return run(options, checked)


def click_command(name: str, options: type[Options]) -> Any:
    """Make what parses the command line of a command: each field of its options is an option."""
    shown = [field for field in fields(options) if field.name != "given"]
    # Those of all commands stand last, as they do in every help text.
    shown.sort(key=lambda field: field.name in {common.name for common in fields(Options)})
    hints = get_type_hints(options)
    parameters = [Parameter("context", Parameter.KEYWORD_ONLY, annotation=typer.Context)]
    parameters += [_parameter(field, hints[field.name]) for field in shown]

    def called(context: typer.Context, **values: Any) -> int:
        sources = {key: context.get_parameter_source(key) for key in values}
        given = (k for k, source in sources.items() if source and source.name == "COMMANDLINE")
        at_home = {key: _at_home(value) for key, value in values.items()}
        return carry_out(options(**at_home, given=frozenset(given)))

    called.__doc__ = options.__doc__
    called.__annotations__ = {one.name: one.annotation for one in parameters}
    called.__signature__ = inspect.Signature(parameters)
    parser = type("Parser", (Strict,), {"declared": options, "hints": hints})
    single = typer.Typer(
        rich_markup_mode=None, pretty_exceptions_enable=False, add_completion=False
    )
    single.command(name, cls=parser)(called)
    return typer.main.get_command(single)


def _parameter(field: Field[Any], hint: Any) -> Parameter:
    """A field as typer has it; an option is called ``--name`` unless it has a long flag."""
    shown, flags = dict(field.metadata), field.metadata["flags"]
    make = shown.pop("make")
    del shown["flags"]
    if make is typer.Argument:
        shown.setdefault("metavar", field.name.upper())
    elif not any(flag.startswith("--") for flag in flags):
        flags = (f"--{field.name.replace('_', '-')}", *flags)
    default = Parameter.empty if field.default is MISSING else field.default
    annotation = Annotated[hint, make(*flags, **shown)]
    return Parameter(field.name, Parameter.KEYWORD_ONLY, annotation=annotation, default=default)


def _at_home(value: Any) -> Any:
    """The value of an option, with a leading ~ replaced by the home directory."""
    if isinstance(value, list):
        return [_at_home(one) for one in value]
    if not (isinstance(value, str | Path) and str(value).startswith("~")):
        return value
    from ocp.validation import expand_path

    return type(value)(expand_path(value))


class Strict(TyperCommand):
    """A command that refuses repeated options, empty texts, and malformed numbers."""

    declared: type[Options]
    hints: dict[str, Any]

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        """Write the examples and the epilog below the options."""
        formatter.write("\nExamples:\n")
        formatter.write("".join(f"  ocp {line}\n" for line in self.declared.examples))
        formatter.write(self.declared.epilog())

    def make_parser(self, ctx: Any) -> Any:
        """Return the parser; it reads numbers as all settings are read; bad words are refused."""
        parser = super().make_parser(ctx)
        parse = parser.parse_args

        def parse_args(args: list[str]) -> Any:
            raw, rest, order = parse(args=args)
            numbers = {name: self._number(ctx, name, word) for name, word in raw.items()}
            self._check(ctx, raw, order)
            return numbers, rest, order

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

    def _check(self, ctx: Any, raw: dict[str, Any], order: list[Any]) -> None:
        """Refuse repeated options, empty words, and words that are not UTF-8."""
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
        decoded(word)
    except UnicodeError:
        return False
    return True


def _label(parameter: Any) -> str:
    return parameter.opts[0] if parameter.param_type_name == "option" else parameter.name.upper()
