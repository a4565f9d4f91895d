"""What a task would take of memory and time, asked before it is begun."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from ocp.errors import InputError
from ocp.problem import Problem

YEAR = 365.25 * 86400.0
"""Seconds; nothing is begun that would take longer."""
_LINEAR, _SQUARE = 5e3, 90.0
_ARRAYS = 4
_LIMIT = Path("/sys/fs/cgroup/memory.max")


def machine_memory() -> float:
    """Bytes of memory that this machine has, or that this process may take of it."""
    found = float(os.sysconf("SC_PAGE_SIZE")) * os.sysconf("SC_PHYS_PAGES")
    with suppress(OSError, ValueError):
        found = min(found, float(_LIMIT.read_text()))
    return found


def solve_memory(problem: Problem) -> float:
    """Bytes that a solve takes, about: ``N S (5000 v + 90 v²)`` for S scenarios.

    v = nx + nu + 2 nlam are the variables of a stage. Measured with IPOPT and MUMPS by direct
    transcription, where the peak grows by 37 kB a stage for v = 5 (wall-1d), 46 kB for v = 8
    (push-disc, over steps and over scenarios alike) and 1.0 MB for v = 81 (half-cheetah); single
    shooting takes more.
    """
    system = problem.system
    v = system.nx + system.nu + 2 * system.nlam
    return float(problem.N) * problem.scenarios.n * (_LINEAR * v + _SQUARE * v**2)


def sampling_memory(decision: float, samples: float) -> float:
    """Bytes of what is held at once of ``samples`` gradients by ``decision`` components."""
    return _ARRAYS * 8.0 * decision * samples


def check_memory(what: str, needed: float) -> None:
    """Raise :class:`~ocp.errors.InputError` where ``needed`` bytes are more than there are."""
    there = machine_memory()
    if needed > there:
        raise InputError(
            f"{what} would take about {_told(needed)} of memory, and this machine has"
            f" {_told(there)}; take fewer"
        )


def check_time(what: str, seconds: float) -> None:
    """Raise :class:`~ocp.errors.InputError` where ``seconds`` are more than a year."""
    if seconds > YEAR:
        raise InputError(f"{what} would take about {seconds / YEAR:.2g} years; take fewer")


def _told(count: float) -> str:
    return f"{count / 1e9:.3g} GB"
