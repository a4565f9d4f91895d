"""Where a command's words go: results to stdout, the rest to stderr, one document as JSON."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console

GRADES = {"survives": "green", "certified": "yellow", "failed": "red"}
"""Colour of a verdict: certified and surviving, certified alone, neither."""


class Output:
    """Results go to stdout, the rest to stderr; with ``--json`` stdout has JSON alone.

    Where progress is ``logged`` nothing else shows it.
    """

    def __init__(self, as_json: bool, quiet: bool, logged: bool = False) -> None:
        self.as_json, self.quiet, self.logged = as_json, quiet, logged

    @property
    def progress(self) -> bool:
        """Whether progress is shown: not where it is logged, nor quietly."""
        return not (self.quiet or self.logged)

    @property
    def table_of_stages(self) -> bool:
        """Whether the end tells all stages: not where a line told each as it came."""
        return self.console.is_terminal and self.progress

    @property
    def console(self) -> Console:
        """Console on stderr, 80 columns where that is no terminal."""
        from rich.console import Console

        terminal = sys.stderr.isatty()
        width = None if terminal else 80
        # What a run says of itself is text, whatever brackets there are in it.
        return Console(stderr=True, width=width, highlight=False, markup=False)

    def note(self, what: Any) -> None:
        """Show progress or a table, unless quiet."""
        if not self.quiet:
            self.console.print(what)

    def say(self, line: str) -> None:
        """Print a result line for people."""
        print(line, file=sys.stderr if self.as_json else sys.stdout)

    def foretell(self, what: str, seconds: float, memory: float = 0.0) -> None:
        """Tell on stderr, in one line, what will take long, unless quiet."""
        from ocp.effort import foretold

        line = foretold(what, seconds, memory)
        if line is not None and not self.quiet:
            print(line, file=sys.stderr, flush=True)

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
        from reports.cli.streams import document_stream

        text = json.dumps(plain(content), indent=1, allow_nan=False)
        print(text, file=document_stream(), flush=True)

    def finish(self, run: Path, content: dict[str, Any], pdf: Path | None, own: Any = None) -> None:
        """Say where a run was stored, write its report to ``pdf``, and print its document.

        ``own`` is the problem that was asked for, by which the report shows it.
        """
        self.say(f"run: {run}")
        if pdf is not None:
            from ocp import store
            from reports.pdf import write_pdf

            write_pdf([store.load(run)], pdf, own=own)
            self.say(f"PDF: {pdf}")
        self.document({**content, "run": str(run), "pdf": None if pdf is None else str(pdf)})
