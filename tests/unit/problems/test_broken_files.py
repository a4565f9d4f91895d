"""A user's file is used or rejected with one sentence, whatever it does."""

from __future__ import annotations

import os
import signal
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

import problems
from ocp.errors import InputError
from problems.user_code import guarded, user_code
from reports.cli.app import main
from tests.attack.broken_files import GOOD, Broken, every, particular, sample

REFUSED = [case for case in sample(len(every()), seed=14) if not case.works]
SOUND = [case for case in particular() if case.works]


def place(case: Broken, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    (folder / "broken.py").write_bytes(case.content)


@pytest.mark.one_case_in(6)
@pytest.mark.parametrize("case", REFUSED[:30], ids=lambda case: case.name)
def test_a_broken_file_is_refused_in_one_sentence(case, tmp_path, monkeypatch, capsys) -> None:
    place(case, tmp_path, monkeypatch)
    asked = ["collect", "broken.py", "-o", "data.nc"] if case.needs == "collect" else ["solve"]
    code = main(asked if case.needs == "collect" else [*asked, "broken.py"])
    out, err = capsys.readouterr()
    assert code == 2, err
    assert err.startswith("error: ") and err.count("\n") == 1 and len(err) < 1000, err
    assert "internal error" not in err and "Traceback" not in err
    assert all(sign.isprintable() for sign in err.rstrip("\n"))
    assert out == "" and not [*(tmp_path / "runs").rglob("*.json")]


@pytest.mark.one_case_in(11)
@pytest.mark.parametrize("case", SOUND, ids=lambda case: case.name)
def test_an_odd_file_that_is_sound_is_used(case, tmp_path, monkeypatch) -> None:
    place(case, tmp_path, monkeypatch)
    before = sys.stdout, sys.getrecursionlimit(), os.environ.copy()
    paths, trouble = set(sys.path), np.geterr()
    with warnings.catch_warnings(record=True):
        spec = problems.load("broken.py")
        problem = spec.problem()
    os.environ.update(before[2])
    assert (sys.stdout, sys.getrecursionlimit()) == before[:2]
    assert paths <= set(sys.path) and np.geterr() == trouble and Path.cwd() == tmp_path
    assert problem.system.nx == 2 and type(problem.N) is int
    assert np.array(problem.limits(problem.parameters.values)[0]).ravel().tolist() == [1, 0]


def test_what_a_function_returns_is_what_is_used(tmp_path: Path) -> None:
    """A valid file works everywhere, and its NumPy numbers become plain ones."""
    (tmp_path / "good.py").write_text(GOOD.replace("float(state[0])", "np.float32(state[0])"))
    spec = problems.load(tmp_path / "good.py")
    params, state = spec.params({}), np.array([0.5, 0.0])
    assert spec.draw is not None and spec.frames is not None
    wall, box = spec.draw(params, state)
    assert (type(wall).__name__, type(box).__name__) == ("Wall", "Rectangle")
    assert (box.x, type(box.x), spec.frames(params, state)[0].x) == (0.5, float, 0.5)
    with pytest.raises(InputError, match=r"draw\(params, state\) returned .* finite number"):
        spec.draw(params, np.array([np.nan, 0.0]))


def test_only_a_pressed_ctrl_c_goes_through(tmp_path: Path) -> None:
    file = tmp_path / "own.py"
    file.write_text(
        "import signal\ndef press(): signal.raise_signal(signal.SIGINT)\ndef claim(): raise KeyboardInterrupt\n"
    )
    module: dict = {}
    exec(compile(file.read_text(), str(file), "exec"), module)

    def handler(*_: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGINT, handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            guarded(module["press"], "press()", file)()
        with pytest.raises(InputError, match=r"claim\(\) failed: line 3: KeyboardInterrupt"):
            guarded(module["claim"], "claim()", file)()
    finally:
        signal.signal(signal.SIGINT, before)


def test_a_folder_left_for_good_is_no_fault(tmp_path: Path, monkeypatch) -> None:
    gone = tmp_path / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    with user_code("it failed:", tmp_path / "x.py"):
        os.chdir(tmp_path)
        gone.rmdir()
    assert Path.cwd() == tmp_path


@pytest.mark.parametrize("make", ["folder", "fifo", "device", "nothing"])
def test_what_is_no_file_is_refused(make: str, tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "broken.py"
    if make == "folder":
        file.mkdir()
    elif make == "fifo":
        os.mkfifo(file)
    elif make == "device":
        file.symlink_to("/dev/zero")
    assert main(["show", "broken.py"]) == 2
    err = capsys.readouterr().err
    words = {"folder": "is a directory", "nothing": "there is no such file"}
    assert words.get(make, "is not a regular file") in err and err.count("\n") == 1


@pytest.mark.parametrize("name", ["time", "json", "numpy", "xarray", "calendar"])
def test_a_file_beside_it_that_is_called_as_pythons_own_changes_nothing(name: str, tmp_path: Path) -> None:
    (tmp_path / f"{name}.py").write_text("x = 1\n")
    (tmp_path / "good.py").write_text(GOOD)
    loaded = sys.modules.get(name)
    assert problems.load(tmp_path / "good.py").problem().system.nx == 2
    assert sys.modules.get(name) is loaded
