"""Standard output and error: results, JSON documents, encodings, warnings and logs."""

from __future__ import annotations

import codecs
import ctypes
import json
import os
import sys
import unicodedata
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from io import BufferedWriter, FileIO, TextIOWrapper, UnsupportedOperation
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from reports.drawing.notation import GREEK

if TYPE_CHECKING:
    from rich.console import Console

    from ocp.store.stored_run import StoredRun

_OUT = 1
"""Descriptor of standard output."""
_ERR = 2
"""Descriptor of standard error."""


@dataclass(frozen=True)
class _Saved:
    """The original stdout, a copy of descriptor 1, and the stream for the JSON document."""

    stdout: TextIO
    copy: int
    document: TextIO


_saved: list[_Saved] = []


def redirect_stdout() -> None:
    """Redirect stdout to stderr, until :func:`restore_stdout`; only the JSON document goes to stdout.

    Solvers, compilers and a user's file may print. Compiled code prints directly to descriptor 1, partly only when
    the process ends. Therefore the descriptor itself is redirected to stderr, and the document is written to a copy
    of the original.
    """
    stdout = sys.stdout
    if _saved or stdout is None:
        return
    stdout.flush()
    copy = os.dup(_OUT)
    document = stdout
    if _descriptor(stdout) == _OUT:
        raw = BufferedWriter(FileIO(copy, "w", closefd=False))
        document = TextIOWrapper(raw, stdout.encoding, stdout.errors)
    _saved.append(_Saved(stdout, copy, document))
    sys.stdout = sys.stderr
    try:
        os.dup2(_ERR, _OUT)
    except OSError:
        with Path(os.devnull).open("w") as nowhere:
            os.dup2(nowhere.fileno(), _OUT)


def document_stream() -> TextIO:
    """Return the stream for the JSON document, which is the original stdout."""
    return _saved[0].document if _saved else sys.stdout


def restore_stdout() -> None:
    """Restore stdout, after flushing the buffers of compiled code."""
    if not _saved:
        return
    saved = _saved.pop()
    sys.stdout = saved.stdout
    if _descriptor(saved.stdout) == _OUT:
        saved.stdout.flush()
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).fflush(None)
    os.dup2(saved.copy, _OUT)
    os.close(saved.copy)


def _descriptor(stream: TextIO) -> int | None:
    """Return the descriptor of a stream; None for a stream that exists only in Python, as in tests."""
    try:
        return stream.fileno()
    except (UnsupportedOperation, ValueError, AttributeError):
        return None


SIGNS = {
    "⟂": "_|_",
    "·": "*",
    "–": "-",
    "—": "-",
    "…": "...",
    "≤": "<=",
    "≥": ">=",
    "≠": "!=",
    "≈": "~",
    "±": "+-",
    "×": "x",
    "→": "->",
    "←": "<-",
    "−": "-",
    "∞": "inf",
    "√": "sqrt",
    "Δ": "Delta",
    "∂": "d",
    "Σ": "Sigma",
    **{sign: name for name, sign in GREEK.items()},
    "λ": "lam",
    "µ": "u",
    "π": "pi",
    "‖": "||",
}
"""Mapping from signs that an encoding may lack to ASCII replacements."""
ERROR_HANDLER = "centralpath-signs"
"""Name under which the error handler of encodings is registered."""


def to_ascii(text: str) -> str:
    """Return ``text`` in ASCII: signs as in :data:`SIGNS`, letters without accents, other characters as ``?``."""
    bare = (unicodedata.normalize("NFKD", sign).encode("ascii", "ignore") for sign in text)
    return "".join(SIGNS.get(sign) or letters.decode() or "?" for sign, letters in zip(text, bare, strict=True))


def _replaced(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return to_ascii(error.object[error.start : error.end]), error.end


def set_error_handler() -> None:
    """Make stdout and stderr replace signs that their encoding lacks; UTF-8 streams do not change.

    Under ``PYTHONIOENCODING=cp1252`` or an ASCII locale, ``⟂`` would otherwise end the program.
    """
    codecs.register_error(ERROR_HANDLER, _replaced)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper) and codecs.lookup(stream.encoding).name != "utf-8":
            stream.reconfigure(errors=ERROR_HANDLER)


def discard_buffers() -> None:
    """Discard the buffers of streams that cannot be written.

    Otherwise Python would flush them again at its end, and print a traceback.
    """
    for stream in (sys.stdout, document_stream()):
        try:
            stream.flush()
        except OSError:
            with Path(os.devnull).open("w") as nowhere:
                os.dup2(nowhere.fileno(), stream.fileno())


PACKAGES = ("dynamics", "ocp", "problems", "reports")
"""Packages whose warnings and logs are printed; copied from ocp.distribution, which ``--help`` does not import."""


