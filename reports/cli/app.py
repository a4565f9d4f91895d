"""The program ``ocp``: its commands, and how every failure becomes a sentence and an exit code."""

from __future__ import annotations

import errno
import re
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from reports.cli import (
    animate_command,
    continue_command,
    doctor_command,
    estimate_command,
    export_command,
    figure_command,
    list_command,
    replay_command,
    report_command,
    runs_command,
    show_command,
    solve_command,
    sweep_command,
)
from reports.cli.learning import (
    collect_command,
    evaluate_command,
    learn_command,
    train_command,
)
from reports.cli.named import laws_command, methods_command, settings_command
from reports.cli.options import register
from reports.cli.shell import document, interrupt, logs, streams
from reports.cli.shell.program import Program, tell_version
from reports.cli.stored import rm_command, save_as_command

app = typer.Typer(
    cls=Program,
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)


@app.callback()
def _program(
    version: Annotated[
        bool,
        typer.Option("--version", is_eager=True, callback=tell_version, help="Show the version."),
    ] = False,
) -> None:
    """Optimal control through contact: solve, replay, continue and report named problems."""


for name, command in {
    "list": list_command.COMMAND,
    "laws": laws_command.COMMAND,
    "methods": methods_command.COMMAND,
    "settings": settings_command.COMMAND,
    "show": show_command.COMMAND,
    "solve": solve_command.COMMAND,
    "replay": replay_command.COMMAND,
    "continue": continue_command.COMMAND,
    "sweep": sweep_command.COMMAND,
    "estimate": estimate_command.COMMAND,
    "collect": collect_command.COMMAND,
    "learn": learn_command.COMMAND,
    "train": train_command.COMMAND,
    "evaluate": evaluate_command.COMMAND,
    "figure": figure_command.COMMAND,
    "report": report_command.COMMAND,
    "animate": animate_command.COMMAND,
    "export": export_command.COMMAND,
    "runs": runs_command.COMMAND,
    "runs rm": rm_command.COMMAND,
    "runs export": save_as_command.COMMAND,
    "doctor": doctor_command.COMMAND,
}.items():
    register(app, name, command)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code: 0 done, 2 usage, 3 not converged, 4 damaged run.

    A solve that Ctrl-C ended and whose best point was stored has not converged; what else Ctrl-C
    ended gives 130. Errors go to stderr in one or two lines; ``--debug`` shows the traceback too.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    streams.prepare()
    quiet = "-q" in given or "--quiet" in given
    try:
        with logs.libraries_silenced(quiet), interrupt.watched():
            command = typer.main.get_command(app)
            code = command.main(args=given, prog_name="ocp", standalone_mode=False)
            interrupt.check()
            streams.flush()
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
        # The process itself goes on to its end, where libraries still print.
        if arguments is not None:
            document.release()
    return code if isinstance(code, int) else 0


def _folder_is_gone() -> bool:
    try:
        Path.cwd()
    except FileNotFoundError:
        return True
    return False


_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)


def _stopped() -> int:
    streams.abandon()
    print("stopped by the user; what was finished is kept", file=sys.stderr)
    return interrupt.EXIT_CODE


def _explain(error: BaseException) -> tuple[str, int]:
    """Return the sentence and the exit code of anything that was raised."""
    # By what they have, not by type: typer brings click along under a name of its own, and to
    # import ocp.errors would load CasADi for every ocp --help.
    if hasattr(error, "format_message"):
        message = error.format_message()  # pyright: ignore[reportAttributeAccessIssue]
        if not message or type(error).__name__ == "NoArgsIsHelpError":
            return "", 2
        return f"{_shortened(message).rstrip('.')}; ocp --help shows what there is", 2
    if isinstance(code := getattr(error, "exit_code", None), int):
        return _shortened(str(error)), code
    # rich turns a pipe that broke into an exit of its own.
    if isinstance(error.__context__ if isinstance(error, SystemExit) else error, BrokenPipeError):
        streams.abandon()
        return "", 1
    if isinstance(error, OSError) and error.errno in _FULL:
        streams.abandon()
        where = f" to {_shortened(str(error.filename))}" if error.filename is not None else ""
        return f"cannot write{where}: {error.strerror}; free some space or write elsewhere", 1
    if isinstance(error, ImportError):
        from ocp.distribution import hiding

        if told := hiding():
            return told, 2
    if isinstance(error, OSError) and error.filename is not None:
        reason = f"{error.strerror}; name another file or directory"
        return f"cannot use {_shortened(str(error.filename))}: {reason}", 2
    if isinstance(error, FileNotFoundError) and _folder_is_gone():
        return "the working folder is gone; change into one that is there", 2
    if isinstance(error, MemoryError):
        return "this does not fit into memory; take fewer steps, scenarios or samples", 2
    return (
        f"internal fault, {type(error).__name__}: {_shortened(str(error))}\n"
        "this is a defect of the workbench; --debug shows where it lies",
        1,
    )


def _shortened(message: str) -> str:
    """Leave out the middle of words that no name or path needs, and write what is no text so.

    Nothing that a message quotes reaches a terminal as a command to it.
    """
    message = message.encode("utf-8", "backslashreplace").decode()
    message = re.sub(r"[\x00-\x09\x0b-\x1f\x7f-\x9f]", lambda sign: repr(sign[0])[1:-1], message)
    return re.sub(r"\S{200,}", lambda word: f"{word[0][:60]}...{word[0][-30:]}", message)
