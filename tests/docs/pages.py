"""Execution of README and pages of docs: their blocks run in order in one folder, as a reader would run them.

A ``console`` block has commands, each after ``$ ``, and their stdout; a ``python`` block runs in
the page's namespace, and the next ``text`` block is its output; a block with ``title="FILE"`` is
written to that file. ``<!-- fails -->`` before a block says that its commands exit with another
code than 0, and compares stderr too. ``<!-- slow -->`` leaves a block to the slow tests,
``<!-- not run: REASON -->`` to readers alone. Other blocks are texts.
"""

from __future__ import annotations

import io
import os
import re
import shlex
import subprocess
import sys
from contextlib import chdir, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

from reports.cli.app import main

ROOT = Path(__file__).parents[2]
TOLERANCE = 1e-3
"""Relative difference allowed between numbers on a page and in the output."""
ROUNDING = 1e-12
"""Absolute value below which a number counts as zero."""
_BLOCK = re.compile(
    r"(?:<!-- (?P<mark>slow|fails|not run: [^\n]+?) -->\n+)?"
    r"^(?P<indent> *)```(?P<language>\w+)(?P<about>[^\n]*)\n(?P<body>.*?)^(?P=indent)```$",
    re.DOTALL | re.MULTILINE,
)
_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w.]*\d)")


@dataclass(frozen=True)
class Block:
    """One block of a page: language, text, file to write, mark, and line in the page."""

    language: str
    text: str
    file: str
    mark: str
    line: int

    @property
    def slow(self) -> bool:
        return self.mark == "slow"

    @property
    def runs(self) -> bool:
        return not self.mark.startswith("not run") and (bool(self.file) or self.language in ("console", "python"))


@dataclass(frozen=True)
class Command:
    """One command of a console block and its expected output, "" if the page has none."""

    line: str
    output: str

    @property
    def plain(self) -> bool:
        """Whether the command is ``ocp`` alone, without characters that are special in a shell."""
        return self.line.startswith("ocp ") and not set(self.line) & set("|<>$&;*?`~\\\n")


def pages() -> list[Path]:
    """Return the paths of README and of every page that is written by hand."""
    docs = ROOT / "docs"
    written = (p for p in docs.rglob("*.md") if not p.is_relative_to(docs / "generated"))
    return [ROOT / "README.md", *sorted(written)]


def blocks(text: str) -> list[Block]:
    """Return the blocks of a page in order."""
    found = []
    for match in _BLOCK.finditer(text):
        indent = len(match["indent"])
        body = "\n".join(line[indent:] for line in match["body"].splitlines())
        file = re.findall(r'title="([^"]+)"', match["about"])
        line = text[: match.start("language")].count("\n") + 1
        found.append(Block(match["language"], body, "".join(file), match["mark"] or "", line))
    return found


def commands(text: str) -> list[Command]:
    """Return the commands of a console block; a line that ends in a backslash continues in the next."""
    found: list[tuple[str, list[str]]] = []
    for line in text.splitlines():
        if line.startswith("$ "):
            found.append((line[2:], []))
        elif found and found[-1][0].endswith("\\") and not found[-1][1]:
            found[-1] = (f"{found[-1][0]}\n{line.removeprefix('> ')}", [])
        elif found:
            found[-1][1].append(line)
        else:
            raise ValueError(f"a console block begins with a command, got {line!r}")
    return [Command(line, "\n".join(output).strip("\n")) for line, output in found]


def agrees(printed: str, shown: str) -> bool:
    """Return whether the output ``printed`` agrees with the text ``shown`` on a page.

    A line ``...`` of the page matches any lines, ``...`` within a line any characters; numbers agree
    within :data:`TOLERANCE`, counts of iterations within 3.5, since the last bit of a sum may change
    them.
    """
    lines = [line.rstrip() for line in printed.strip("\n").splitlines()]
    wanted = [line.rstrip() for line in shown.splitlines()]
    return _match(lines, wanted)


def _match(lines: list[str], wanted: list[str], column: int = -1) -> bool:
    """Return whether lines match; ``column`` is where a table's numbers of iterations end."""
    if not wanted:
        return not lines
    if wanted[0] == "...":
        return any(_match(lines[k:], wanted[1:], column) for k in range(len(lines) + 1))
    head = re.search(r"(?<= )iter\b", wanted[0])
    column = head.end() if head else column
    same = bool(lines) and _same(lines[0], wanted[0], column)
    return same and _match(lines[1:], wanted[1:], column)


