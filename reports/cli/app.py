"""The program ``ocp``: its commands, and the message and exit code of every failure."""

from __future__ import annotations

import errno
import re
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from reports.cli import interrupt, streams
from reports.cli.commands import COMMANDS
from reports.cli.parser import click_command

NAME = "centralpath"
EXAMPLES = ("list", "show push-disc", "solve push-disc --contact exact", "runs", "solve --help")


class CommandGroup(TyperGroup):
    """The commands; a command may have two words, such as ``runs rm``."""

    def __init__(self, **given: Any) -> None:
        super().__init__(**given)
        self.commands = dict.fromkeys(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Build the parser of a command, or return None for an unknown one."""
        if cmd_name in COMMANDS and self.commands[cmd_name] is None:
            self.commands[cmd_name] = click_command(cmd_name, COMMANDS[cmd_name])
        return self.commands.get(cmd_name)

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[Any, Any, list[str]]:
        """Find the command that the first word names, or the first two."""
        two = " ".join(args[:2])
        if len(args) > 1 and two in COMMANDS:
            args = [two, *args[2:]]
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write every command with the whole first paragraph of its help."""
        with formatter.section("Commands"):
            formatter.write_dl([
                (name, first_paragraph(self.get_command(ctx, name).help)) for name in COMMANDS
            ])  # fmt: skip

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        """Write a few commands to try first."""
        formatter.write("\nExamples:\n")
        formatter.write("".join(f"  ocp {line}\n" for line in EXAMPLES))


def first_paragraph(text: str | None) -> str:
    """The first paragraph of a help text, on one line."""
    return " ".join((text or "").partition("\n\n")[0].split())


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        print(f"{NAME} {version(NAME)}")
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
        bool,
        typer.Option("--version", is_eager=True, callback=_print_version, help="Show the version."),
    ] = False,
) -> None:
    """Optimal control through contact: solve, replay, continue and report named problems."""


def commands() -> dict[str, Any]:
    """Every command by its name, all of them imported."""
    group: Any = typer.main.get_command(app)
    return {name: group.get_command(None, name) for name in COMMANDS}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code: 0 done, 2 usage, 3 not converged, 4 damaged run.

    After Ctrl-C a solve with a stored best point gives 3, everything else 130. Errors go to stderr
    in one or two lines; ``--debug`` adds the traceback.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    streams.prepare()
    quiet = "-q" in given or "--quiet" in given
    try:
        with streams.libraries_silenced(quiet), interrupt.watched():
            command = typer.main.get_command(app)
            code = command.main(args=given, prog_name="ocp", standalone_mode=False)
            interrupt.check()
            # While a failure can still be reported.
            sys.stdout.flush()
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt) or interrupt.seen():
            return _stopped()
        if "--debug" in given:
            traceback.print_exc()
        message, code = _explain(error)
        if message:
            print(f"error: {message}", file=sys.stderr)
        return code
    finally:
        # Not in a process of its own, where libraries still print at the end.
        if arguments is not None:
            streams.release()
    return code if isinstance(code, int) else 0


_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)


def _stopped() -> int:
    streams.abandon()
    print("stopped by the user; finished work is kept", file=sys.stderr)
    return interrupt.EXIT_CODE


def _explain(error: BaseException) -> tuple[str, int]:
    """Return the message and the exit code of an exception."""
    # By attribute, not by type: typer has its own copy of click, and importing ocp.errors would
    # load CasADi for every ocp --help.
    if hasattr(error, "format_message"):
        message = error.format_message()  # pyright: ignore[reportAttributeAccessIssue]
        if not message or type(error).__name__ == "NoArgsIsHelpError":
            return "", 2
        return f"{_shortened(message).rstrip('.')}; see ocp --help", 2
    if isinstance(code := getattr(error, "exit_code", None), int):
        return _shortened(str(error)), code
    # rich turns a broken pipe into SystemExit.
    if isinstance(error.__context__ if isinstance(error, SystemExit) else error, BrokenPipeError):
        streams.abandon()
        return "", 1
    if isinstance(error, OSError) and error.errno in _FULL:
        streams.abandon()
        where = f" to {_shortened(str(error.filename))}" if error.filename is not None else ""
        return f"cannot write{where}: {error.strerror}; free some space or write elsewhere", 1
    if isinstance(error, ImportError):
        from ocp.distribution import shadowing

        if hidden := shadowing():
            return hidden, 2
    if isinstance(error, OSError) and error.filename is not None:
        reason = f"{error.strerror}; name another file or directory"
        return f"cannot use {_shortened(str(error.filename))}: {reason}", 2
    if isinstance(error, FileNotFoundError):
        try:
            Path.cwd()
        except FileNotFoundError:
            return "the working directory no longer exists; change to another one", 2
    if isinstance(error, MemoryError):
        return "not enough memory; use fewer steps, scenarios or samples", 2
    return (
        f"internal error, {type(error).__name__}: {_shortened(str(error))}\n"
        "this is a bug in the workbench; --debug shows its location",
        1,
    )


def _shortened(message: str) -> str:
    """Cut the middle of very long words, and escape control characters and invalid text.

    So no quoted text can control the terminal.
    """
    message = message.encode("utf-8", "backslashreplace").decode()
    message = re.sub(r"[\x00-\x09\x0b-\x1f\x7f-\x9f]", lambda sign: repr(sign[0])[1:-1], message)
    return re.sub(r"\S{200,}", lambda word: f"{word[0][:60]}...{word[0][-30:]}", message)
