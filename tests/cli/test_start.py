"""Ctrl-C at any time, and output that cannot be written, end the program with one sentence."""

from __future__ import annotations

import ast
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from reports.cli import interrupt
from reports.cli.app import main
from reports.cli.failures import explain

ROOT = Path(__file__).parents[2]
HEEDED = """
import _signal, os, sys
real = _signal.signal
def told(*given):
    before = real(*given)
    os.write(1, b".")
    return before
_signal.signal = told
from reports.cli.start import main
sys.argv[0] = "ocp"
sys.exit(main())
"""
"""Code that runs the program and prints a dot once its handler of Ctrl-C is installed."""


def start(*words: str, **given: object) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", HEEDED, *words],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **given,
    )


@pytest.mark.parametrize("seconds", [0.0, 0.1, 0.3])
def test_ctrl_c_while_the_program_is_still_imported(seconds: float, tmp_path: Path) -> None:
    process = start("solve", "half-cheetah", cwd=tmp_path)
    assert process.stdout is not None and process.stdout.read(1) == "."
    time.sleep(seconds)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    if process.returncode == 3:
        # On a busy computer the signal may come during the solve, whose best point is kept.
        assert "Interrupted: " in out
        return
    assert process.returncode == 130
    assert err.startswith("stopped by the user") and err.count("\n") == 1


def test_nothing_is_imported_before_ctrl_c_is_heeded() -> None:
    program = "import sys; old = {*sys.modules}; import reports.cli.start; print({*sys.modules} - old)"
    found = subprocess.check_output([sys.executable, "-c", program], cwd=ROOT, text=True)
    assert ast.literal_eval(found) == {"reports", "reports.cli", "reports.cli.start"}


def test_a_reader_that_goes_is_no_fault(capsys: pytest.CaptureFixture[str]) -> None:
    """Rich's consoles would turn a broken pipe into an exit of their own."""

    def broken() -> None:
        try:
            raise BrokenPipeError
        except BrokenPipeError:
            sys.exit(1)

    with pytest.raises(SystemExit) as caught:
        broken()
    assert explain(caught.value) == ("", 1)


@pytest.mark.costly
def test_closed_streams_get_no_file_of_ours(tmp_path: Path) -> None:
    """If descriptor 1 is closed, the next opened file would get it, and solvers would print into that file."""
    program = "import os; os.closerange(0, 3)\n" + HEEDED.replace('os.write(1, b".")', "pass")
    words = [
        sys.executable,
        "-c",
        program,
        "solve",
        "wall-1d",
        "--contact",
        "barrier",
        "-p",
        "N=2",
        "-s",
        "print_level=5",
    ]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    assert subprocess.run(words, cwd=tmp_path, env=environment, timeout=120).returncode == 0
    assert main(["runs", "--out", str(tmp_path / "runs"), "--json"]) == 0
    assert all(b"Ipopt" not in part.read_bytes() for part in tmp_path.rglob("*.*"))


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
@pytest.mark.parametrize("words", [["list"], ["--help"], ["show", "push-1d"], ["runs"], ["doctor"], ["settings"]])
def test_an_output_that_is_full_is_told(words, tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    with Path("/dev/full").open("w") as full:
        monkeypatch.setattr(sys, "stdout", full)
        assert main(words) == 1
    err = capsys.readouterr().err
    assert err.startswith("error: cannot write: No space left") and err.count("\n") == 1


def test_a_reader_that_went_away_is_no_fault(monkeypatch, capsys) -> None:
    ours, theirs = os.pipe()
    os.close(ours)
    with os.fdopen(theirs, "w") as pipe:
        monkeypatch.setattr(sys, "stdout", pipe)
        assert main(["list"]) == 1
    assert capsys.readouterr().err == ""


def test_an_interrupt_where_nothing_can_be_raised_is_raised_later(capsys) -> None:
    class Dying:
        def __del__(self) -> None:
            signal.raise_signal(signal.SIGINT)

    with interrupt.watch_interrupts():
        Dying()
        assert interrupt.was_interrupted()
        with pytest.raises(KeyboardInterrupt):
            interrupt.raise_if_interrupted()
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("raised", [SystemExit(0), GeneratorExit(), BaseException("odd")])
def test_whatever_is_raised_becomes_a_sentence(raised, monkeypatch, capsys) -> None:
    def fails(*_: object, **__: object) -> None:
        raise raised

    monkeypatch.setattr("typer.main.get_command", fails)
    assert main(["list"]) == 1
    assert capsys.readouterr().err.startswith("error: internal error")


def test_a_folder_that_is_gone_is_told(tmp_path: Path, monkeypatch, capsys) -> None:
    gone = tmp_path / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()
    assert main(["solve", "mine.py"]) == 2
    assert capsys.readouterr().err == ("error: the working directory no longer exists; change to another one\n")


def test_linear_algebra_has_one_thread_unless_the_user_sets_another_number() -> None:
    program = (
        "import os; from reports.cli import start;"
        " start._run = lambda: print(os.environ['OMP_NUM_THREADS'], os.environ['OPENBLAS_NUM_THREADS']) or 0;"
        " start.main()"
    )
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "3"}
    environment.pop("OMP_NUM_THREADS", None)
    printed = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True)
    assert printed.stdout.split() == ["1", "3"], printed.stderr
