"""A checkpoint belongs to one computation with fixed content, and one process at a time holds it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from ocp.store import checkpoint as module
from ocp.store.checkpoint import Checkpoint, SavedWork
from ocp.store.provenance import content_digest

ASKED = {"samples": 10}
HOLD = """
import sys, time
from pathlib import Path
from ocp.store.checkpoint import Checkpoint, SavedWork
with Checkpoint(Path(sys.argv[1]), "toy", {"samples": 10}) as held:
    held.save_rows(0, [{"mean": 1.0}])
    print(held.directory.name, flush=True)
    time.sleep(60)
"""


def directories(root: Path) -> list[str]:
    return sorted(path.name for path in root.glob("toy/.unfinished-*"))


def test_what_was_done_is_there_again(tmp_path: Path) -> None:
    with Checkpoint(tmp_path, "toy", ASKED) as first:
        assert first.rows(0) is None and first.state("sums") is None
        first.save_rows(0, [{"mean": 1.0}])
        first.save_state("sums", total=np.arange(3.0))
    with Checkpoint(tmp_path, "toy", ASKED) as again:
        assert again.rows(0) == [{"mean": 1.0}] and not again.notes
        found = again.state("sums")
        assert found is not None and found["total"].tolist() == [0.0, 1.0, 2.0]
        again.discard()
    assert directories(tmp_path) == []


def test_nothing_stays_of_what_did_nothing(tmp_path: Path) -> None:
    with Checkpoint(tmp_path, "toy", ASKED):
        assert len(directories(tmp_path)) == 1
    assert directories(tmp_path) == []
    with Checkpoint(None, "toy", ASKED) as nowhere:
        nowhere.save_rows(0, [])
        assert nowhere.rows(0) is None and nowhere.directory is None
    assert not list(Path().glob(".unfinished-*"))


def test_a_checkpoint_that_is_not_held_is_not_used(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="inside a 'with' block"):
        Checkpoint(tmp_path, "toy", ASKED).save_rows(0, [])
    with Checkpoint(tmp_path, "toy", ASKED) as held:
        pass
    with pytest.raises(RuntimeError, match="inside a 'with' block"):
        held.rows(0)


def test_two_at_once_have_places_of_their_own(tmp_path: Path) -> None:
    first, second = (Checkpoint(tmp_path, "toy", ASKED) for _ in range(2))
    with first:
        first.save_rows(0, [{"of": "first"}])
        with second:
            assert second.rows(0) is None
            assert second.notes == [
                "another process runs the same computation; this one runs independently and gives the same numbers"
            ]
            second.save_rows(0, [{"of": "second"}])
            second.discard()
        assert first.rows(0) == [{"of": "first"}]
        # In the other order, the first to begin ends first.
        with Checkpoint(tmp_path, "toy", ASKED) as third:
            third.save_rows(0, [{"of": "third"}])
            first.discard()
            assert third.rows(0) == [{"of": "third"}]
    # The rows of the third are found, although the folder before it is free.
    with Checkpoint(tmp_path, "toy", ASKED) as fourth:
        assert fourth.rows(0) == [{"of": "third"}]


@pytest.mark.costly
def test_what_a_killed_process_left_is_taken_over(tmp_path: Path) -> None:
    command = [sys.executable, "-c", HOLD, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        name = process.stdout.readline().strip()
        with Checkpoint(tmp_path, "toy", ASKED) as beside:
            assert beside.notes and beside.rows(0) is None
        assert directories(tmp_path) == [name]
        process.send_signal(signal.SIGKILL)
    with Checkpoint(tmp_path, "toy", ASKED) as after:
        assert after.directory is not None and after.directory.name == name
        assert after.rows(0) == [{"mean": 1.0}] and not after.notes


def test_a_place_that_vanishes_while_it_is_entered_is_not_held(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The owner removes the folder after another process opens its lock file and before that locks it."""
    with Checkpoint(tmp_path, "toy", ASKED) as owner:
        assert owner.directory is not None
        directory = owner.directory

    def removing(handle: int, how: int) -> None:
        monkeypatch.undo()
        (directory / ".lock").unlink()
        directory.rmdir()
        module.fcntl.flock(handle, how)

    directory.mkdir()
    monkeypatch.setattr(module.fcntl, "flock", removing)
    with Checkpoint(tmp_path, "toy", ASKED) as entered:
        entered.save_rows(0, [{"mean": 1.0}])
        assert entered.directory is not None and (entered.directory / ".lock").exists()
        with Checkpoint(tmp_path, "toy", ASKED) as other:
            assert other.directory != entered.directory


@pytest.mark.parametrize("changed", ["source", "program_digest", "compiler_identity"])
def test_another_content_starts_anew_and_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, changed: str) -> None:
    with Checkpoint(tmp_path, "toy", ASKED, "a" * 64) as before:
        before.save_rows(0, [{"mean": 1.0}])
    if changed != "source":
        monkeypatch.setattr(module, changed, lambda: "another")
    source = "b" * 64 if changed == "source" else "a" * 64
    with Checkpoint(tmp_path, "toy", ASKED, source) as after:
        assert after.rows(0) is None
        (note,) = after.notes
        assert ("file, or what it imports, has changed" in note) == (changed == "source")
        assert "starting again; earlier results are in" in note
        assert ".unfinished-" in note
    # Other settings are another computation, so that there is no note.
    with Checkpoint(tmp_path, "toy", {"samples": 11}, source) as other:
        assert other.rows(0) is None and not other.notes


def test_a_worker_writes_where_its_owner_holds(tmp_path: Path) -> None:
    with Checkpoint(tmp_path, "toy", ASKED) as owner:
        SavedWork(owner.directory).save_state("sums", total=np.ones(2))
        found = owner.state("sums")
        assert found is not None and found["total"].tolist() == [1.0, 1.0]


def test_the_content_is_of_all_files_that_are_named(tmp_path: Path) -> None:
    model = tmp_path / "model.nc"
    model.write_text("one")
    settings = {"model": str(model), "sigma": 0.1, "mode": "x" * 5000}
    one = content_digest([], settings)
    assert content_digest([], {**settings, "sigma": 0.2}) == one
    assert content_digest(["digest"], settings) != one
    model.write_text("two")
    assert content_digest([], settings) != one
    assert content_digest([], {"sigma": 0.1}) == ""


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_place_that_cannot_be_made_gets_its_sentence(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with (
        pytest.raises(ValueError, match="cannot write the checkpoint"),
        Checkpoint(tmp_path, "toy", ASKED),
    ):
        pass
