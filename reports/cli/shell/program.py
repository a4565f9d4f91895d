"""The program as a whole: its commands of one word and of two, its help, and its version."""

from __future__ import annotations

from typing import Any

import typer
from typer.core import TyperGroup

NAME = "centralpath"
EXAMPLES = ("list", "show push-disc", "solve push-disc --contact exact", "runs", "solve --help")


class Program(TyperGroup):
    """Commands may have two words, ``runs rm``; the help tells each in whole sentences."""

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[Any, Any, list[str]]:
        """Find the command that the first word names, or the first two."""
        two = " ".join(args[:2])
        if len(args) > 1 and two in self.commands:
            args = [two, *args[2:]]
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write every command with the first paragraph of its help, which no line cuts."""
        rows = [(name, _first_paragraph(command.help)) for name, command in self.commands.items()]
        with formatter.section("Commands"):
            formatter.write_dl(rows)

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        """Write what to try first."""
        formatter.write("\nExamples:\n")
        formatter.write("".join(f"  ocp {line}\n" for line in EXAMPLES))


def _first_paragraph(text: str | None) -> str:
    return " ".join((text or "").split("\n\n")[0].split())


def version() -> str:
    """Name and version of what is installed."""
    from importlib.metadata import version

    return f"{NAME} {version(NAME)}"


def tell_version(asked: bool) -> None:
    """Print the version and end, where it is asked for."""
    if asked:
        print(version())
        raise typer.Exit
