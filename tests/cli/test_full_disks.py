"""Stores, PDF files and disks that cannot be written are named before or instead of a stored run."""

from __future__ import annotations

import errno
import os
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.cli.test_bad_input import CONTINUE, SOLVE


@pytest.mark.parametrize("command", [SOLVE, (*CONTINUE, "--from", "1", "--to", "2")])
def test_an_unwritable_store_is_told_before_the_work(ocp, tmp_path: Path, command) -> None:
    (tmp_path / "taken").write_text("")
    done = ocp(*command, "--out", "taken")
    assert done.code == 2
    assert "cannot write" in done.err and "--out" in done.err
    assert "cost" not in done.err, "the solve must not have begun"


def test_an_unwritable_pdf_is_told_before_the_work(ocp, tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("")
    done = ocp(*SOLVE, "--pdf", "taken/x.pdf")
    assert done.code == 2
    assert "cannot write the PDF" in done.err
    assert not (tmp_path / "runs").is_dir() or not list((tmp_path / "runs").rglob("meta.json"))


def test_a_disk_that_fills_while_writing(ocp, tmp_path: Path, monkeypatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    done = ocp(*SOLVE)
    assert done.code == 1
    assert "disk is full" in done.err
    assert list((tmp_path / "runs" / "wall-1d").iterdir()) == []


def test_a_small_disk(ocp, tmp_path: Path) -> None:
    """A full disk is reported on a real file system of 64 kB, if this process may mount one."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = shutil.which("mount")
    made = mount and subprocess.run([mount, "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(disk)], capture_output=True)
    if not made or made.returncode != 0:
        pytest.skip("no file system can be mounted here")
    try:
        done = ocp(*SOLVE, "--out", str(disk))
        assert done.code == 1
        assert "disk is full" in done.err
        assert not [path for path in disk.rglob("*") if path.is_file()]
    finally:
        subprocess.run(["umount", str(disk)], check=True)
