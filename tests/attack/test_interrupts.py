"""Ctrl-C at any time from the first millisecond: one sentence, no incomplete file, finished work is kept."""

from __future__ import annotations

import shutil
import signal
import time
from pathlib import Path
from random import Random

import pytest

from tests.attack import program
from tests.attack.works import MAKING, TAKING, Work, furnish, harm_to, leftovers, state_of, whole

EARLY, LATE = 80, 40
EARLY_S = 0.4
SHORT = tuple(
    Work(line, tuple(line.split()))
    for line in (
        "list",
        "show push-1d",
        "runs",
        "doctor",
        "solve --help",
        "solve wall-1d -p N=1e99",
    )
)
CODES = (0, 2, 3, 130, -signal.SIGINT)
"""Exit codes after Ctrl-C; before Python installs its handler, the signal ends the process directly."""


@pytest.fixture(scope="module")
def shop(servers, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return furnish(servers[0], tmp_path_factory.mktemp("shop"))


@pytest.mark.parametrize("part", ["early", "late"])
def test_interrupts(shop, part: str, tally, side_by_side, dice: Random, tmp_path) -> None:
    early = part == "early"
    account = tally(
        "Ctrl-C ends at once with one sentence, and loses nothing that was finished.",
        f"SIGINT in the first {EARLY_S} s of {len(SHORT + MAKING + TAKING)} commands"
        if early
        else "SIGINT at a random moment of ten commands, every other time twice",
        50 if early else 51,
    )
    works = (*SHORT, *MAKING, *TAKING) if early else (*MAKING, *TAKING)
    items = [
        (k, works[k % len(works)], EARLY_S * (k / EARLY) if early else 3 * dice.random())
        for k in range(EARLY if early else LATE)
    ]

    def attack(_server, item) -> None:
        k, work, when = item
        place = shutil.copytree(shop, tmp_path / str(k))
        before = state_of(place / "runs")
        process = program.start(work.arguments, place)
        time.sleep(when)
        process.send_signal(signal.SIGINT)
        if not early and k % 2:
            time.sleep(0.05)
            process.send_signal(signal.SIGINT)
        end = program.ended(process, work.arguments, patience=60.0)
        where = f"{end.line} interrupted after {when:.3f} s"
        too_early = program.of_python_alone(end)
        words = [] if too_early else program.faults(end, expected=CODES)
        found = [(kind, f"{where}: {told}") for kind, told in words]
        found += harm_to(place / "runs", before, where)
        found += [("orphan", f"{left}: {where}") for left in program.orphans(process.pid)]
        if early or not k % 2:
            # A second Ctrl-C ends at once, and the next save sweeps what it left.
            found += [("leftover", f"{left}: {where}") for left in leftovers(place)]
        file = place / work.leaves
        if work.leaves and file.exists() and not whole(file):
            found.append(("half file", where))
        account.count(found, int(not too_early))
        shutil.rmtree(place)

    side_by_side(attack, items)
