"""Many programs at the same time, with the same and with different jobs, in one store."""

from __future__ import annotations

import subprocess
from collections import Counter
from pathlib import Path

from ocp import store
from tests.attack import program
from tests.attack.works import MAKING, harm_to, hashes, leftovers

AT_ONCE = 80


def all_at_once(lines: list[list[str]], place: Path, env: dict[str, str] | None = None) -> list[program.Ended]:
    """Start all command lines at the same time, wait for all, and return how they ended."""
    files = [(place / f".out-{k}", place / f".err-{k}") for k in range(len(lines))]
    started: list[subprocess.Popen[bytes]] = []
    for line, (out, err) in zip(lines, files, strict=True):
        with out.open("wb") as to_out, err.open("wb") as to_err:
            started.append(program.start(line, place, stdout=to_out, stderr=to_err, env=env))
    ends = []
    for process, line, (out, err) in zip(started, lines, files, strict=True):
        end = program.ended(process, line)
        ends.append(program.Ended(line, end.code, out.read_text(), err.read_text("utf-8", "replace"), 0.0))
    return ends


def test_eighty_at_once(tally, tmp_path) -> None:
    account = tally(
        "Any number of programs may share a store; same question, same answer to the last bit.",
        f"{AT_ONCE} solves started at once, half of them the same",
        70,
    )
    same = ["solve", "push-1d", "-p", "N=3", "--quiet"]
    others = [["solve", "push-1d", "-p", "N=3", "-p", f"M={1 + k / 100}", "-q"] for k in range(39)]
    ends = all_at_once([same, *others] + [same] * (AT_ONCE - 40), tmp_path)
    found = [fault for end in ends for fault in program.faults(end, expected=(0,))]
    found += harm_to(tmp_path / "runs", {}, "eighty at once")
    known = Counter(hashes(tmp_path / "runs"))
    if sum(known.values()) != AT_ONCE:
        found.append(("lost run", f"{sum(known.values())} of {AT_ONCE} are there"))
    if max(known.values(), default=0) < AT_ONCE - 39:
        found.append(("altered run", f"the same command gave {len(known) - 39} answers"))
    found += [("leftover", left) for left in leftovers(tmp_path)]
    account.count(found, AT_ONCE)


def test_the_same_study_at_once(tally, tmp_path) -> None:
    account = tally(
        "Any number of programs may share a store; same question, same answer to the last bit.",
        "identical estimates, sweeps and trainings at once, beside listings and removals",
        71,
    )
    studies = [list(work.arguments) for work in MAKING if work.name in ("estimate", "sweep", "train")]
    lines = [line for line in studies for _ in range(5)] + [["runs", "--json"]] * 4
    ends = all_at_once(lines, tmp_path)
    found = [fault for end in ends for fault in program.faults(end, expected=(0,))]
    found += harm_to(tmp_path / "runs", {}, "studies at once")
    kinds: dict[str, set[str]] = {}
    for entry in store.list_runs(tmp_path / "runs"):
        meta = entry.meta or {}
        kinds.setdefault(meta.get("kind", "damaged"), set()).add(meta.get("hash", "damaged"))
    found += [
        ("altered run", f"the same {kind} gave {len(known)} answers") for kind, known in kinds.items() if len(known) > 1
    ]
    stored = sum(len(list(shelf.glob("2*"))) for shelf in (tmp_path / "runs").iterdir())
    if stored != 15:
        found.append(("lost run", f"{stored} of 15 are there"))
    found += [("leftover", left) for left in leftovers(tmp_path)]
    found += [("leftover", str(left)) for left in (tmp_path / "runs").rglob(".unfinished-*")]
    account.count(found, len(lines))


def test_a_cache_that_is_cleared_meanwhile(tally, tmp_path) -> None:
    account = tally(
        "Any number of programs may share a store; same question, same answer to the last bit.",
        "doctor --clear-cache again and again while estimates compile",
        72,
    )
    lines = []
    for k in range(6):
        estimate = ["estimate", "push-1d", "-p", f"N={2 + k}", "-n", "200", "--backend", "c", "-q"]
        lines.append(estimate)
        lines.append(["doctor", "--clear-cache", "--quiet"])
    lines += [["doctor", "--clear-cache", "--quiet"]] * 4
    env = program.environment(XDG_CACHE_HOME=str(tmp_path / "cache"))
    ends = all_at_once(lines, tmp_path, env=env)
    found = [fault for end in ends for fault in program.faults(end, expected=(0,))]
    found += harm_to(tmp_path / "runs", {}, "a cache that is cleared")
    account.count(found, len(lines))


def test_removals_at_once(tally, tmp_path) -> None:
    account = tally(
        "Any number of programs may share a store; same question, same answer to the last bit.",
        "removals of the same runs at once, beside listings and new runs",
        73,
    )
    for k in range(3):
        program.run(["solve", "push-1d", "-p", f"N={2 + k}", "-q"], tmp_path)
    names = [entry.path.name for entry in store.list_runs(tmp_path / "runs")]
    lines = [["runs", "rm", name, "-q"] for name in names for _ in range(4)]
    lines += [["runs"], ["runs", "--json"], ["solve", "push-1d", "-p", "N=6", "-q"]] * 3
    ends = all_at_once(lines, tmp_path)
    found = [fault for end in ends for fault in program.faults(end, expected=(0, 2))]
    found += harm_to(tmp_path / "runs", {}, "removals at once")
    if len(set(hashes(tmp_path / "runs"))) != 1:
        found.append(("lost run", "the run that nobody removed, or one that was removed twice"))
    account.count(found, len(lines))
