"""The program, loaded once and forked for every start: two seconds of imports are paid for once.

What is forked is the whole program, from its entry point to the interpreter's end, with streams, a
directory and limits of its own; what a start costs before ``main`` is attacked elsewhere.
``python -m tests.attack.forked`` is the server, :class:`Server` who talks to it.
"""

from __future__ import annotations

import importlib
import json
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from tests.attack import steps
from tests.attack.program import (
    PATIENCE_S,
    ROOT,
    Ended,
    entry_point,
    environment,
    kill_group,
)

LOADED = (
    "reports.cli.app",
    "casadi",
    "xarray",
    "netCDF4",
    "scipy.optimize",
    "scipy.sparse",
    "matplotlib.backends.backend_agg",
    "ocp",
    "ocp.gradients",
    "ocp.continuation",
    "problems",
    "ocp.store",
    "ocp.jobs",
    "reports.documents.pdf",
    "reports.figures",
    "PIL.Image",
    "typst",
)


class Server:
    """A program that stands ready to be forked."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.attack.forked"],
            cwd=ROOT,
            env=environment(PYTHONSAFEPATH=""),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def run(
        self,
        arguments: Sequence[str],
        directory: Path,
        *,
        patience: float = PATIENCE_S,
        limits: dict[str, int] | None = None,
        step: dict[str, Any] | None = None,
        **variables: str,
    ) -> Ended:
        """Run the program once; ``step`` says what happens at which step (:mod:`.steps`).

        ``limits`` are names of ``resource`` with their values, ``variables`` of the environment.
        """
        request = {
            "arguments": list(arguments),
            "directory": str(directory),
            "patience": patience,
            "limits": limits or {},
            "step": step,
            "variables": variables,
        }
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.write(json.dumps(request) + "\n")
        self._process.stdin.flush()
        answer = json.loads(self._process.stdout.readline())
        return Ended(arguments, **answer)

    def close(self) -> None:
        """End the server."""
        self._process.terminate()
        self._process.wait()


def serve() -> None:
    """Answer requests, a line each, until there are no more; each child is the program."""
    for name in LOADED:
        with suppress(ImportError):
            importlib.import_module(name)
    answers = os.dup(1)
    os.dup2(2, 1)
    while line := sys.stdin.readline():
        request = json.loads(line)
        words = {name: os.memfd_create(name) for name in ("out", "err")}
        began = time.monotonic()
        child = os.fork()
        if child == 0:
            _become(request, **words)
        code = _waited(child, request["patience"])
        answer = {"code": code, "seconds": time.monotonic() - began}
        for name, stream in words.items():
            size = os.fstat(stream).st_size
            answer[name] = os.pread(stream, size, 0).decode(errors="replace")
            os.close(stream)
        os.write(answers, (json.dumps(answer) + "\n").encode())


def _waited(child: int, patience: float) -> int | None:
    """Return the exit code of a child, as subprocess tells it; None where it had to be killed."""
    until = time.monotonic() + patience
    while time.monotonic() < until:
        found, status = os.waitpid(child, os.WNOHANG)
        if found:
            code = os.waitstatus_to_exitcode(status)
            if code == -signal.SIGKILL:
                kill_group(child)
            return code
        time.sleep(0.002)
    kill_group(child)
    os.waitpid(child, 0)
    return None


def _become(request: dict[str, Any], out: int, err: int) -> None:
    """Be the program: the interpreter ends with what its entry point returns."""
    os.setsid()
    nothing = os.open(os.devnull, os.O_RDONLY)
    for place, stream in enumerate((nothing, out, err)):
        os.dup2(stream, place)
    os.closerange(3, 256)
    sys.stdin = os.fdopen(0)
    os.environ.pop("PYTHONSAFEPATH", None)
    os.environ.update(request["variables"])
    os.chdir(request["directory"])
    for name, value in request["limits"].items():
        resource.setrlimit(getattr(resource, name), (value, value))
    module, function = entry_point()
    program = getattr(importlib.import_module(module), function)
    sys.argv = ["ocp", *request["arguments"]]
    if request["step"]:
        steps.watch(**request["step"])
    sys.exit(program())


if __name__ == "__main__":
    serve()
