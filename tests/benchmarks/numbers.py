"""Measured numbers of the site, measured again: ``make numbers`` draws twenty and compares.

A number in a page's prose is followed by ``<!-- measured: COMMAND | PATH -->``: COMMAND prints one
JSON document, in which PATH (keys and indices between dots) leads to the number. Cells of the
tables of solves are found by their row and column. What ``console`` blocks print is compared by
``tests/docs`` at every ``make test``; seconds, and what else depends on a computer's speed, are
nowhere compared.

A number agrees to 0.6 of a unit of its last printed digit, or to 1e-5: an interior-point method
that stops at tol = 1e-9 leaves (N - 1) tol / 2 in ball-throw's idle inputs, 3e-6 of its cost.
A count of iterations agrees to 2 %: processors round differently.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import secrets
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from decimal import Decimal
from functools import cache
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from typing import Any

from tests.benchmarks.ocp import test_warm_starts as warm

DOCS = Path(__file__).parents[2] / "docs"
DATA = DOCS / "generated" / "data"
_MARK = re.compile(r"([-+]?\d[\d,]*(?:\.\d+)?(?:e[-+]?\d+)?)[^\d<\n]*<!-- measured: (.+?) \| (\S+) -->")
_DECIMAL = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?$")
_COUNTS, _COSTS = 0.02, 1e-5
LAWS = {
    "exact": "exact",
    "barrier, mu = 1e-3": "barrier -c mu=1e-3",
    "adaptive, sigma = 0.02": "adaptive -c sigma=0.02",
    "randomized, sigma = 0.1": "randomized -c sigma=0.1",
}
"""Options of the command line for the laws in tables of solves."""
_KEYS = ("cost", "exact_cost", "referee_cost", "iterations")


@dataclass(frozen=True)
class Measured:
    """A number as printed on a page, the command that measures it, and its path in the command's JSON."""

    place: str
    text: str
    command: str
    path: str

    def agrees(self, found: float) -> bool:
        """Return whether a measured value agrees with the number, as described in the module."""
        stated = Decimal(self.text.replace(",", ""))
        if self.path.endswith("iterations"):
            return abs(found - float(stated)) <= _COUNTS * float(stated)
        _, digits, exponent = stated.as_tuple()
        assert digits and isinstance(exponent, int)
        slack = max(0.6 * 10.0**exponent, _COSTS * abs(float(stated)))
        return abs(found - float(stated)) <= slack


def marked(text: str, place: str) -> Iterator[Measured]:
    """Yield the numbers of a page that are marked with their command."""
    for number, command, path in _MARK.findall(text):
        yield Measured(place, number, command, path)


def in_prose() -> Iterator[Measured]:
    """Yield the marked numbers of all pages written by hand."""
    for page in sorted(DOCS.rglob("*.md")):
        if DOCS / "generated" not in page.parents:
            yield from marked(page.read_text(encoding="utf-8"), str(page.relative_to(DOCS)))


def in_tables() -> Iterator[Measured]:
    """Yield costs and iterations in the tables of solves, without the iterations of the matrix."""
    matrix = json.loads((DATA / "matrix.json").read_text(encoding="utf-8"))
    for problem, method, *cells in matrix["rows"]:
        for law, cell in zip(matrix["columns"][2:], cells, strict=True):
            command = _solve(problem.strip("`"), f"{LAWS[law]} --method {method}")
            yield from _numbers(f"matrix: {problem}, {method}, {law}", command, cell.split(" / ")[:3])
    verdicts = json.loads((DATA / "verdicts.json").read_text(encoding="utf-8"))
    for problem, law, _, *cells in verdicts["rows"]:
        if law in LAWS:
            command = _solve(problem, LAWS[law])
            yield from _numbers(f"verdicts: {problem}, {law}", command, map(str, cells[:4]))

    yield from _warm_starts()


def _warm_starts() -> Iterator[Measured]:
    """Yield iterations of cold starts, and of starts from the run before, which is in the same folder."""
    table = json.loads((DATA / "warm-starts.json").read_text(encoding="utf-8"))
    for law, *cells in table["rows"]:
        contact, parameters = warm.LAWS[law]
        words = " ".join([contact, *(f"-c {name}={value:g}" for name, value in parameters.items())])
        for change, cell in zip(table["columns"][1:], cells, strict=True):
            first, then = (
                " ".join([_solve("push-disc", words), *(f"-p {n}={v:g}" for n, v in one.items())])
                for one in warm.CHANGES[change]
            )
            commands = then, f"{first} && {then} --from @last"
            for count, command in zip(cell.split(" / "), commands, strict=True):
                yield Measured(f"warm-starts: {law}, {change}", count, command, "iterations")


def _solve(problem: str, law: str) -> str:
    return f"ocp solve {problem} --contact {law}"


def _numbers(place: str, command: str, cells: Any) -> Iterator[Measured]:
    for key, cell in zip(_KEYS, cells, strict=False):
        if _DECIMAL.match(cell):
            yield Measured(place, cell, command, key)


@cache
def document(command: str) -> Any:
    """Run the commands between ``&&`` in one new folder, and return the last one's ``--json`` output."""
    with TemporaryDirectory() as folder:
        *before, last = command.split(" && ")
        program = f'"{sys.executable}" -m ocp'
        lines = [line.replace("ocp ", f"{program} ", 1) + " --quiet" for line in [*before, last]]
        lines = [*(f"{line} > {os.devnull}" for line in lines[:-1]), f"{lines[-1]} --json"]
        done = subprocess.run(
            " && ".join(lines),
            shell=True,
            cwd=folder,
            text=True,
            capture_output=True,
            check=False,
        )
    if done.returncode not in (0, 3):
        raise RuntimeError(f"{command} ended with {done.returncode}: {done.stderr.strip()}")
    return json.loads(done.stdout)


def measure(number: Measured) -> float:
    """Measure a number again."""
    found = document(number.command)
    for key in number.path.split("."):
        found = found[int(key) if key.lstrip("-").isdigit() else key]
    return float(found)


def compare(drawn: list[Measured], jobs: int = 1) -> list[str]:
    """Measure numbers again, print each, and return those that differ."""
    off = []
    with ThreadPoolExecutor(jobs) as pool:
        for number, found in zip(drawn, pool.map(measure, drawn), strict=True):
            line = f"{number.place}: {number.path} {number.text}, now {found:.9g} ({number.command})"
            print("agrees " if number.agrees(found) else "DIFFERS", line, flush=True)
            off += [] if number.agrees(found) else [line]
    return off


def main(arguments: list[str] | None = None) -> int:
    """Draw numbers by a seed, which is printed, and measure them; return 1 if one differs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--seed", type=int, default=secrets.randbelow(10**6))
    parser.add_argument("--jobs", type=int, default=1)
    given = parser.parse_args(arguments)
    numbers = [*in_prose(), *in_tables()]
    drawn = Random(given.seed).sample(numbers, min(given.count, len(numbers)))
    print(f"seed {given.seed}: {len(drawn)} of {len(numbers)} measured numbers", flush=True)
    return 1 if compare(drawn, given.jobs) else 0


if __name__ == "__main__":
    raise SystemExit(main())
