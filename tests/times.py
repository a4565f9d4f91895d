"""``python -m tests.times``: measure all tests but studies, and list those that are slow.

The cost of a test is the processor time of the test, its fixtures and its child processes.
``tests/slow.txt`` lists every test, or case of a test, above :data:`MOST`, and the most expensive
cases of a test, until the others take :data:`MOST_OF_ALL_CASES` together. ``make test`` runs what
is not listed; ``make test-slow`` runs the rest.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path

ROOT = Path(__file__).parents[1]
LIST = ROOT / "tests/slow.txt"
MOST, MOST_OF_ALL_CASES = 0.5, 1.0
"""Seconds of processor time of one case, and of all cases of one test together."""
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
    "tests/unit/ocp/gradients/test_estimate_by_name.py::test_a_stopped_estimate_resumes_with_other_workers",
    "tests/unit/ocp/test_sensitivity.py::test_sensitivities_are_the_limit_of_re_solves[cart-walls-mp-exact]",
    "tests/unit/test_words.py::test_a_word_has_one_meaning",
)
"""Whole ways through the program, and tests that alone caught a fault put in: they stay in
``make test`` whatever they take."""
TIMES, ALL = "TEST_TIMES", "ALL_TESTS"
"""Environment variables: a file that gets the time of each test; no test is slow by the list."""


def listed() -> frozenset[str]:
    """Tests and cases of ``tests/slow.txt``."""
    return frozenset(LIST.read_text().splitlines())


def processor_seconds() -> float:
    """Processor time of this process and of its children that ended."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def keep(test: str, seconds: float) -> None:
    """Append one line to the file of times; processes share it."""
    if file := os.environ.get(TIMES):
        with Path(file).open("a") as lines:
            lines.write(f"{seconds:.3f} {test}\n")


def slow(seconds: Mapping[str, float]) -> Iterator[str]:
    """Tests, or cases of them, that are slow by what each took."""
    cases: defaultdict[str, list[tuple[float, str]]] = defaultdict(list)
    for test, took in seconds.items():
        cases[test.partition("[")[0]].append((took, test))
    for name, of_one in cases.items():
        total, left = 0.0, []
        for took, test in sorted(of_one):
            if {name, test} & set(ALWAYS) or (took < MOST and total + took <= MOST_OF_ALL_CASES):
                total += took
            else:
                left.append(test)
        yield from left if len(left) < len(of_one) else [name]


def main() -> None:
    """Measure, with one worker a core, until what is left has no slow test.

    The first pass runs all; a test that is left has to pay for fixtures that it shared.
    """
    file, seconds = ROOT / "build/times.txt", dict[str, float]()
    file.parent.mkdir(exist_ok=True)
    command = [sys.executable, "-m", "pytest", "-n", "auto", "--dist", "worksteal"]
    new, more = frozenset({""}), {ALL: "1"}
    while new:
        file.unlink(missing_ok=True)
        subprocess.run(command, env={**os.environ, **more, TIMES: str(file)}, cwd=ROOT, check=True)
        rows = (line.split(" ", 1) for line in file.read_text().splitlines())
        seconds |= {test: float(took) for took, test in rows}
        names = frozenset(slow(seconds))
        new, more = names - listed(), {}
        LIST.write_text("".join(f"{name}\n" for name in sorted(names)))


if __name__ == "__main__":
    main()
