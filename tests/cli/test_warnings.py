"""No warning of a library reaches the terminal, and with ``-q`` no warning at all."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

from dynamics.batch.arguments import BatchWarning
from reports.cli.streams import libraries_silenced


@pytest.mark.parametrize("quiet", [False, True])
def test_ours_are_one_line_and_the_others_nothing(quiet: bool, capsys: pytest.CaptureFixture[str]) -> None:
    with libraries_silenced(quiet), warnings.catch_warnings():
        warnings.simplefilter("always")
        for _ in range(2):
            warnings.warn("the rollout runs on numpy", BatchWarning, stacklevel=1)
            warnings.warn("identical low and high ylims", UserWarning, stacklevel=1)
        logging.getLogger("somebody.else").warning("mkdir -p failed")
    told = capsys.readouterr()
    assert told.err == ("" if quiet else "warning: the rollout runs on numpy\n")
    assert told.out == ""


@pytest.mark.costly
def test_without_compiler_and_home(tmp_path: Path) -> None:
    ocp = Path(sys.executable).with_name("ocp")
    kept = {name: os.environ[name] for name in ("PYTHONPATH",) if name in os.environ}
    bare = {**kept, "PATH": str(tmp_path), "HOME": str(tmp_path / "file" / "home")}
    (tmp_path / "file").write_text("not a folder")
    done = subprocess.run(
        [ocp, "estimate", "push-1d", "-n", "50", "-q", "--pdf", "a.pdf"],
        cwd=tmp_path,
        env=bare,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "a.pdf").exists()
    for line in done.stderr.splitlines():
        assert line.startswith(("run:", "PDF:", "zobg")), line


@pytest.mark.costly
def test_a_file_with_an_accent_is_written_in_an_ascii_locale(tmp_path: Path) -> None:
    ocp = Path(sys.executable).with_name("ocp")
    ascii_only = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    done = subprocess.run(
        [ocp, "solve", "wall-1d", "--contact", "barrier", "--plot", "é.pdf", "-q"],
        cwd=tmp_path,
        env={**os.environ, **ascii_only},
        capture_output=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "é.pdf").exists()
