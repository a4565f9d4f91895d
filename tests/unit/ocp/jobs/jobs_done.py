"""Jobs for workers: they find this module by its name."""

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
    """The square of x, from pieces told on the way; may die, fail or wait as it is asked to."""
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
    """How many threads numerical libraries are told to take."""
    return os.environ.get("OMP_NUM_THREADS"), os.environ.get("OPENBLAS_NUM_THREADS")


def kept(job: dict[str, Any], tell: Callable[[Any], None]) -> None:
    """Wait for ever, and keep a note of Ctrl-C."""
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
