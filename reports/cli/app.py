"""The program ``ocp``: its commands, and how every failure becomes a sentence and an exit code."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Sequence

import typer

from reports.cli import (
    animate_command,
    continue_command,
    doctor_command,
    estimate_command,
    export_command,
    figure_command,
    interrupt,
    list_command,
    replay_command,
    report_command,
    runs_command,
    show_command,
    solve_command,
)

app = typer.Typer(
    help="Optimal control through contact: solve, replay, continue and report named problems.",
    add_completion=False,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
for name, function in {
    "list": list_command.run,
    "show": show_command.run,
    "solve": solve_command.run,
    "replay": replay_command.run,
    "continue": continue_command.run,
    "estimate": estimate_command.run,
    "figure": figure_command.run,
    "report": report_command.run,
    "animate": animate_command.run,
    "export": export_command.run,
    "runs": runs_command.run,
    "doctor": doctor_command.run,
}.items():
    app.command(name)(function)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code: 0 done, 2 usage, 3 not converged, 4 damaged run.

    Errors go to stderr in one or two lines; ``--debug`` shows the traceback as well.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    command = typer.main.get_command(app)
    try:
        with interrupt.watched():
            code = command.main(args=given, prog_name="ocp", standalone_mode=False)
            interrupt.check()
    except KeyboardInterrupt:
        print("stopped by the user; what was finished is kept", file=sys.stderr)
        return interrupt.EXIT_CODE
    except Exception as error:
        if "--debug" in given:
            traceback.print_exc()
        message, code = _explain(error)
        if message:
            print(f"error: {message}", file=sys.stderr)
        return code
    return code if isinstance(code, int) else 0


def _explain(error: Exception) -> tuple[str, int]:
    """Return the sentence and the exit code of anything that was raised."""
    # By what they have, not by type: typer brings click along under a name of its own, and to
    # import ocp.errors would load CasADi for every ocp --help.
    if hasattr(error, "format_message"):
        message = error.format_message()  # pyright: ignore[reportAttributeAccessIssue]
        if not message or type(error).__name__ == "NoArgsIsHelpError":
            return "", 2
        return f"{message.rstrip('.')}; ocp --help shows what there is", 2
    if isinstance(code := getattr(error, "exit_code", None), int):
        return str(error), code
    if isinstance(error, BrokenPipeError):
        return "", 1
    return (
        f"internal fault, {type(error).__name__}: {error}\n"
        "this is a defect of the workbench; --debug shows where it lies",
        1,
    )