def _same(line: str, wanted: str, column: int) -> bool:
    parts, numbers, at = [], [], 0
    for part in wanted.split("..."):
        words = re.split(f"({_NUMBER.pattern})", part)
        parts.append("".join(_captured(word, k) for k, word in enumerate(words)))
        for number in _NUMBER.finditer(part):
            before = wanted[: at + number.start()]
            counts = before.endswith('"iterations": ') or at + number.end() == column
            numbers.append((number[0], counts))
        at += len(part) + 3
    found = re.fullmatch(".*?".join(parts), line)
    if found is None:
        return False
    return all(_near(a, *b) for a, b in zip(found.groups(), numbers, strict=True))


def _captured(word: str, index: int) -> str:
    spaced = r"\s+".join(re.escape(piece) for piece in re.split(r"\s{2,}", word))
    return f"({_NUMBER.pattern})" if index % 2 else spaced


def _near(printed: str, shown: str, counts: bool) -> bool:
    a, b = float(printed), float(shown)
    if counts:
        return abs(a - b) <= 3 + 0.5 * b
    return abs(a - b) <= TOLERANCE * abs(b) or max(abs(a), abs(b)) < ROUNDING


class Walk:
    """Execution of a page from top to bottom in an empty folder."""

    def __init__(self, page: Path, folder: Path) -> None:
        self.page, self.folder, self.scope = page, folder, {"__name__": "__main__"}
        self.printed: str | None = None

    def through(self, slow: bool) -> None:
        """Run all blocks of the page; those marked slow only if ``slow``."""
        for block in blocks(self.page.read_text(encoding="utf-8")):
            if block.runs and (slow or not block.slow):
                self.do(block)
            elif block.language == "text" and self.printed is not None:
                assert agrees(self.printed, block.text), f"{self.place(block)}: {self.printed}"
                self.printed = None

    def place(self, block: Block) -> str:
        """Return the file and line of a block, for messages."""
        return f"{os.path.relpath(self.page, ROOT)}:{block.line}"

    def do(self, block: Block) -> None:
        """Write the block's file, or run it; raises AssertionError with the place in the page."""
        place, self.printed = self.place(block), None
        if block.file:
            (self.folder / block.file).write_text(block.text + "\n", encoding="utf-8")
        elif block.language == "python":
            with redirect_stdout(io.StringIO()) as out:
                exec(compile(block.text, place, "exec"), self.scope)
            self.printed = out.getvalue()
        else:
            for command in commands(block.text):
                self.run(command, place, fails=block.mark == "fails")

    def run(self, command: Command, place: str, *, fails: bool) -> None:
        """Run one command as a shell does, and check that its output is that on the page."""
        code, out, err = self.program(command) if command.plain else self.shell(command)
        told = f"{place}: $ {command.line}\n{out}\n{err[-2000:]}"
        assert (code != 0) == fails, told
        assert not command.output or agrees(out + err * fails, command.output), told

    def program(self, command: Command) -> tuple[int, str, str]:
        """Return exit code, stdout and stderr of ``ocp``, run in this process, since a start takes a second."""
        with (
            chdir(self.folder),
            redirect_stdout(io.StringIO()) as out,
            redirect_stderr(io.StringIO()) as err,
        ):
            code = main(shlex.split(command.line)[1:])
        return code, out.getvalue(), err.getvalue()

    def shell(self, command: Command) -> tuple[int, str, str]:
        """Return exit code, stdout and stderr of any other command."""
        done = subprocess.run(
            ["bash", "-o", "pipefail", "-c", command.line],
            cwd=self.folder,
            env=environment(),
            capture_output=True,
            text=True,
        )
        return done.returncode, done.stdout, done.stderr


def environment() -> dict[str, str]:
    """Return the environment variables, with this interpreter's programs and this checkout first."""
    programs = str(Path(sys.executable).parent)
    return {
        **os.environ,
        "PATH": os.pathsep.join([programs, os.environ.get("PATH", "")]),
        "PYTHONPATH": os.pathsep.join(part for part in (str(ROOT), os.environ.get("PYTHONPATH", "")) if part),
        "COLUMNS": "80",
    }
