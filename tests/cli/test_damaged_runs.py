"""Damaged, manipulated and foreign runs are each checked, and never trusted."""

from __future__ import annotations

import json
import os
import shutil
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
import pytest

from ocp import load, store
from ocp.errors import DamagedRun
from reports.cli.app import main
from tests.resealed import having, reseal, seal_text

FLIPS, FEW = 400, 40


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Return a mapping from kind to a small run of it."""
    root = tmp_path_factory.mktemp("made")
    small, kept = ["-p", "N=3"], ["--quiet", "--out", str(root)]
    for line in (
        ["solve", "wall-1d", "--contact", "barrier", *small],
        [
            "continue",
            "wall-1d",
            "--contact",
            "barrier",
            *small,
            "--over",
            "mu",
            "--from",
            "0.1",
            "--to",
            "0.05",
            "--steps",
            "1",
        ],
        ["sweep", "wall-1d", "--contact", "barrier", *small, "--over", "m=1:2:2"],
        ["estimate", "heaviside", "-n", "100"],
        ["gradients", "two-balls", "--world", "closed-form", "-n", "20", "--refinements", "0"],
        ["train", "ball-throw", "-s", "samples=2", "-p", "horizon=3", "--iterations", "1"],
    ):
        assert main([*line, *kept]) == 0
    solved = store.load(next(root.glob("wall-1d/*")))
    told = {"argv": [], "record": {"params": {}}, "status": "done", "verdict": "All hold."}
    store.write_run(root, "A1", solved.data, {"kind": "figure", "claims": [], **told})
    return {entry.meta["kind"]: entry.path for entry in store.list_runs(root) if entry.meta}


KINDS = ("solve", "continue", "sweep", "estimate", "gradients", "train", "figure")


@pytest.mark.one_case_in(6)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["meta.json", "solution.nc"])
def test_every_flipped_bit_is_found(made: dict[str, Path], tmp_path: Path, kind: str, name: str) -> None:
    """Flipped bits are found also in checksums, in blanks, and in the case of digits and exponents."""
    run = shutil.copytree(made[kind], tmp_path / "run")
    content = (run / name).read_bytes()
    # Arrays of all kinds of runs are compared in the same way.
    count = FLIPS if name == "meta.json" or kind == "solve" else FEW
    chosen = np.random.default_rng(14).choice(8 * len(content), count, replace=False)
    for bit in map(int, chosen):
        changed = bytearray(content)
        changed[bit // 8] ^= 1 << bit % 8
        (run / name).write_bytes(changed)
        with pytest.raises(DamagedRun, match=name):
            store.load(run)
    (run / name).write_bytes(content)
    assert store.load(run).kind == kind


def test_every_byte_of_the_end_counts(made: dict[str, Path], tmp_path: Path) -> None:
    run = shutil.copytree(made["solve"], tmp_path / "run")
    content = (run / "meta.json").read_bytes()
    others = [content[:-1], content + b"\n", content + b" ", b"\n" + content, b"", content * 2]
    others += [content[:-i] + bytes([content[-i] ^ 0x20]) + content[len(content) - i + 1 :] for i in range(1, 100)]
    for changed in others:
        (run / "meta.json").write_bytes(changed)
        with pytest.raises(DamagedRun, match=r"meta\.json"):
            store.load(run)


def test_a_flipped_bit_is_found_before_the_library_reads(made: dict[str, Path], tmp_path: Path, monkeypatch) -> None:
    run = shutil.copytree(made["solve"], tmp_path / "run")
    content = bytearray((run / "solution.nc").read_bytes())
    content[8] ^= 1
    (run / "solution.nc").write_bytes(content)
    monkeypatch.setattr(netCDF4, "Dataset", lambda *_, **__: pytest.fail("it was read"))
    with pytest.raises(DamagedRun, match="does not match its checksum"):
        store.load(run)


def deep(run: Path) -> None:
    head = (run / "meta.json").read_bytes().partition(b',\n "checksum"')[0]
    seal_text(run, head + b', "z": ' + b"[" * 100_000 + b"]" * 100_000)


def too_large(name: str) -> Callable[[Path], None]:
    def harm(run: Path) -> None:
        os.truncate(run / name, 1 << 43)

    return harm


def other(name: str, make: Callable[[Path], object]) -> Callable[[Path], None]:
    def harm(run: Path) -> None:
        (run / name).unlink()
        make(run / name)

    return harm


def device(path: Path) -> None:
    try:
        os.mknod(path, stat.S_IFCHR | 0o600, os.makedev(1, 5))
    except PermissionError:
        pytest.skip("only root makes devices")


def claiming(run: Path) -> None:
    """Give a run a file of some thousand bytes that claims to contain eight terabytes."""
    file = run / "claims.nc"
    with netCDF4.Dataset(file, "w") as made:
        made.createDimension("n", 10**12)
        made.set_fill_off()
        made.createVariable("x", "f8", ("n",))
    content = file.read_bytes()
    file.unlink()
    reseal(run, having(), solution=content)


def resealed(**entries: object) -> Callable[[Path], None]:
    return lambda run: reseal(run, having(**entries))


def part_outside(run: Path) -> None:
    body = (run / "meta.json").read_bytes().partition(b',\n "checksum"')[0]
    seal_text(run, body.replace(b'"solution.nc":', b'"../../secret":'))


HARMS: dict[str, tuple[Callable[[Path], None], str]] = {
    "record is a text": (resealed(record="str"), "record is 'str', expected an object"),
    "parameters are a list": (resealed(record={"params": []}), "record.params"),
    "status word": (resealed(status="slved"), "status is 'slved', expected one of solved"),
    "status is a number": (resealed(status=1), "status is 1"),
    "tags": (resealed(tags="abc"), "tags is 'abc', expected a list"),
    "cost": (resealed(cost="low"), "cost is 'low', expected a number"),
    "time": (resealed(created="yesterday"), "created"),
    "time without zone": (resealed(created="2026-01-01T00:00:00"), "created"),
    "audit": (resealed(audit={"worst": 1}), "audit"),
    "stages": (resealed(stages=[{"label": 1}]), "stages[0]"),
    "deep JSON": (deep, "nested"),
    "huge description": (too_large("meta.json"), "at most"),
    "huge data": (too_large("solution.nc"), "at most"),
    "FIFO": (other("meta.json", os.mkfifo), "a FIFO"),
    "FIFO of data": (other("solution.nc", os.mkfifo), "a FIFO"),
    "link to a device": (other("meta.json", lambda p: p.symlink_to("/dev/zero")), "symbolic link"),
    "link to itself": (other("meta.json", lambda p: p.symlink_to(p)), "symbolic link"),
    "link out": (other("solution.nc", lambda p: p.symlink_to("/etc/passwd")), "symbolic link"),
    "device": (other("meta.json", device), "a device"),
    "directory": (other("meta.json", Path.mkdir), "a directory"),
    "part outside": (part_outside, "parts names '../../secret'"),
    "huge claim": (claiming, "claims 8000000000000 bytes"),
}


@pytest.mark.cheap_cases("parameters are a list")
@pytest.mark.parametrize("harm", HARMS)
def test_one_bad_run_is_one_bad_line(ocp, made: dict[str, Path], tmp_path: Path, harm: str) -> None:
    bad, good = (
        shutil.copytree(made["solve"], tmp_path / "runs" / "wall-1d" / name)
        for name in ("20260101T000000Z-aaaaaaaaaa", "20260101T000001Z-bbbbbbbbbb")
    )
    act, said = HARMS[harm]
    act(bad)
    for line in (
        "runs {}",
        "replay {}",
        "runs export {} -o a.csv",
        "report {} -o a.pdf",
        "figure {}",
        "export {} -o a.c",
        "animate {} -o a.gif",
        "solve wall-1d --from {}",
        "estimate wall-1d --at {}",
    ):
        done = ocp(*line.format(bad).split())
        assert done.code == 4 and done.err.count("\n") == 1, done.err
        assert said in done.err
    with pytest.raises(DamagedRun):
        load(bad)
    if harm != "huge claim":
        listed = ocp("runs")
        assert listed.code == 0 and listed.err == ""
        assert "aaaaaaaaaa  wall-1d  damaged" in listed.out and "bbbbbbbbbb" in listed.out
        rows = {row["run"]: row["status"] for row in ocp("runs", "--json").json["runs"]}
        assert list(rows.values()) == ["damaged", "solved"]
    assert ocp("replay", "@last", "-q").code == 0, good
    assert ocp("runs", "rm", str(bad)).code == (2 if harm == "directory" else 0)


@pytest.mark.costly
def test_no_text_of_a_run_is_obeyed(ocp, made: dict[str, Path], tmp_path: Path) -> None:
    """No text of a run controls a terminal, rich's markup, or the browser that shows a motion."""
    run = shutil.copytree(made["solve"], tmp_path / "runs" / "wall-1d" / "run")
    data = store.load(run).data
    loud = data.assign_coords(state=["\x1b[31mq", "</script>"])
    word = "\x1b]0;title\x07[/red]\x9b"
    record = {**json.loads((run / "meta.json").read_bytes())["record"], "solver": word}
    harm = having(verdict=f"{word}</script>", problem=word, record=record)
    reseal(run, harm, solution=bytes(loud.to_netcdf(engine="netcdf4")))
    found = store.load(run)
    assert list(found.data["state"].values) == ["\\x1b[31mq", "</script>"]
    assert found.record["solver"] == "\\x1b]0;title\\x07[/red]\\x9b"
    for line in ("runs", "runs @1", "runs export @1 -o a.csv", "replay @1"):
        done = ocp(*line.split())
        assert done.code in (0, 2) and not {"\x1b", "\x07", "\x9b"} & set(done.out + done.err), line
    assert "[/red]" in ocp("runs", "@1").out


