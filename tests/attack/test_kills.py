"""SIGKILL at any time and at every step of writing: a run is stored complete or not at all."""

from __future__ import annotations

import shutil
import signal
import time
from pathlib import Path
from random import Random

import pytest

from tests.attack import program, steps
from tests.attack.works import (
    KINDS,
    MAKING,
    TAKING,
    Work,
    furnish,
    harm_to,
    hashes,
    leftovers,
    state_of,
    whole,
)

BY_CLOCK, AT_STEPS = 64, 8
REMOVE = Work("runs rm", ("runs", "rm", "@1", "@2", "@3", "--quiet"))
PARALLEL = Work("sweep -j 2", ("sweep", "push-1d", "-p", "N=3", "--over", "M=1:2:4", "-j", "2"))


@pytest.fixture(scope="module")
def shop(servers, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a directory with a store that has one run of each kind."""
    return furnish(servers[0], tmp_path_factory.mktemp("shop"))


def test_kills_by_the_clock(shop, tally, side_by_side, dice: Random, tmp_path) -> None:
    account = tally(
        "A run is stored whole or not at all, and stored runs stay as they are.",
        "SIGKILL at a random moment of solve, continue, estimate, sweep, train, report, animate,"
        " export, with and without workers",
        10,
    )
    works = [*MAKING, *TAKING, PARALLEL]
    items = [(k, works[k % len(works)], dice.random()) for k in range(BY_CLOCK)]
    lasts: dict[str, float] = {}

    def attack(server, item) -> None:
        k, work, when = item
        place = shutil.copytree(shop, tmp_path / str(k))
        before = state_of(place / "runs")
        if work.name not in lasts:
            trial = shutil.copytree(shop, tmp_path / f"trial-{k}")
            lasts[work.name] = program.run(work.arguments, trial).seconds
        process = program.start(work.arguments, place)
        time.sleep(when * lasts[work.name])
        process.kill()
        end = program.ended(process, work.arguments)
        where = f"{end.line} killed after {when * lasts[work.name]:.3f} s"
        found = harm_to(place / "runs", before, where) + harm_to_file(place, work, where)
        found += [("orphan", f"{left}: {where}") for left in program.orphans(process.pid)]
        account.count(found, int(end.code == -signal.SIGKILL))
        shutil.rmtree(place)

    side_by_side(attack, items)


@pytest.mark.parametrize("work", [*MAKING, *TAKING], ids=lambda work: work.name.replace(" ", "-"))
def test_kills_at_steps_of_writing(shop, work, tally, side_by_side, dice, tmp_path) -> None:
    """After every kill the same command continues and ends as if it had never been killed."""
    account = tally(
        "A command that was killed goes on, and stores what it would have stored, to the last bit.",
        "SIGKILL at steps of writing of ten commands, then the same command again",
        11,
    )
    place = shutil.copytree(shop, tmp_path / "whole")
    log = tmp_path / "steps"
    step = {"under": str(tmp_path), "at": 0, "what": "kill"}
    (asked,) = side_by_side(lambda server, _: server.run(work.arguments, place, step={**step, "log": str(log)}), [0])
    assert asked.code == 0, asked.err
    before = state_of(shop / "runs")
    known = sorted(hashes(place / "runs"))
    last = steps.counted(log)
    chosen = range(1, last + 1) if last <= AT_STEPS else sorted(dice.sample(range(1, last + 1), AT_STEPS))

    def attack(server, at: int) -> None:
        here = shutil.copytree(shop, tmp_path / f"at-{at}")
        end = server.run(work.arguments, here, step={**step, "at": at})
        where = f"{end.line} killed at step {at} of {last}"
        found = harm_to(here / "runs", before, where) + harm_to_file(here, work, where)
        if end.code != -signal.SIGKILL:
            found += program.faults(end, expected=(0,))
        again = server.run(work.arguments, here)
        found += program.faults(again, expected=(0,))
        found += harm_to(here / "runs", before, where)
        after = sorted(set(hashes(here / "runs")))
        if after != sorted(set(known)):
            found.append(("altered run", f"other content after going on: {where}"))
        found += [("leftover", f"{left}: {where}") for left in leftovers(here)]
        if work.leaves and not (here / work.leaves).exists():
            found.append(("lost file", where))
        account.count(found, int(end.code == -signal.SIGKILL))
        shutil.rmtree(here)

    side_by_side(attack, chosen)


def test_kills_while_removing(shop, tally, side_by_side, tmp_path) -> None:
    account = tally(
        "A run that is removed is there whole or gone.",
        "SIGKILL at each step of runs rm with three runs",
        12,
    )
    step = {"under": str(tmp_path), "what": "kill"}
    place = shutil.copytree(shop, tmp_path / "whole")
    log = tmp_path / "steps"
    side_by_side(
        lambda server, _: server.run(REMOVE.arguments, place, step={**step, "at": 0, "log": str(log)}),
        [0],
    )

    def attack(server, at: int) -> None:
        here = shutil.copytree(shop, tmp_path / f"at-{at}")
        end = server.run(REMOVE.arguments, here, step={**step, "at": at})
        where = f"{end.line} killed at step {at}"
        found = harm_to(here / "runs", {}, where)
        if len(hashes(here / "runs")) < len(KINDS) - 3:
            found.append(("lost run", where))
        account.count(found, int(end.code == -signal.SIGKILL))

    side_by_side(attack, range(1, steps.counted(log) + 1))


def harm_to_file(place: Path, work: Work, where: str) -> list[tuple[str, str]]:
    """Return a fault if the work's file is incomplete."""
    file = place / work.leaves
    bad = work.leaves and file.exists() and not whole(file)
    return [("half file", f"{work.leaves}: {where}")] if bad else []
