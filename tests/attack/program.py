"""Runs of the program in its own process, and checks of how they ended."""

from __future__ import annotations

import os
import re
import shlex
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import IO

ROOT = Path(__file__).parents[2]
PATIENCE_S = 300.0
"""Time [s] after which a run counts as hung, longer than any run takes on a busy computer."""
CODES = (0, 1, 2, 3, 4, 130)


@cache
def entry_point() -> tuple[str, str]:
    """Return the module and the function of the ``ocp`` script, as declared by the package."""
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]["ocp"]
    module, _, function = declared.partition(":")
    return module, function


@cache
def command() -> list[str]:
    """Return the words that start the program: the interpreter, and a script like an installer's."""
    module, function = entry_point()
    script = ROOT / "build" / "attack" / "ocp"
    script.parent.mkdir(parents=True, exist_ok=True)
    script.write_text(
        f"import sys\nfrom {module} import {function}\nif __name__ == '__main__':\n    sys.exit({function}())\n"
    )
    return [sys.executable, str(script)]


def environment(**more: str) -> dict[str, str]:
    """Return environment variables under which this checkout's program runs, whatever else is installed."""
    return {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONSAFEPATH": "1", **more}


@dataclass(frozen=True)
class Ended:
    """End of one run of the program; ``code`` is None if it hung."""

    arguments: Sequence[str]
    code: int | None
    out: str
    err: str
    seconds: float

    @property
    def line(self) -> str:
        """Command line for a shell."""
        return "ocp " + shlex.join(self.arguments)

    @property
    def last(self) -> str:
        """Last two lines of standard error."""
        return " | ".join(self.err.strip().splitlines()[-2:])[-300:]


def start(
    arguments: Sequence[str],
    directory: Path,
    *,
    env: dict[str, str] | None = None,
    stdout: IO[bytes] | int = subprocess.PIPE,
    stderr: IO[bytes] | int = subprocess.PIPE,
) -> subprocess.Popen[bytes]:
    """Start the program in its own process group, with output to pipes."""
    return subprocess.Popen(
        [*command(), *arguments],
        cwd=directory,
        env=environment() if env is None else env,
        stdin=subprocess.DEVNULL,
        stdout=stdout,
        stderr=stderr,
        start_new_session=True,
    )


def ended(process: subprocess.Popen[bytes], arguments: Sequence[str], patience: float = PATIENCE_S) -> Ended:
    """Wait for the end of the program, and kill its process group if it hangs; return how it ended."""
    began = time.monotonic()
    try:
        out, err = process.communicate(timeout=patience)
        code = process.returncode
    except subprocess.TimeoutExpired:
        kill_group(process.pid)
        out, err = process.communicate()
        code = None
    said, told = ((text or b"").decode(errors="replace") for text in (out, err))
    return Ended(arguments, code, said, told, time.monotonic() - began)


def run(arguments: Sequence[str], directory: Path) -> Ended:
    """Run the program and return how it ended."""
    return ended(start(arguments, directory), arguments)


def kill_group(group: int) -> None:
    """Kill the program and all processes of its group."""
    with suppress(ProcessLookupError):
        os.killpg(group, signal.SIGKILL)


def orphans(group: int, patience: float = 10.0) -> list[str]:
    """Return the processes of a group that are left some seconds after its first one has ended."""
    until = time.monotonic() + patience
    while (left := _members(group)) and time.monotonic() < until:
        time.sleep(0.05)
    return left


def _members(group: int) -> list[str]:
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            state, _, member = stat.read_text().rpartition(")")[2].split()[:3]
            if int(member) == group and state != "Z":
                found.append((stat.parent / "cmdline").read_text().replace("\0", " ")[:200])
    return found


def of_python_alone(end: Ended) -> bool:
    """Return whether a run ended with a traceback of Python's own start, without a file of this checkout."""
    ours = end.err.replace(str(ROOT / "build"), "")
    return "Traceback" in end.err and str(ROOT) not in ours


def faults(end: Ended, *, expected: tuple[int, ...] = CODES) -> list[tuple[str, str]]:
    """Return the faults in how a run ended, pairs of kind and text; empty if there are none.

    An exit code that is not ``expected`` means that nonsense was accepted if it is 0, else a wrong end.
    """
    said, where = end.out + end.err, f"{end.line} -> exit {end.code}: {end.last}"
    if end.code is None:
        return [("hung", where)]
    found = []
    if "Traceback (most recent call last)" in said or "Exception ignored" in said:
        found.append(("traceback", where))
    if "internal error" in said:
        found.append(("internal error", where))
    if end.code not in expected and not found:
        kind = "nonsense accepted" if end.code == 0 else "strange end"
        found.append((kind, where))
    if end.code in (1, 2) and not end.err.strip():
        found.append(("silent failure", where))
    if end.code == 2 and len(re.findall(r"^error: ", end.err, re.MULTILINE)) != 1:
        found.append(("no sentence", where))
    return found