ENTRIES = {
    "solve": ("record.params", "record.contact_settings", "stages"),
    "continue": ("record.params", "points", "from", "record.contact"),
    "sweep": ("study.axes", "record.params"),
    "estimate": ("estimates.0.reference", "record.params"),
    "gradients": ("worlds.0.findings", "worlds.0.secants", "parameter.unit", "record.theta"),
    "train": ("evaluation.length", "evaluation", "record.algorithm_settings", "record.discount"),
}


def lacking_entry(way: str) -> Callable[[dict[str, Any]], None]:
    *groups, last = [int(word) if word.isdigit() else word for word in way.split(".")]

    def harm(meta: Any) -> None:
        for key in groups:
            meta = meta[key]
        del meta[last]

    return harm


@pytest.mark.slow
@pytest.mark.parametrize("kind", ENTRIES)
def test_what_does_not_fit_together_is_no_internal_fault(ocp, made: dict[str, Path], tmp_path: Path, kind: str) -> None:
    """Missing parts and arrays of another run are reported, even if all checksums agree."""
    another = (made["figure" if kind != "solve" else "train"] / "solution.nc").read_bytes()
    harms = [(lacking_entry(way), {}) for way in ENTRIES[kind]]
    for harm, parts in [*harms, (having(), {"solution": another})]:
        run = shutil.copytree(made[kind], tmp_path / "run")
        reseal(run, harm, **parts)
        for line in ("runs {}", "replay {}", "runs export {} -o a.csv", "evaluate {}", "report {} -o a.pdf"):
            done = ocp(*line.format(run).split())
            assert done.code in (0, 2, 4) and "internal error" not in done.err, done.err
            assert "Traceback" not in done.err
        shutil.rmtree(run)


