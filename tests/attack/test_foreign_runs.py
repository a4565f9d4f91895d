"""Runs from strangers: folders with traps, and runs that name code, which must never be loaded."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from random import Random

import numpy as np
import pytest

from tests.attack import program
from tests.attack.test_flipped_bits import READERS
from tests.attack.works import KINDS, furnish, run_of
from tests.resealed import having, reseal

CANARY = 'from pathlib import Path\nPath({song!r}).write_text("sung")\n'
DEEP = 200_000
PATIENCE_S = 30.0
LIMITS = {"RLIMIT_AS": 8 << 30}
"""Memory limit of commands that read a trap, which must not fill the memory."""


@pytest.fixture(scope="module")
def shop(servers, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return furnish(servers[0], tmp_path_factory.mktemp("shop"))


def traps(directory: Path) -> dict[str, object]:
    """Return a mapping from name to a function that turns the run in ``directory`` into a trap for readers."""
    meta, data = directory / "meta.json", directory / "solution.nc"

    def instead(file: Path, make) -> None:
        file.unlink()
        make(file)

    def described(**changes: object) -> None:
        reseal(directory, having(**changes))

    def device(file: Path) -> None:
        if os.geteuid() == 0:
            os.mknod(file, 0o20666, os.makedev(1, 5))
        else:
            file.symlink_to("/dev/zero")

    harms: dict[str, object] = {
        "deep JSON": lambda: meta.write_text("[" * DEEP + "]" * DEEP),
        "deep objects": lambda: meta.write_text('{"schema":' * DEEP + "1" + "}" * DEEP),
        "deep JSON in a field": lambda: meta.write_text(
            meta.read_text().rstrip()[:-1] + ', "x": ' + "[" * DEEP + "]" * DEEP + "}"
        ),
        "a text for a record": lambda: described(record="str"),
        "a list for a record": lambda: described(record=[1]),
        "numbers for words": lambda: described(problem=1, kind=2, created=3, hash=4, tags=5),
        "a number as long as a book": lambda: meta.write_text('{"schema": ' + "9" * 100_000 + "}"),
        "no text": lambda: meta.write_bytes(bytes(range(256)) * 64),
        "words for numbers": lambda: described(cost="NaN", created="NaN", hash=None),
        "a giant": lambda: os.truncate(meta, 1 << 33),
        "giant arrays": lambda: os.truncate(data, 1 << 36),
        "terminal signs": lambda: described(problem="\x1b[2J\x1b]0;owned\x07", status="\x1b[31m"),
        "a folder for meta": lambda: instead(meta, Path.mkdir),
        "a folder for arrays": lambda: instead(data, Path.mkdir),
        "a locked file": lambda: meta.chmod(0),
        "a run within itself": lambda: instead(data, lambda file: file.symlink_to("..")),
        "a link to nowhere": lambda: instead(meta, lambda file: file.symlink_to("nowhere")),
        "a link to itself": lambda: instead(meta, lambda file: file.symlink_to("meta.json")),
    }
    for name, file in (("description", meta), ("arrays", data)):
        harms[f"a FIFO for {name}"] = lambda file=file: instead(file, os.mkfifo)
        harms[f"a device for {name}"] = lambda file=file: instead(file, device)
        harms[f"a link to a terminal for {name}"] = lambda file=file: instead(
            file, lambda link: link.symlink_to("/dev/stdin")
        )
    return harms


def test_one_bad_run_among_good_ones(shop, tally, side_by_side, dice: Random, tmp_path) -> None:
    account = tally(
        "One bad run harms no other: the rest is listed and read.",
        "runs of deep JSON, FIFOs, device nodes, links, giants and folders among good ones",
        30,
    )
    names = list(traps(run_of(shop / "runs", "solve")))

    def attack(server, name: str) -> None:
        here = shutil.copytree(shop, tmp_path / name.replace(" ", "-"))
        bad = run_of(here / "runs", "solve")
        good = [run_of(here / "runs", kind) for kind in KINDS if kind != "solve"]
        harm = traps(bad)[name]
        assert callable(harm)
        harm()
        listing = server.run(["runs", "--json"], here, patience=PATIENCE_S, limits=LIMITS)
        found = [(kind, f"{name}: {told}") for kind, told in program.faults(listing, expected=(0,))]
        found += [("lost run", f"{name}: {run.name} is not listed") for run in good if run.name not in listing.out]
        attempts = 1
        if name == "terminal signs" and "\x1b" in server.run(["runs"], here).out:
            found.append((name, "runs"))
        for words in dice.sample(READERS, 4):
            line = [str(bad) if word == "RUN" else word for word in words]
            end = server.run(line, here, patience=PATIENCE_S, limits=LIMITS)
            attempts += 1
            if end.code is None:
                found += program.faults(end)
                break
            quiet = (0, 4) if words[0] == "runs" else (4,)
            allowed = (0, 2, 4) if name == "a locked file" and os.geteuid() == 0 else quiet
            found += [(kind, f"{name}: {told}") for kind, told in program.faults(end, expected=allowed)]
        account.count(found, attempts)
        shutil.rmtree(here)

    side_by_side(attack, names)


def test_things_that_are_no_runs(shop, tally, side_by_side, tmp_path) -> None:
    account = tally(
        "One bad run harms no other: the rest is listed and read.",
        "links, FIFOs, devices and odd names inside the folder of runs",
        31,
    )
    here = shutil.copytree(shop, tmp_path / "here")
    runs = here / "runs"
    shelf = run_of(runs, "solve").parent
    (shelf / "20990101T000000Z-loop").symlink_to("..")
    (shelf / "20990101T000001Z-gone").symlink_to("nowhere")
    (shelf / "20990101T000002Z-root").symlink_to("/")
    (shelf / "20990101T000003Z-\n\x1b[31m").mkdir()
    (shelf / "20990101T000004Z-\udcff").mkdir()
    (runs / "up").symlink_to("..")
    (runs / "empty").mkdir()
    (runs / "file").write_text("no folder")
    os.mkfifo(runs / "fifo")
    os.mkfifo(shelf / "20990101T000005Z-fifo")
    lines = [
        ["runs"],
        ["runs", "--json"],
        ["runs", "--status", "damaged"],
        ["runs", "@last"],
        ["runs", "--since", "7d", "-v"],
        ["runs", "rm", "@last"],
        ["report", "@last", "-o", "o.pdf"],
    ]

    def attack(server, line: list[str]) -> None:
        end = server.run(line, here, patience=PATIENCE_S)
        found = program.faults(end)
        if "\x1b" in end.out + end.err:
            found.append(("terminal signs", end.line))
        if end.code == 0 and line[:2] == ["runs"] and run_of(shop / "runs", "train").name not in end.out:
            found.append(("lost run", end.line))
        account.count(found)

    side_by_side(attack, lines)
    assert Path("/etc").exists() and (shop / "runs").exists()


def test_runs_that_name_code(servers, shop, tally, side_by_side, tmp_path) -> None:
    account = tally(
        "No code runs that you did not name on the command line.",
        "received runs that name Python files, and files that lie about, for every reading command",
        40,
    )
    song, here = tmp_path / "song", tmp_path / "here"
    here.mkdir()
    problem = here / "prob.py"
    honest = (program.ROOT / "problems/library/wall_1d.py").read_text()
    problem.write_text(honest)
    end = servers[0].run(["solve", "prob.py", "-p", "N=4", "--quiet"], here)
    assert end.code == 0, end.err
    received = run_of(here / "runs", "solve")
    canary = CANARY.format(song=str(song)) + honest
    problem.write_text(canary)
    for name in ("casadi", "numpy", "problems", "xarray", "sitecustomize", "usercustomize"):
        (here / f"{name}.py").write_text(CANARY.format(song=str(song)))
    inside = received / "prob.py"
    places = [str(problem), "prob.py", str(inside), "../prob.py", "os", "problems.library.push_1d"]
    record = json.loads((received / "meta.json").read_bytes())["record"]

    def attack(server, item) -> None:
        at, place, words = item
        run = shutil.copytree(received, here / "received" / str(at) / received.name)
        (run / inside.name).write_text(canary)
        forged = {**record, "source": place, "problem": place}
        reseal(run, having(record=forged, source=place, problem=place))
        line = [str(run) if word == "RUN" else word for word in words]
        end = server.run(line, here, patience=PATIENCE_S)
        found = program.faults(end)
        if song.exists():
            found.append(("code run", f"{end.line} with source {place}"))
            song.unlink()
        account.count(found)

    pairs = [(place, words) for place in places for words in READERS]
    # Commands run one after the other, to know which one loaded the code.
    for at, (place, words) in enumerate(pairs):
        attack(servers[0], (at, place, words))
    (here / "prob.py").unlink()
    for words in (["list"], ["runs"], ["show", "push-1d"], ["doctor"], ["solve", "wall-1d", "-q"]):
        end = program.run(words, here)
        found = program.faults(end)
        if song.exists():
            found.append(("code run", f"{end.line} beside modules of well-known names"))
            song.unlink()
        account.count(found)


def test_pickles(servers, shop, tally, tmp_path) -> None:
    account = tally(
        "No code runs that you did not name on the command line.",
        "pickles in place of models, data, and checkpoints",
        41,
    )
    song = tmp_path / "song"

    class Singer:
        def __reduce__(self):
            return (os.system, (f"touch {song}",))

    here = shutil.copytree(shop, tmp_path / "here")
    evil = np.array([Singer()], dtype=object)
    np.save(here / "evil.npy", evil, allow_pickle=True)
    np.savez(here / "evil.npz", x=evil)
    for name in ("evil.nc", "evil.pkl"):
        (here / name).write_bytes((here / "evil.npy").read_bytes())
    assert not song.exists()
    for kind in ("heaviside", "ball-throw", "push-1d"):
        for place in (here / "runs" / kind).glob("*/"):
            shutil.copy(here / "evil.nc", place / "state.npz")
    lines = [
        *(
            ["solve", "push-1d", "--contact", law, "-c", f"model={file}"]
            for law in ("ewda", "mlp")
            for file in ("evil.npz", "evil.nc", "evil.pkl", "evil.npy")
        ),
        *(["learn", file, "--model", "ewda", "-o", "m.nc"] for file in ("evil.npz", "evil.nc")),
        *(["runs", "export", run_of(here / "runs", kind).name, "-o", "o.npz"] for kind in KINDS),
    ]
    for line in lines:
        end = servers[0].run(line, here, patience=PATIENCE_S)
        found = program.faults(end)
        if song.exists():
            found.append(("code run", end.line))
            song.unlink()
        account.count(found)
