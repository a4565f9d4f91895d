"""Output files: a regular file is replaced atomically, other kinds are written to or rejected."""

from __future__ import annotations

import os
import re
import socket
import stat
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from ocp.errors import InputError
from ocp.store import atomic


def read_in_background(fifo: Path) -> tuple[threading.Thread, list[bytes]]:
    """Start a reader of a FIFO; return its thread and the list that gets the bytes read."""
    got: list[bytes] = []
    reader = threading.Thread(target=lambda: got.append(fifo.read_bytes()), daemon=True)
    reader.start()
    return reader, got


def test_a_fifo_is_written_to_and_never_replaced(tmp_path: Path) -> None:
    fifo, link = tmp_path / "pipe.pdf", tmp_path / "link.pdf"
    os.mkfifo(fifo)
    link.symlink_to(fifo)
    before = fifo.stat()
    for place in (fifo, link):
        reader, got = read_in_background(fifo)
        atomic.write_file(place, b"content")
        reader.join(10)
        assert got == [b"content"]
    after = fifo.stat()
    assert (after.st_ino, after.st_mode) == (before.st_ino, before.st_mode)
    assert sorted(tmp_path.iterdir()) == [link, fifo] and link.is_symlink()


def test_a_fifo_gets_nothing_of_a_draft_that_failed(tmp_path: Path) -> None:
    fifo = tmp_path / "pipe.pdf"
    os.mkfifo(fifo)
    with pytest.raises(ValueError, match="half"), atomic.replace_file(fifo) as draft:
        draft.write_bytes(b"half")
        raise ValueError("half")
    reader, got = read_in_background(fifo)
    atomic.write_file(fifo, b"whole")
    reader.join(10)
    assert got == [b"whole"]


@pytest.mark.skipif(os.geteuid() != 0, reason="only root makes devices")
def test_a_device_is_written_to_and_a_disk_is_refused(tmp_path: Path) -> None:
    null, full, disk = tmp_path / "null", tmp_path / "full", tmp_path / "disk"
    try:
        os.mknod(null, 0o666 | stat.S_IFCHR, os.makedev(1, 3))
        os.mknod(full, 0o666 | stat.S_IFCHR, os.makedev(1, 7))
        # No driver has this number, so that no disk can be damaged.
        os.mknod(disk, 0o600 | stat.S_IFBLK, os.makedev(511, 1))
        null.write_bytes(b"")
    except OSError as error:
        pytest.skip(f"no devices here: {error}")
    real = Path(os.devnull).stat()
    before = null.stat()
    atomic.write_file(null, b"content")
    assert (null.stat().st_ino, null.stat().st_rdev) == (before.st_ino, os.makedev(1, 3))
    with pytest.raises(InputError, match="disk is full"):
        atomic.write_file(full, b"content")
    with pytest.raises(InputError, match="it is a disk"):
        atomic.write_file(disk, b"content")
    assert stat.S_ISCHR(full.stat().st_mode) and stat.S_ISBLK(disk.stat().st_mode)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["disk", "full", "null"]
    now = Path(os.devnull).stat()
    assert (now.st_ino, now.st_rdev, now.st_mode) == (real.st_ino, real.st_rdev, real.st_mode)


def test_a_link_stays_and_what_it_points_to_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "far").mkdir()
    target, link, later = tmp_path / "far/target.nc", tmp_path / "link.nc", tmp_path / "later.nc"
    target.write_bytes(b"old")
    target.chmod(0o640)
    link.symlink_to("far/target.nc")
    later.symlink_to("far/not_yet.nc")
    atomic.write_file(link, b"new")
    atomic.write_file(later, b"first")
    assert link.is_symlink() and target.read_bytes() == b"new"
    assert stat.S_IMODE(target.stat().st_mode) == 0o640
    assert later.is_symlink() and (tmp_path / "far/not_yet.nc").read_bytes() == b"first"


def test_what_is_no_file_is_refused(tmp_path: Path) -> None:
    circle = tmp_path / "circle"
    circle.symlink_to(circle)
    with pytest.raises(InputError, match="levels of symbolic links"):
        atomic.write_file(circle, b"content")
    with pytest.raises(InputError, match="it is a directory"):
        atomic.write_file(tmp_path, b"content")
    with socket.socket(socket.AF_UNIX) as bound:
        bound.bind(str(tmp_path / "socket"))
        with pytest.raises(InputError, match="it is no file"):
            atomic.write_file(tmp_path / "socket", b"content")
    assert circle.is_symlink() and (tmp_path / "socket").is_socket()


@pytest.mark.costly
def test_an_open_file_is_written_to(tmp_path: Path) -> None:
    """``/dev/stdout`` is written to, both in a pipe and if standard output is a file."""
    code = "from pathlib import Path; from ocp.store import atomic; atomic.write_file(Path('{}'), b'x')"
    for place in ("/dev/stdout", "/proc/self/fd/1"):
        command = [sys.executable, "-c", code.format(place)]
        assert subprocess.run(command, stdout=subprocess.PIPE, check=True).stdout == b"x"
    with (tmp_path / "out").open("wb") as out:
        before = os.fstat(out.fileno()).st_ino
        subprocess.run([sys.executable, "-c", code.format("/dev/stdout")], stdout=out, check=True)
    assert (tmp_path / "out").read_bytes() == b"x" and (tmp_path / "out").stat().st_ino == before


def test_nobody_else_opens_a_file_to_write() -> None:
    """Other modules write only drafts: of runs, of films and their frames, and of input for typst."""
    opened = r"(?<!devnull\).)(?<!fd)open\([^)]*[\"'][wax]"
    by_hand = re.compile(rf"write_(text|bytes)\(|savefig\(|{opened}")
    root = Path(atomic.__file__).parents[2]
    found = {
        str(file.relative_to(root))
        for folder in ("ocp", "problems", "reports", "docs/generator")
        for file in (root / folder).rglob("*.py")
        if by_hand.search(file.read_text())
    }
    into_memory = {"reports/drawing/style.py", "reports/figures/paper.py", "docs/generator/measured.py"}
    drafts = {
        "ocp/store/atomic.py",
        "ocp/store/runs.py",
        "reports/motion/movie.py",
        "docs/generator/readme_pictures.py",
        "reports/documents/pdf.py",
    }
    assert found == drafts | into_memory
