"""A server that loads the program once and forks it for every run, to save two seconds of imports.

Each child runs the whole program, from its entry point to the interpreter's end, with its own
streams, directory and limits; other attacks test the start before ``main``.
``python -m tests.attack.forked`` is the server, :class:`Server` its client.
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
    """Client of a server that forks the loaded program for every run."""

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
        """Run the program once and return how it ended; ``step`` are arguments of :func:`.steps.watch`.

        ``limits`` maps names of ``resource`` to values; ``variables`` are set in the environment.
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
    """Answer requests, one per line, until the input ends; each forks a child that runs the program."""
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
    """Return the exit code of a child as in subprocess, or None if it had to be killed."""
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
    """Run the program in this process, and exit with the code that its entry point returns."""
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
