"""Functions of jobs for tests; worker processes import this module by its name."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ocp.errors import InputError


def squared(job: dict[str, Any], tell: Callable[[Any], None]) -> dict[str, Any]:
    """Return the square of x and report progress; ``job`` may ask to wait, to fail, or to die by a signal."""
    for k in range(job.get("steps", 2)):
        tell({"k": k, "x": job["x"]})
        time.sleep(job.get("wait", 0.0))
        if "mark" in job:
            _add("+", job["mark"])
    if "dies" in job and _add("+", job["dies"]) <= job.get("deaths", 1):
        os.kill(os.getpid(), signal.SIGKILL)
    if job.get("fails"):
        raise InputError(f"x = {job['x']} is refused")
    return {"x": job["x"], "square": np.array([job["x"] ** 2.0]), "process": os.getpid()}


def threads(_: int, tell: Callable[[Any], None]) -> tuple[str | None, str | None]:
    """Return the environment variables that set the number of threads of OpenMP and OpenBLAS."""
    return os.environ.get("OMP_NUM_THREADS"), os.environ.get("OPENBLAS_NUM_THREADS")


def kept(job: dict[str, Any], tell: Callable[[Any], None]) -> None:
    """Wait until Ctrl-C, then write a note."""
    try:
        while True:
            tell("waiting")
            time.sleep(0.05)
    except KeyboardInterrupt:
        Path(job["note"]).write_text("kept")
        raise


def _add(text: str, file: str) -> int:
    with Path(file).open("a") as opened:
        opened.write(text)
        return opened.tell()
