"""Robots in space: equations, compiled stages, iterations and rollouts, compared with other packages.

``python -m tests.benchmarks.robots.bench [equations] [stage] [iteration] [rollouts]`` measures all
or some and rewrites the site's tables. Robots of packages that are not installed are searched for
in the folders of ``EXTRA_ROBOTS``; ``PEERS`` is the Python that has pin and adam-robotics
(:mod:`tests.benchmarks.robots.peers`). All times are processor times, the least of several.
"""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Callable, Iterator

from docs.generator.measured import DATA, read, table, write_table
from tests.benchmarks.robots import ants, peers, quadruped
from tests.benchmarks.robots.equations import FILES, SOLO, STATES, WITHIN, measured

COMMAND = "make bench-robots"
ROBOTS = ("robot", "velocities", "M off by", "bias", "Jacobian", "M, instructions", "bias ", "Jacobian ")
SPEED = ("what", "measured", "floor", "beside it")
RATIO, COMPILE_S, ITERATION_MS, TIMES = 2.0, 30.0, 16.0, 10.0
ISSUE = "adam-robotics, as the issue has it", 18, "", "", "", 5112, 2919, 785
Row = tuple[str, str, str, str]


def shown(text: str, missed: bool) -> str:
    """Return text in bold and marked if its floor is missed."""
    return f"**{text} missed**" if missed else text


def equations() -> None:
    """Write the table of robots."""
    rows, left = [], []
    for file in FILES:
        path = file.find()
        if path is None:
            left.append(file.path)
            continue
        rows.append(measured(file, path))
        print(table(ROBOTS, rows[-1:]).splitlines()[-1], flush=True)
    rows.append(list(ISSUE))
    solo = next((f.find() for f in FILES if f.path == SOLO), None)
    if solo and (python := os.environ.get("PEERS")):
        counts = peers.asked(python, solo)["adam"]
        lengths = (counts.get(name, "") for name in ("M", "bias", "J"))
        rows.append(["solo12, adam-robotics here", 18, "", "", "", *lengths])
    print(f"not installed here: {', '.join(left) or 'none'}")
    note = (
        f"Of {STATES} random states the largest difference from MuJoCo, over the largest entry"
        f" where that is above 1; floor {WITHIN:g}."
    )
    title = "Equations of robots"
    write_table("robots", title=title, command=COMMAND, columns=ROBOTS, rows=rows, note=note)


def stage() -> Iterator[Row]:
    """Yield rows on one stage of the quadruped in C, and on compile times."""
    made = quadruped.problem()
    residual, slopes, second = quadruped.stage_us(made)
    ours, what = slopes + second, "stage of the quadruped: residual and Jacobian, Hessian"
    parts = f"{ours:.1f} µs = {slopes:.1f} + {second:.1f}"
    solo, python = next((f.find() for f in FILES if f.path == SOLO), None), os.environ.get("PEERS")
    found = peers.asked(python, solo)["pin"] if python and solo else {"missing": "PEERS is not set"}
    if "second" in found:
        theirs = found["RNEA derivatives"] + found["second"]
        beside = (
            f"pin on Solo12 {found['how']}: {theirs:.1f} µs = RNEA derivatives"
            f" {found['RNEA derivatives']:.1f} + second ones {found['second']:.1f};"
            f" ABA derivatives {found['ABA derivatives']:.1f}"
        )
        parts = shown(parts, ours > RATIO * theirs)
    else:
        beside = f"pin: {found}"
    yield what, parts, f"{RATIO:g} times pin's", beside
    yield "its residual alone", f"{residual:.1f} µs", "", f"RNEA {found.get('rnea', 0):.1f} µs"
    (first, wall), (again, _) = quadruped.build_s(made)
    text = shown(f"{first:.1f} s", first > COMPILE_S)
    yield (
        "program of the exact law with jit, built and compiled",
        text,
        f"{COMPILE_S:g} s",
        f"from the cache {again:.1f} s; by the clock {wall:.0f} s at load {os.getloadavg()[0]:.1f}",
    )


def iteration() -> Iterator[Row]:
    """Yield rows on one iteration of the relaxed program."""
    made = quadruped.problem()
    ways = {"": (False, {}), ", jit": (True, {}), ", jit, AMD": (True, {"mumps_pivot_order": 0})}
    for name, (jit, options) in ways.items():
        total, functions, linear, count = quadruped.iteration_ms(made, jit, **options)
        text = f"{total:.1f} ms"
        if options:
            text = shown(text, total > ITERATION_MS)
        yield (
            f"iteration of the relaxed program, N = {quadruped.N}{name}",
            text,
            f"{ITERATION_MS:g} ms" if options else "",
            f"functions {functions:.1f}, linear solver {linear:.1f}; {count} iterations",
        )


def rollouts() -> Iterator[Row]:
    """Yield rows on rollouts of the ant, with gradients."""
    path = FILES[0].find()
    theirs = ants.theirs_ms(path) if path else float("nan")
    for mu in (1e-3, 1e-2):
        ours = ants.ours_ms(ants.rollouts(mu, "c"))
        text = shown(f"{theirs / ours:.1f} times: {ours:.2f} ms", theirs < TIMES * ours)
        yield (
            f"ant, {ants.STEPS} steps with gradient, mu = {mu:g}",
            text,
            f"{TIMES:g} times",
            f"MuJoCo's mj_step and mjd_transitionFD: {theirs:.2f} ms",
        )


def main(words: list[str]) -> None:
    """Measure and store row after row."""
    warnings.simplefilter("ignore")
    if not words or "equations" in words:
        equations()
    parts: tuple[Callable[[], Iterator[Row]], ...] = (stage, iteration, rollouts)
    for part in parts:
        if words and part.__name__ not in words:
            continue
        for row in part():
            old = read("robots-speed")["rows"] if (DATA / "robots-speed.json").exists() else []
            rows = [cells for cells in old if cells[0] != row[0]] + [list(row)]
            write_table(
                "robots-speed",
                title="Robots in space: times",
                command=COMMAND,
                columns=SPEED,
                rows=rows,
                note="Processor times, the least of several.",
            )
            print(table(SPEED, [row]).splitlines()[-1], flush=True)


if __name__ == "__main__":
    main([word for text in sys.argv[1:] for word in text.split(",") if word])
