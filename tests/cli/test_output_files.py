"""Every command that writes a file writes to a FIFO and never replaces it."""

from __future__ import annotations

import os
import stat
import threading
from pathlib import Path

import pytest

from reports.cli.app import main


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with one run and one file of transitions."""
    root = tmp_path_factory.mktemp("outputs")
    assert main(["solve", "push-1d", "--contact", "exact", "--quiet", "--out", f"{root}/runs"]) == 0
    collect = ["collect", "push-1d", "-n", "60", "-o", str(root / "data.nc"), "--quiet"]
    assert main(collect) == 0
    return root


WRITERS = {
    "a.pdf": "solve push-1d --contact exact --pdf",
    "a.png": "solve push-1d --contact exact --plot",
    "b.pdf": "report @last -o",
    "c.html": "animate @last -o",
    "c.gif": "animate @last --speed 50 -o",
    "d.c": "export push-1d -o",
    "e.csv": "runs export @last -o",
    "e.npz": "runs export @last -o",
    "f.nc": "collect push-1d -n 60 -o",
    "g.nc": "learn data.nc --model ewda -o",
}
BEGINS = {
    ".pdf": b"%PDF-",
    ".png": b"\x89PNG",
    ".html": b"<!doctype html>",
    ".gif": b"GIF8",
    ".c": b"/*",
    ".csv": b"scenario,node",
    ".npz": b"PK",
    ".nc": b"\x89HDF",
}


@pytest.mark.costly_cases("a.pdf")
@pytest.mark.one_case_in(5)
@pytest.mark.parametrize("name", WRITERS)
def test_a_fifo_gets_the_whole_file(
    folder: Path, name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(folder)
    monkeypatch.setenv("OCP_RUNS", "runs")
    fifo = Path(name)
    os.mkfifo(fifo)
    kept = {path.name for path in folder.iterdir()}
    got: list[bytes] = []
    reader = threading.Thread(target=lambda: got.append(fifo.read_bytes()), daemon=True)
    reader.start()
    assert main([*WRITERS[name].split(), name, "--quiet"]) == 0, capsys.readouterr().err
    reader.join(10)
    assert got[0].lower().startswith(BEGINS[fifo.suffix].lower()), got[0][:40]
    assert len(got[0]) > 500 and stat.S_ISFIFO(fifo.stat().st_mode)
    assert {path.name for path in folder.iterdir()} == kept
