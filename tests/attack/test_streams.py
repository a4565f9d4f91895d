"""Closed, full and narrow streams, a deleted directory, and an environment without a home."""

from __future__ import annotations

import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.attack import program
from tests.attack.works import furnish

LINES = (
    "list",
    "show push-1d",
    "runs",
    "runs @1",
    "settings laws",
    "settings",
    "doctor",
    "--help",
    "solve push-1d -p N=3",
    "solve push-1d -p N=3 --json",
    "solve nothing",
    "estimate heaviside -n 100 --json",
)
SHELLS = {
    "to a full device": "{} > /dev/full",
    "both to a full device": "{} > /dev/full 2>&1",
    "a closed stdout": "{} >&-",
    "a closed stderr": "{} 2>&-",
    "both closed": "{} >&- 2>&-",
    "everything closed": "{} <&- >&- 2>&-",
    "a reader that goes": "{} | head -c 1",
    "a folder that is gone": "mkdir gone && cd gone && rmdir ../gone && {}",
    "ASCII": "LC_ALL=C PYTHONUTF8=0 PYTHONCOERCECLOCALE=0 PYTHONIOENCODING=ascii {}",
    "a narrow terminal": "COLUMNS=1 {}",
    "a wide terminal": "COLUMNS=99999999 {}",
    "no home": "env -u HOME -u XDG_CACHE_HOME -u USER {}",
    "a home that is a file": "HOME=/dev/null XDG_CACHE_HOME=/dev/null/x {}",
    "a locale that is none": "LC_ALL=xx_YY.nothing LANG=nothing {}",
    "no temporary folder": "TMPDIR=/nothing TEMP=/nothing TMP=/nothing {}",
}

EVERY = ("to a full device", "a closed stdout", "ASCII", "both closed", "a reader that goes")
"""Names of the cases in which every command is run; in the others every fourth."""


@pytest.fixture(scope="module")
def shop(servers, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return furnish(servers[0], tmp_path_factory.mktemp("shop"))


@pytest.mark.parametrize("name", SHELLS)
def test_streams_and_places(shop, name: str, tally, side_by_side, tmp_path) -> None:
    account = tally(
        "A full, closed or narrow output is no fault of the program: one sentence at most.",
        f"{len(SHELLS)} kinds of streams and places, for commands that print",
        90,
    )

    def attack(_server, line: str) -> None:
        here = shutil.copytree(shop, tmp_path / line.replace(" ", "-"))
        words = line.split()
        call = shlex.join([*program.command(), *words])
        script = SHELLS[name].format(call)
        done = subprocess.run(
            ["bash", "-c", f"({script}); exit $?"],
            cwd=here,
            env=program.environment(),
            capture_output=True,
            text=True,
            errors="replace",
            timeout=program.PATIENCE_S,
        )
        end = program.Ended(words, done.returncode, done.stdout, done.stderr, 0.0)
        found = program.faults(end)
        if "closed" in name or name == "both to a full device":
            found = [fault for fault in found if fault[0] not in ("silent failure", "no sentence")]
        if name == "to a full device" and end.code == 0:
            found.append(("lost output", "it says all is well"))
        account.count([(kind, f"{name}: {told}") for kind, told in found])
        shutil.rmtree(here)

    place = list(SHELLS).index(name)
    side_by_side(attack, LINES if name in EVERY else LINES[place % 4 :: 4])
