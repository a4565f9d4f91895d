"""Flipped bits, and truncated, swapped or emptied files: damage is reported, and never read as data."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from random import Random

import pytest

from ocp import store
from ocp.errors import DamagedRun, InputError
from tests.attack import program
from tests.attack.works import KINDS, furnish, run_of

FLIPS, SHOWN = 400, 1
READERS = (
    ("runs", "RUN"),
    ("report", "RUN", "-o", "out.pdf"),
    ("runs", "export", "RUN", "-o", "o.npz"),
    ("replay", "RUN"),
    ("animate", "RUN", "-o", "out.html"),
    ("evaluate", "RUN"),
    ("figure", "RUN"),
    ("export", "RUN", "-o", "o.c"),
    ("solve", "push-1d", "--from", "RUN"),
    ("estimate", "push-1d", "--at", "RUN", "-n", "10"),
)
"""Commands that read a run."""


@pytest.fixture(scope="module")
def shop(servers, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return furnish(servers[0], tmp_path_factory.mktemp("shop"))


@contextmanager
def changed(file: Path, content: bytes) -> Iterator[None]:
    """Replace a file's content within the block."""
    before = file.read_bytes()
    file.write_bytes(content)
    try:
        yield
    finally:
        file.write_bytes(before)


def flipped(content: bytes, bit: int) -> bytes:
    """Return ``content`` with one bit flipped."""
    other = bytearray(content)
    other[bit // 8] ^= 1 << bit % 8
    return bytes(other)


@pytest.mark.parametrize("kind", KINDS)
def test_flipped_bits(shop, kind: str, tally, side_by_side, dice: Random) -> None:
    account = tally(
        "A stored run that was altered is called damaged; no number of it is shown.",
        f"{FLIPS} single bits flipped in every file of runs of {len(KINDS)} kinds",
        20,
    )
    run = run_of(shop / "runs", kind)
    for file in sorted(run.iterdir()):
        content = file.read_bytes()
        bits = [dice.randrange(8 * len(content)) for _ in range(FLIPS)]
        for bit in bits:
            with changed(file, flipped(content, bit)):
                account.count(accepted(run, f"{kind}/{file.name}, bit {bit % 8} of byte {bit // 8}"))
        for bit in bits[:SHOWN]:
            with changed(file, flipped(content, bit)):
                account.count(by_commands(side_by_side, run, shop, f"{file.name}, bit {bit}"), 0)
                account.count([], len(READERS))


def test_cut_emptied_and_swapped_files(shop, tally, side_by_side, dice: Random, tmp_path) -> None:
    account = tally(
        "A stored run that was altered is called damaged; no number of it is shown.",
        "files of runs cut short, emptied, lengthened, missing, or swapped with another run's",
        21,
    )
    runs = {kind: run_of(shop / "runs", kind) for kind in KINDS}
    for kind, run in runs.items():
        other = runs[KINDS[KINDS.index(kind) - 1]]
        for file in sorted(run.iterdir()):
            content = file.read_bytes()
            foreign = (other / file.name).read_bytes()
            cuts = [content[: dice.randrange(len(content))] for _ in range(20)]
            harms = [*cuts, b"", content + b"\n", content + content, foreign, b"\0" * len(content)]
            for harm in harms:
                with changed(file, harm):
                    account.count(accepted(run, f"{kind}/{file.name} of {len(harm)} bytes"))
            spare = tmp_path / file.name
            shutil.move(file, spare)
            account.count(accepted(run, f"{kind} without {file.name}"))
            shutil.move(spare, file)
    run = runs["solve"]
    with changed(run / "meta.json", (run / "meta.json").read_bytes()[:-40]):
        account.count(by_commands(side_by_side, run, shop, "meta.json cut"), len(READERS))


def test_altered_descriptions(shop, tally, side_by_side) -> None:
    account = tally(
        "A stored run that was altered is called damaged; no number of it is shown.",
        "every value of a run's description replaced, one at a time, as a text editor would",
        22,
    )
    for kind in KINDS:
        run = run_of(shop / "runs", kind)
        file = run / "meta.json"
        meta = json.loads(file.read_bytes())
        for key in meta:
            for value in (None, "str", -1, 1e308, [], {}, True):
                if meta[key] == value:
                    continue
                with changed(file, json.dumps({**meta, key: value}, indent=1).encode()):
                    account.count(accepted(run, f"{kind}, {key} = {value!r}"))
    run = run_of(shop / "runs", "solve")
    meta = json.loads((run / "meta.json").read_bytes())
    for key, value in (("status", "splendid"), ("cost", 0), ("record", "str")):
        altered = json.dumps({**meta, key: value}).encode()
        with changed(run / "meta.json", altered):
            where = f"{key} = {value!r}"
            account.count(by_commands(side_by_side, run, shop, where), len(READERS))


def accepted(run: Path, where: str) -> list[tuple[str, str]]:
    """Return the faults in how a damaged run is read."""
    try:
        store.load(run)
    except DamagedRun:
        return []
    except InputError as error:
        return [("not called damaged", f"{where}: {error}")]
    except Exception as error:
        return [("internal error", f"{where}: {error!r}")]
    return [("altered run accepted", where)]


def by_commands(side_by_side, run: Path, directory: Path, where: str) -> list[tuple[str, str]]:
    """Return the faults in how commands handle a damaged run: they must exit with 4, listings with 0 or 4."""

    def ask(server, words: tuple[str, ...]) -> list[tuple[str, str]]:
        end = server.run([str(run) if word == "RUN" else word for word in words], directory)
        expected = (4,) if words[0] != "runs" or "export" in words else (0, 4)
        return [(kind, f"{where}: {told}") for kind, told in program.faults(end, expected=expected)]

    return [fault for found in side_by_side(ask, READERS) for fault in found]
