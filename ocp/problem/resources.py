"""Estimates of a task's memory and time: tasks that do not fit are rejected, long ones announced.

Bytes were measured in float64 for IPOPT with MUMPS. The estimates are coarse, but distinguish a
hundred megabytes from a hundred gigabytes.
"""

from __future__ import annotations

import os
import resource
from contextlib import suppress
from pathlib import Path

from dynamics.contact import ContactLaw
from ocp.errors import InputError
from ocp.problem.policy import Feedback, Policy
from ocp.problem.problem import Problem

YEAR = 365.25 * 86400.0
"""Seconds in a year; tasks that would take longer are rejected."""
LONG = 60.0
"""Duration [s] from which the user is told in advance that a task is long."""
BYTES_PER_VARIABLE = 5e3
"""Memory of a stage per variable [bytes]."""
BYTES_PER_SQUARE = 90.0
"""Memory of a stage per squared number of its variables [bytes]. With v variables peak memory grows per stage by
37 kB for v = 5 (wall-1d), 46 kB for 8 (push-disc, over steps and over scenarios alike) and 1.0 MB for 81
(half-cheetah) by direct transcription; by 178 kB for 18 (push-disc with feedback, 20 to 120
scenarios). Single shooting takes more."""
SECONDS_PER_BYTE = 5e-10
"""Seconds of an iteration per byte of the solve's memory, accurate enough to distinguish a minute from an hour."""
SOLVE_ITERATIONS = 200
"""Number of iterations of a solve assumed in time estimates."""
STAGE_ITERATIONS = 2
"""Minimum number of iterations assumed for each stage of a path."""
FOLLOWED = 0.1
"""Time of one point of a parameter continuation, relative to the time of a solve."""
BYTES_PER_POINT = 1e5
"""Memory of a solved point in addition to its trajectories, mostly for labels [bytes]."""
_ARRAYS = 4
"""Number of copies of large arrays that are in memory at the same time."""
STUDY = 2e6
"""Maximum size of a figure's largest arrays at its default counts [bytes]."""
_CGROUPS = Path("/sys/fs/cgroup")
"""Folder that contains all control groups."""
_PROCESS_CGROUPS = Path("/proc/self/cgroup")
"""File that names the control groups of this process."""


def machine_memory() -> float:
    """Return the memory of this computer, or the part that this process may use [bytes].

    Limits are set by control groups (versions 1 and 2) and by ``ulimit -v``.
    """
    memory = float(os.sysconf("SC_PAGE_SIZE")) * os.sysconf("SC_PHYS_PAGES")
    soft = resource.getrlimit(resource.RLIMIT_AS)[0]
    if soft != resource.RLIM_INFINITY:
        memory = min(memory, float(soft))
    for file in _limits():
        with suppress(OSError, ValueError):
            memory = min(memory, float(file.read_text()))
    return memory


def _limits() -> list[Path]:
    """Return the files with memory limits of this process, including those of enclosing control groups."""
    files = [_CGROUPS / "memory.max", _CGROUPS / "memory/memory.limit_in_bytes"]
    with suppress(OSError):
        for line in _PROCESS_CGROUPS.read_text().splitlines():
            _, kinds, group_path = line.split(":", 2)
            root, name = (_CGROUPS, "memory.max")
            if kinds:
                root, name = (_CGROUPS / "memory", "memory.limit_in_bytes")
            if not kinds or "memory" in kinds.split(","):
                group = root / group_path.strip("/")
                files += [folder / name for folder in (group, *group.parents) if root in folder.parents]
    return files


def stage_size(problem: Problem, policy: Policy | None = None) -> int:
    """Return the number of variables of a stage: ``nx + nu + 2 nlam``, plus the gains of a feedback policy."""
    system = problem.system
    gains = system.nu * (system.nx + 1) if isinstance(policy, Feedback) else 0
    return system.nx + system.nu + 2 * system.nlam + gains


def solve_memory(problem: Problem, policy: Policy | None = None, law: ContactLaw | None = None) -> float:
    """Return the approximate memory of a solve [bytes]: per stage a polynomial in :func:`stage_size`.

    The program has a stage for every step, scenario and node of the law.
    """
    v, nodes = stage_size(problem, policy), 1
    if law is not None:
        nodes = len(law.nodes(problem.system, law.parameters(problem.system)))
    stages = float(problem.N) * problem.scenarios.n * nodes
    return stages * (BYTES_PER_VARIABLE * v + BYTES_PER_SQUARE * v**2)


def solve_seconds(
    problem: Problem, policy: Policy | None = None, law: ContactLaw | None = None, path: int = 1
) -> float:
    """Return the approximate time of a solve [s] whose homotopy has ``path`` stages of at least two iterations."""
    iterations = max(SOLVE_ITERATIONS, STAGE_ITERATIONS * path)
    return iterations * SECONDS_PER_BYTE * solve_memory(problem, policy, law)


def points_memory(problem: Problem, count: float, longer: float = 1.0) -> float:
    """Return the memory of ``count`` solved points [bytes]: plan, replay and referee's replay of each point.

    ``longer`` is the ratio of steps times scenarios of the longest point to those of ``problem``.
    """
    numbers = problem.N * problem.scenarios.n * stage_size(problem) * longer
    return count * (BYTES_PER_POINT + _ARRAYS * 8.0 * numbers)


def sampling_memory(decision: float, samples: float) -> float:
    """Return the memory of ``samples`` gradients with ``decision`` components each, including copies [bytes]."""
    return _ARRAYS * 8.0 * decision * samples


def check_memory(task_name: str, needed_bytes: float) -> None:
    """Raise :class:`~ocp.errors.InputError` if ``needed_bytes`` exceed the available memory."""
    available = machine_memory()
    if needed_bytes > available:
        raise InputError(
            f"{task_name} would take about {_gigabytes(needed_bytes)} of memory, and this machine has"
            f" {_gigabytes(available)}; take fewer"
        )


def check_time(task_name: str, seconds: float) -> None:
    """Raise :class:`~ocp.errors.InputError` if ``seconds`` are more than a year."""
    if seconds > YEAR:
        raise InputError(f"{task_name} would take about {seconds / YEAR:.2g} years; take fewer")


def long_task_notice(task_name: str, seconds: float, memory: float = 0.0) -> str | None:
    """Return a line that announces a task longer than :data:`LONG`, or None for a shorter task."""
    if seconds < LONG:
        return None
    size = f" and {_gigabytes(memory)} of memory" if memory > 1e9 else ""
    return f"{task_name} will take longer than a minute{size} (an estimate)"


def _gigabytes(count: float) -> str:
    return f"{count / 1e9:.3g} GB"
