"""What all commands share: the global options, and where output goes."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from rich.console import Console

Json = Annotated[bool, typer.Option("--json", help="Print one JSON document on stdout.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress and no tables.")]
Debug = Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")]
Out = Annotated[Path, typer.Option("--out", help="Directory of the run store.")]
Contact = Annotated[str, typer.Option("--contact", help="Contact law; ocp list shows them.")]
LawSettings = Annotated[
    list[str] | None,
    typer.Option("--contact-setting", "-c", metavar="K=V", help="Setting of the contact law."),
]
Params = Annotated[
    list[str] | None,
    typer.Option("--param", "-p", metavar="K=V", help="Parameter of the problem."),
]
Settings = Annotated[
    list[str] | None,
    typer.Option("--setting", "-s", metavar="K=V", help="Setting of the method or the solver."),
]
Method = Annotated[str, typer.Option("--method", help="direct, multiple-shooting, ...")]
PolicyName = Annotated[str, typer.Option("--policy", help="open-loop or feedback.")]
SolverName = Annotated[str, typer.Option("--solver", help="ipopt, fatrop, uno or sleqp.")]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Seed of everything random.")]


GRADES = {"survives": "green", "certified": "yellow", "failed": "red"}
"""Colour of a verdict: certified and surviving, certified alone, neither."""


class Output:
    """Results go to stdout, the rest to stderr; with ``--json`` stdout has JSON alone."""

    def __init__(self, as_json: bool, quiet: bool) -> None:
        self.as_json, self.quiet = as_json, quiet

    @property
    def console(self) -> Console:
        """Console on stderr, 80 columns where that is no terminal."""
        from rich.console import Console

        terminal = sys.stderr.isatty()
        return Console(stderr=True, width=None if terminal else 80, highlight=False)

    def note(self, what: Any) -> None:
        """Show progress or a table, unless quiet."""
        if not self.quiet:
            self.console.print(what)

    def say(self, line: str) -> None:
        """Print a result line for people."""
        print(line, file=sys.stderr if self.as_json else sys.stdout)

    def verdict(self, text: str, grade: str) -> None:
        """Print a verdict, on a terminal its first line in its grade's colour."""
        stream = sys.stderr if self.as_json else sys.stdout
        if not stream.isatty():
            self.say(text)
            return
        from rich.console import Console
        from rich.text import Text

        first, *others = text.split("\n")
        lines = [Text(first, style=f"bold {GRADES[grade]}"), *map(Text, others)]
        Console(file=stream, highlight=False).print(*lines, sep="\n")

    def document(self, content: dict[str, Any]) -> None:
        """Print the one JSON document, where it was asked for."""
        if not self.as_json:
            return
        from ocp.store.plain import plain

        print(json.dumps(plain(content), indent=1, allow_nan=False))
