"""Broken problem files are each rejected with one sentence and exit code 2."""

from __future__ import annotations

from random import Random

from tests.attack import program
from tests.attack.broken_files import Broken, sample

FILES = 150
PATIENCE_S = 60.0
BY_START = 20
"""Inverse share of the files that are tested by a run of the whole program."""
LINES = {
    "solve": ("solve", "broken.py", "--json"),
    "collect": ("collect", "broken.py", "--samples", "10", "-o", "data.nc"),
}


def test_broken_problem_files(tally, side_by_side, dice: Random, tmp_path) -> None:
    account = tally(
        "Bad input is answered by one sentence and exit code 2, never by a traceback.",
        f"{FILES} broken problem files: wrong types, NaN, raised exceptions, SystemExit, recursion, surrogates",
        80,
    )
    files = list(enumerate(sample(FILES, dice.randrange(1 << 30))))

    def attack(server, item: tuple[int, Broken]) -> None:
        at, broken = item
        here = tmp_path / str(at)
        here.mkdir()
        (here / "broken.py").write_bytes(broken.content)
        expected = (0, 2, 3) if broken.works else (2,)
        lines = [LINES[broken.needs]]
        if at % 5 == 0:
            lines.append(("show", "broken.py"))
        for line in lines:
            whole = at % BY_START == 0
            end = program.run(line, here) if whole else server.run(line, here, patience=PATIENCE_S)
            allowed = (0, *expected) if line[0] == "show" else expected
            found = program.faults(end, expected=allowed)
            if end.code == 2:
                found += [("long words", end.line)] * (len(end.err) > 4000)
                found += [("terminal signs", end.line)] * ("\x1b" in end.err)
                found += [("run of nonsense", end.line)] * any(here.glob("runs/*/*"))
            account.count([(kind, f"{broken.name}: {told}") for kind, told in found])

    side_by_side(attack, files)