@contextmanager
def libraries_silenced(quiet: bool) -> Iterator[None]:
    """Print each warning of our own packages on one line, or none if ``quiet``.

    Warnings and logs of libraries are hidden, since a user cannot act on them (such as those of
    matplotlib on a read-only home); ``python -W error`` still raises them.
    """
    import logging
    import warnings

    nowhere = logging.NullHandler()
    # Without a handler of the root logger, Python prints the warnings that libraries log.
    logging.getLogger().addHandler(nowhere)
    printed = set[str]()

    def show(message: Warning | str, category: type[Warning], *_: object) -> None:
        if category.__module__.partition(".")[0] in PACKAGES and str(message) not in printed:
            printed.add(str(message))
            if not quiet:
                print(f"warning: {message}", file=sys.stderr)

    with warnings.catch_warnings():
        warnings.showwarning = show
        try:
            yield
        finally:
            logging.getLogger().removeHandler(nowhere)


@contextmanager
def log_to_stderr(verbosity: int) -> Iterator[None]:
    """Print log records of this context on stderr: none at ``verbosity`` 0, INFO at 1, DEBUG from 2 on.

    A line shows milliseconds since the start of the program, module and message.
    """
    if verbosity <= 0:
        yield
        return
    import logging

    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter(_LOG_FORMAT, style="{"))
    loggers = [logging.getLogger(name) for name in PACKAGES]
    previous_levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.addHandler(handler)
        logger.setLevel(logging.INFO if verbosity == 1 else logging.DEBUG)
    try:
        yield
    finally:
        for logger, level in zip(loggers, previous_levels, strict=True):
            logger.removeHandler(handler)
            logger.setLevel(level)


_LOG_FORMAT = "{relativeCreated:9.0f} ms  {name}: {message}"
"""Format of a line of the log."""


_VERDICT_STYLES = {"survives": "green", "certified": "yellow", "failed": "red"}
"""Mapping from the grade of a verdict to its colour on a terminal."""


class Output:
    """Output of a command: results on stdout (with ``--json`` only the JSON document), all other text on stderr.

    If progress is ``logged``, it is not also shown in a bar or table.
    """

    def __init__(self, as_json: bool, quiet: bool, logged: bool = False) -> None:
        self.as_json, self.quiet, self.logged = as_json, quiet, logged

    @property
    def progress(self) -> bool:
        """Whether progress is shown: not with ``--quiet``, and not if it is logged."""
        return not (self.quiet or self.logged)

    @property
    def console(self) -> Console:
        """Console on stderr, 80 columns wide unless it is a terminal."""
        from rich.console import Console

        terminal = sys.stderr.isatty()
        width = None if terminal else 80
        # Brackets in a run's text are text, not markup.
        return Console(stderr=True, width=width, highlight=False, markup=False)

    def note(self, renderable: Any) -> None:
        """Print progress or a table on stderr, unless quiet."""
        if not self.quiet:
            self.console.print(renderable)

    def say(self, line: str) -> None:
        """Print a line of results on stdout or, with ``--json``, on stderr."""
        print(line, file=sys.stderr if self.as_json else sys.stdout)

    def announce(self, task: str, seconds: float, memory: float = 0.0) -> None:
        """Print the predicted time of a long computation on stderr, unless quiet."""
        from ocp.problem.resources import long_task_notice

        line = long_task_notice(task, seconds, memory)
        if line is not None and not self.quiet:
            print(line, file=sys.stderr, flush=True)

    def verdict(self, text: str, grade: str) -> None:
        """Print a verdict; on a terminal its first line is in the colour of its grade."""
        stream = sys.stderr if self.as_json else sys.stdout
        if not stream.isatty():
            self.say(text)
            return
        from rich.console import Console
        from rich.text import Text

        first, *further_lines = text.split("\n")
        lines = [Text(first, style=f"bold {_VERDICT_STYLES[grade]}"), *map(Text, further_lines)]
        Console(file=stream, highlight=False).print(*lines, sep="\n")

    def document(self, content: dict[str, Any]) -> None:
        """Print the JSON document on stdout, if ``--json`` is given."""
        if not self.as_json:
            return
        from ocp.store.json_values import to_json

        text = json.dumps(to_json(content), indent=1, allow_nan=False)
        print(text, file=document_stream(), flush=True)

    def finish(self, run: StoredRun, content: dict[str, Any], pdf: Path | None, file_spec: Any = None) -> None:
        """Print the path of a run, write its report to ``pdf`` if not None, and print the JSON document.

        ``file_spec`` is the spec of the solved problem, with which the report draws the solution.
        """
        self.say(f"run: {run.path}")
        if pdf is not None:
            from reports.documents.pdf import write_pdf

            write_pdf([run], pdf, file_spec=file_spec)
            self.say(f"PDF: {pdf}")
        self.document({**content, "run": str(run.path), "pdf": None if pdf is None else str(pdf)})