@pytest.mark.costly
def test_what_does_not_fit_together_is_told(ocp, made: dict[str, Path], tmp_path: Path) -> None:
    run = shutil.copytree(made["estimate"], tmp_path / "run")
    reseal(run, lacking_entry("estimates.0.reference"))
    done = ocp("report", str(run), "-o", "a.pdf")
    assert done.code == 4 and "is inconsistent (KeyError: 'reference')" in done.err
    assert ocp("report", str(made["estimate"]), "-o", "a.pdf", "--quiet").code == 0


def test_folders_that_are_none(ocp, made: dict[str, Path], tmp_path: Path, monkeypatch) -> None:
    runs = tmp_path / "runs"
    shutil.copytree(made["solve"], runs / "wall-1d" / "20260101T000000Z-aaaaaaaaaa")
    (runs / "wall-1d" / "loop").symlink_to(runs / "wall-1d" / "loop")
    (runs / "round").symlink_to(runs)
    (runs / "closed").mkdir()
    (runs / "wall-1d" / "empty").mkdir()
    os.mkfifo(runs / "wall-1d" / "fifo")
    scan = os.scandir

    def scandir(path: Path):
        if Path(path).name == "closed":
            raise PermissionError(13, "Permission denied", str(path))
        return scan(path)

    monkeypatch.setattr(os, "scandir", scandir)
    found = ocp("runs", "--json").json["runs"]
    told = {row["run"]: row["damage"] for row in found}
    assert told["runs/wall-1d/20260101T000000Z-aaaaaaaaaa"] is None
    assert "Permission denied" in told["runs/closed"]
    assert "meta.json cannot be read" in told["runs/wall-1d/empty"]
    assert told["runs/wall-1d/loop"] and "runs/wall-1d/fifo" not in told
    assert ocp("runs").code == 0


def test_a_run_that_is_a_link_is_not_removed(ocp, made: dict[str, Path], tmp_path: Path) -> None:
    kept = shutil.copytree(made["solve"], tmp_path / "kept")
    (tmp_path / "runs" / "wall-1d").mkdir(parents=True)
    (tmp_path / "runs" / "wall-1d" / "linked").symlink_to(kept)
    done = ocp("runs", "rm", "wall-1d/linked")
    assert done.code == 2 and "symbolic link" in done.err
    assert json.loads((kept / "meta.json").read_bytes())["kind"] == "solve"
