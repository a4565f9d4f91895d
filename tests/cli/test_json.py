"""With ``--json`` stdout has one document and nothing else, whatever libraries print."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from reports.cli import streams
from reports.cli.app import main

ROOT = Path(__file__).parents[2]
PROGRAM = [sys.executable, "-c", "import sys; from reports.cli.app import main; sys.exit(main())"]
LOUD = '''
"""A problem whose author prints wherever a program can."""
import atexit
import ctypes, os, sys
from problems.library.wall_1d import Params, build as quiet, equations, title

C = ctypes.CDLL(None)
name = "loud"
print("python at import")
os.write(1, b"descriptor at import\\n")
sys.__stdout__.write("kept stream at import\\n")
C.puts(b"compiled code, into a buffer that is written as the process ends")
atexit.register(lambda: (os.write(1, b"at exit\\n"), print("python at exit")))
atexit.register(C.puts, b"compiled code at exit")


def build(params):
    print("python in build")
    os.system("echo a child of build")
    return quiet(params)
'''


@pytest.mark.costly
@pytest.mark.parametrize("words", [("-s", "print_level=5"), ("--solver", "uno", "--quiet")])
def test_nothing_stands_beside_the_document(tmp_path: Path, words: tuple[str, ...]) -> None:
    (tmp_path / "loud.py").write_text(LOUD)
    done = subprocess.run(
        [*PROGRAM, "solve", "loud.py", "-p", "N=5", "--json", *words],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["problem"] == "wall-1d"
    assert ("This is Ipopt" in done.stderr) == ("print_level=5" in words)
    for said in (
        *("python at import", "descriptor at import", "kept stream at import", "compiled code, "),
        *("python in build", "a child of build", "at exit", "python at exit", "code at exit"),
    ):
        assert said in done.stderr, said


@pytest.mark.parametrize(
    ("ending", "code"),
    [
        ("__import__('signal').raise_signal(2)", 130),
        ("raise KeyboardInterrupt", 2),
        ("raise ValueError('no')", 2),
        ("raise OSError(5)", 2),
    ],
)
def test_a_command_that_ends_early_has_no_document_and_gives_stdout_back(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], ending: str, code: int
) -> None:
    file = tmp_path / "loud.py"
    text = "\n".join(line for line in LOUD.splitlines() if "atexit" not in line)
    file.write_text(text.replace("return quiet(params)", ending))
    before = sys.stdout
    assert main(["solve", str(file), "--json", "--out", str(tmp_path)]) == code
    told = capfd.readouterr()
    assert told.out == "" and "a child of build" in told.err
    os.write(1, b"after\n")
    print("as before")
    assert sys.stdout is before and capfd.readouterr().out == "after\nas before\n"


def test_stdout_is_reserved_once_and_a_replaced_one_takes_the_document(
    capsys: pytest.CaptureFixture[str],
) -> None:
    streams.redirect_stdout()
    streams.redirect_stdout()
    print("beside")
    print("the document", file=streams.document_stream())
    streams.restore_stdout()
    streams.restore_stdout()
    print("after")
    assert capsys.readouterr() == ("the document\nafter\n", "beside\n")
