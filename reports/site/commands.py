"""A page a command: the help that the program itself prints."""

from __future__ import annotations

from typing import Any

import typer

from reports.cli.app import app

WIDTH = 80


def pages() -> dict[str, str]:
    """Help of every command, and a list of them."""
    group = typer.main.get_command(app)
    commands = group.commands  # pyright: ignore[reportAttributeAccessIssue]
    rows = "".join(f"| [`ocp {name}`]({name}.md) | {first(c)} |\n" for name, c in commands.items())
    written = {
        f"commands/{name}.md": f"# ocp {name}\n\n```text\n{shown(name, command)}\n```\n"
        for name, command in commands.items()
    }
    index = f"# Commands\n\n| command | what it does |\n| --- | --- |\n{rows}"
    return {"commands/index.md": index, **written}


def first(command: Any) -> str:
    """What a command does, in its first paragraph."""
    return " ".join((command.help or "").partition("\n\n")[0].split())


def shown(name: str, command: Any) -> str:
    """The text of ``ocp NAME --help`` in a terminal of 80 columns."""
    context = command.make_context(
        f"ocp {name}", [], resilient_parsing=True, terminal_width=WIDTH, max_content_width=WIDTH
    )
    return command.get_help(context).rstrip()
