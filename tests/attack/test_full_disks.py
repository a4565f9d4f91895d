"""Full disks at every step of writing, of every size, wherever the program writes."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from random import Random

import pytest

from tests.attack import program, steps
from tests.attack.works import MAKING, TAKING, furnish, harm_to, leftovers, state_of, whole

WORKS = (*MAKING, *TAKING)
AT_STEPS = 6
CODES = (1, 2)
LIMITS = (2048, 4096, 8192, 20_000, 40_000, 80_000)
"""Maximum sizes of a file [byte], standard error included; a run has about ten thousand bytes."""
SIZES = ("4k", "16k", "32k", "64k")


@pytest.fixture(scope="module")
def shop(servers, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return furnish(servers[0], tmp_path_factory.mktemp("shop"))


def judged(end, work, place: Path, before: dict[str, bytes], where: str) -> list[tuple[str, str]]:
    """Return the faults caused by a full disk, which may lose the result but nothing else."""
    found = [(kind, f"{where}: {told}") for kind, told in program.faults(end, expected=(0, *CODES))]
    found += harm_to(place / "runs", before, where)
    found += [("leftover", f"{left}: {where}") for left in leftovers(place)]
    file = place / work.leaves
    if work.leaves and file.is_file() and not whole(file):
        found.append(("half file", where))
    if end.code == 0 and work in MAKING and len(state_of(place / "runs")) <= len(before):
        found.append(("lost run", f"{where}: it says all is well"))
    return found


@pytest.mark.parametrize("work", WORKS, ids=lambda work: work.name.replace(" ", "-"))
def test_full_at_steps_of_writing(shop, work, tally, side_by_side, dice: Random, tmp_path) -> None:
    account = tally(
        "A full disk costs the result and one sentence: no half run, no half file.",
        "the disk is full from the n-th step of writing on, for every command that writes",
        60,
    )
    log, place = tmp_path / "steps", shutil.copytree(shop, tmp_path / "whole")
    step = {"under": str(tmp_path), "what": "full"}
    counting = {**step, "at": 0, "log": str(log)}
    side_by_side(lambda server, _: server.run(work.arguments, place, step=counting), [0])
    before, last = state_of(shop / "runs"), steps.counted(log)
    every = range(1, last + 1)

    def attack(server, at: int) -> None:
        here = shutil.copytree(shop, tmp_path / f"at-{at}")
        end = server.run(work.arguments, here, step={**step, "at": at})
        account.count(judged(end, work, here, before, f"full from step {at} of {last}"))
        shutil.rmtree(here)

    side_by_side(attack, every if last <= AT_STEPS else sorted(dice.sample(every, AT_STEPS)))


def test_files_that_may_not_grow(shop, tally, side_by_side, tmp_path) -> None:
    account = tally(
        "A full disk costs the result and one sentence: no half run, no half file.",
        "RLIMIT_FSIZE from 2,048 to 80,000 bytes",
        61,
    )
    before = state_of(shop / "runs")
    pairs = [(work, limit) for work in WORKS for limit in LIMITS]

    def attack(server, pair) -> None:
        work, limit = pair
        here = shutil.copytree(shop, tmp_path / f"{work.name}-{limit}".replace(" ", "-"))
        end = server.run(work.arguments, here, limits={"RLIMIT_FSIZE": limit})
        account.count(judged(end, work, here, before, f"{work.name}, files up to {limit} bytes"))
        shutil.rmtree(here)

    side_by_side(attack, pairs)


@contextmanager
def small_disk(place: Path, size: str) -> Iterator[Path]:
    """Mount a file system of the given size within the block."""
    place.mkdir(parents=True, exist_ok=True)
    mount = ["mount", "-t", "tmpfs", "-o", f"size={size}", "attack", str(place)]
    subprocess.run(mount, check=True, capture_output=True)
    try:
        yield place
    finally:
        subprocess.run(["umount", "--lazy", str(place)], check=True)


def may_mount(place: Path) -> bool:
    """Return whether this user may mount a small file system."""
    try:
        with small_disk(place, "64k"):
            return True
    except (subprocess.CalledProcessError, FileNotFoundError):
        return False


def test_small_disks(shop, tally, side_by_side, tmp_path) -> None:
    account = tally(
        "A full disk costs the result and one sentence: no half run, no half file.",
        "a store, a folder for temporary files, and a cache on file systems of 4 to 64 kB",
        62,
    )
    if os.geteuid() or not may_mount(tmp_path / "trial"):
        pytest.skip("only root may mount file systems")
    compiling = ("estimate", "push-1d", "-p", "N=3", "-n", "64", "--backend", "auto", "--quiet")
    works = [*WORKS, type(WORKS[0])("compile", compiling)]
    pairs = [(work, size) for k, work in enumerate(works) for size in (SIZES[k % 4], SIZES[0])]

    def attack(server, item) -> None:
        at, (work, size) = item
        here = tmp_path / f"{at}"
        with small_disk(here / "store", size) as full, small_disk(here / "else", "4k") as other:
            line = [*work.arguments, "--out", str(full / "runs")]
            if work in MAKING:
                end = server.run(line, here)
                account.count(judged(end, work, full, {}, f"{work.name}, a store of {size}"))
            (other / "full").write_bytes(b"\0" * 4096)
            place = shutil.copytree(shop, here / "place")
            elsewhere = {"TMPDIR": str(other), "XDG_CACHE_HOME": str(other)}
            before = state_of(place / "runs")
            for names in (("TMPDIR",), ("XDG_CACHE_HOME",), ("TMPDIR", "XDG_CACHE_HOME")):
                given = {name: elsewhere[name] for name in names}
                end = server.run(work.arguments, place, **given)
                found = judged(end, work, place, before, f"{work.name}, full: {', '.join(names)}")
                if end.code != 0 and work in (*MAKING, works[-1]):
                    found.append(("lost run", f"{end.line} needs no {names}: {end.last}"))
                account.count(found)
                before = state_of(place / "runs")

    side_by_side(attack, list(enumerate(pairs)))


def test_devices_for_output(shop, tally, side_by_side, tmp_path) -> None:
    account = tally(
        "A device or a FIFO is written to, never replaced; folders are refused.",
        "/dev/full, /dev/null, FIFOs, folders and links as every output file",
        63,
    )
    lines = [
        ["solve", "wall-1d", "-p", "N=4", "-q", "--pdf"],
        ["report", "@1", "-q", "-o"],
        ["runs", "export", "@1", "--format", "npz", "-o"],
        ["export", "push-1d", "-q", "-o"],
        ["collect", "push-1d", "--samples", "10", "-q", "-o"],
        ["animate", "@5", "-q", "-o"],
        ["show", "push-1d", "--plot"],
        ["solve", "wall-1d", "-p", "N=4", "-q", "--plot"],
    ]

    def attack(server, line: list[str]) -> None:
        here = shutil.copytree(shop, tmp_path / "-".join(line).replace("/", "") / "here")
        before, found, attempts = state_of(here / "runs"), [], 0
        null = here / "null"
        if os.geteuid() == 0:
            os.mknod(null, 0o20666, os.makedev(1, 3))
        (here / "folder.pdf").mkdir()
        (here / "link.pdf").symlink_to("target.pdf")
        for name in ("/dev/full", "null", "folder.pdf", "link.pdf", "no/such/place.pdf", ""):
            end = server.run([*line, name], here)
            may = name in ("null", "link.pdf", "no/such/place.pdf")
            found += program.faults(end, expected=(0, *CODES) if may else CODES)
            found += harm_to(here / "runs", before, end.line)
            attempts += 1
        if null.exists() and not null.is_char_device():
            found.append(("replaced device", " ".join(line)))
        if not (here / "folder.pdf").is_dir() or not (here / "link.pdf").is_symlink():
            found.append(("replaced link or folder", " ".join(line)))
        account.count(found, attempts)

    side_by_side(attack, lines)
