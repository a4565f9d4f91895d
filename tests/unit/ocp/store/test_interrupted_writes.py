"""Files that cannot be written, or whose writing is interrupted, leave no half run."""

from __future__ import annotations

import errno
import os
import re
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from ocp import store
from ocp.errors import InputError
from ocp.store import atomic, lookup
from tests.unit.ocp.store.test_store import solution


@pytest.mark.parametrize("call", [store.check_writable, lambda r: store.save(solution(), r, []).path])
def test_a_root_that_is_a_file_is_refused(tmp_path: Path, call) -> None:
    root = tmp_path / "runs"
    root.write_text("")
    with pytest.raises(InputError, match="--out"):
        call(root)


@pytest.mark.parametrize("fails", ["fsync", "rename"])
def test_a_full_disk_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fails: str) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(*((os, "fsync") if fails == "fsync" else (Path, "rename")), full)
    with pytest.raises(InputError, match="disk is full"):
        store.save(solution(), tmp_path, [])
    assert list((tmp_path / "toy").iterdir()) == []


KILLED_WHILE_WRITING = textwrap.dedent(
    """
    import sys, time
    import xarray as xr
    from pathlib import Path
    from ocp.store import runs as store
    def hang(*_):
        print("writing", flush=True)
        time.sleep(60)
    store.sync_to_disk = hang
    store.write_run(Path(sys.argv[1]), "toy", xr.Dataset({"a": ("n", [1.0])}), {"kind": "continue"})
    """
)


@pytest.mark.costly
def test_kill_leaves_no_half_run_and_the_next_save_sweeps(tmp_path: Path) -> None:
    command = [sys.executable, "-c", KILLED_WHILE_WRITING, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "writing\n"
        store.save(solution(), tmp_path, [])
        living = [p for p in (tmp_path / "toy").iterdir() if p.name.startswith(".")]
        assert len(living) == 1, "a save must not sweep what a living process is writing"
        process.send_signal(signal.SIGKILL)
    assert living[0].exists()
    assert len(store.list_runs(tmp_path)) == 1, "a half run must not be listed"
    store.save(solution(), tmp_path, [])
    assert not living[0].exists()
    assert len(store.list_runs(tmp_path)) == 2


def test_a_removal_cut_short_leaves_no_half_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = store.save(solution(), tmp_path, []).path

    def killed(place: Path) -> None:
        (place / "meta.json").unlink()
        raise KeyboardInterrupt

    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(atomic.shutil, "rmtree", killed)
        lookup.remove_runs([path])
    assert store.list_runs(tmp_path) == []
    store.save(solution(), tmp_path, [])
    assert not [child for child in path.parent.iterdir() if child.name.startswith(".")]


@pytest.mark.parametrize("ending", [KeyboardInterrupt, ValueError])
def test_a_file_is_replaced_whole_or_not_at_all(tmp_path: Path, ending: type) -> None:
    file = tmp_path / "figure.pdf"
    atomic.write_file(file, b"old")
    with pytest.raises(ending), atomic.replace_file(file) as draft:
        draft.write_bytes(b"half")
        raise ending
    assert file.read_bytes() == b"old"
    atomic.write_file(file, b"new")
    assert file.read_bytes() == b"new"
    assert [path.name for path in tmp_path.iterdir()] == ["figure.pdf"]


def test_only_one_module_renames_into_place() -> None:
    """In ocp, problems and reports no other module moves files; dynamics has its own cache."""
    root = Path(store.__file__).parents[2]
    moves = r"(replace|rename)"
    by_hand = re.compile(rf"mkstemp|mkdtemp|os\.{moves}\(|[a-z)]\.{moves}\([a-z_]+\)")
    found = {
        str(file.relative_to(root))
        for package in ("ocp", "problems", "reports")
        for file in (root / package).rglob("*.py")
        if by_hand.search(file.read_text())
    }
    assert found == {"ocp/store/atomic.py", "ocp/store/runs.py"}
