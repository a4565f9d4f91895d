"""Output of a command: results on stdout, the rest on stderr, or one JSON document."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console

    from ocp.store.stored_run import StoredRun

GRADES = {"survives": "green", "certified": "yellow", "failed": "red"}
"""Colour of a verdict: certified and surviving, only certified, neither."""


class Output:
    """Results go to stdout, the rest to stderr; with ``--json`` stdout has only JSON.

    Where progress is ``logged``, no bar and no table shows it too.
    """

    def __init__(self, as_json: bool, quiet: bool, logged: bool = False) -> None:
        self.as_json, self.quiet, self.logged = as_json, quiet, logged

    @property
    def progress(self) -> bool:
        """Whether progress is shown: neither with ``--quiet`` nor where it is logged."""
        return not (self.quiet or self.logged)

    @property
    def table_of_stages(self) -> bool:
        """Whether a table at the end lists all stages: only where no lines listed them before."""
        return self.console.is_terminal and self.progress

    @property
    def console(self) -> Console:
        """Console on stderr, 80 columns wide unless it is a terminal."""
        from rich.console import Console

        terminal = sys.stderr.isatty()
        width = None if terminal else 80
        # Brackets in a run's text are text, not markup.
        return Console(stderr=True, width=width, highlight=False, markup=False)

    def note(self, what: Any) -> None:
        """Show progress or a table, unless quiet."""
        if not self.quiet:
            self.console.print(what)

    def say(self, line: str) -> None:
        """Print a result line for people."""
        print(line, file=sys.stderr if self.as_json else sys.stdout)

    def announce(self, what: str, seconds: float, memory: float = 0.0) -> None:
        """Print on stderr one line about a long computation, unless quiet."""
        from ocp.effort import long_task_notice

        line = long_task_notice(what, seconds, memory)
        if line is not None and not self.quiet:
            print(line, file=sys.stderr, flush=True)

    def verdict(self, text: str, grade: str) -> None:
        """Print a verdict; on a terminal its first line has the colour of its grade."""
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
        """Print the JSON document, with ``--json``."""
        if not self.as_json:
            return
        from ocp.store.json_values import to_json
        from reports.cli.streams import document_stream

        text = json.dumps(to_json(content), indent=1, allow_nan=False)
        print(text, file=document_stream(), flush=True)

    def finish(
        self, run: StoredRun, content: dict[str, Any], pdf: Path | None, own: Any = None
    ) -> None:
        """Print where a run was stored, write its report to ``pdf``, and print its document.

        ``own`` is the problem that was solved, whose drawing the report shows.
        """
        self.say(f"run: {run.path}")
        if pdf is not None:
            from reports.pdf import write_pdf

            write_pdf([run], pdf, own=own)
            self.say(f"PDF: {pdf}")
        self.document({**content, "run": str(run.path), "pdf": None if pdf is None else str(pdf)})
