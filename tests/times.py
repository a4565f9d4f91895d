"""``python -m tests.times``: measure the tests, and print the tests whose markers do not fit their cost.

The cost of a test is the processor time of the test, its fixtures and its child processes. ``make test`` allows
:data:`TEST` for all cases of one test; more expensive ones need a marker of ``tests/conftest.py``, which leaves
the test or some of its cases to ``make test-slow``.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
TEST = 0.5
"""Maximum processor time [s] of all cases of one test together."""
ALWAYS = (
    "tests/cli/test_limits.py::test_what_cannot_be_is_refused[units]",
    "tests/cli/test_one_way.py::test_a_solve_with_its_pdf_loads_and_calls_little",
    "tests/cli/test_pdf.py::test_reports_of_stored_runs",
    "tests/cli/test_sweep.py::test_the_same_command_goes_on_after_a_kill_or_ctrl_c[9]",
    "tests/crossed/test_crossings.py::test_a_way_on_a_problem_ends_with_its_exit_code",
    "tests/crossed/test_crossings.py::test_a_way_on_a_problem_gives_a_verdict_or_a_sentence",
    "tests/docs/test_generated.py::test_generated_pages_are_in_step",
    "tests/docs/test_pages.py::test_a_page_works_as_printed[README.md]",
    "tests/docs/test_pages.py::test_a_page_works_as_printed[docs/tutorials/first-solve.md]",
    "tests/unit/ocp/jobs/test_estimate_by_name.py::test_a_stopped_estimate_resumes_with_other_workers",
    "tests/unit/ocp/judge/test_sensitivity.py::test_sensitivities_are_the_limit_of_re_solves[cart-walls-mp-exact]",
    "tests/unit/test_words.py::test_a_word_has_one_meaning",
)
"""Tests that run at any cost: complete uses of the program, and tests that alone caught a deliberate fault."""
TIMES, ALL = "TEST_TIMES", "ALL_TESTS"
"""Environment variables: the file for the time of each test; if the second is set, no test is marked slow."""
MARKERS = ("costly", "costly_cases", "cheap_cases", "one_case_in")


def as_users_compile() -> bool:
    """Return whether C is compiled as in the program: as other processors, but not where costs are measured."""
    return bool(os.environ.get(ALL)) and not os.environ.get(TIMES)


def processor_seconds() -> float:
    """Return the processor time [s] of this process and of its children that have ended."""
    usages = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


def record(item: pytest.Item, seconds: float) -> None:
    """Append one line to the file of times, which processes share: cost, whether a marker is set, and name."""
    if file := os.environ.get(TIMES):
        marked = any(item.get_closest_marker(name) for name in MARKERS)
        with Path(file).open("a") as lines:
            lines.write(f"{seconds:.3f} {'marked' if marked else 'plain'} {item.nodeid}\n")


def misfits(lines: Iterable[str]) -> Iterator[str]:
    """Yield a sentence on each test that is expensive and not marked, or marked and cheap, from a file's lines."""
    costs: defaultdict[tuple[str, str], list[float]] = defaultdict(list)
    for line in lines:
        seconds, marked, name = line.rstrip("\n").split(" ", 2)
        costs[name.partition("[")[0], marked].append(float(seconds))
    for (test, marked), cases in costs.items():
        dear = sum(cases) > TEST
        if dear != (marked == "marked") and not any(name.startswith(test) for name in ALWAYS):
            yield f"{test}: {sum(cases):.1f} s in {len(cases)} cases, {'not ' * dear}marked"


def main() -> None:
    """Run all tests with one worker per core, and print which markers should be added or removed."""
    file = ROOT / "build/times.txt"
    file.parent.mkdir(exist_ok=True)
    file.unlink(missing_ok=True)
    command = [sys.executable, "-m", "pytest", "-n", "auto", "--dist", "worksteal"]
    subprocess.run(command, env={**os.environ, ALL: "1", TIMES: str(file)}, cwd=ROOT, check=False)
    print("\n".join(misfits(file.read_text().splitlines())))


if __name__ == "__main__":
    main()
