"""The program as a whole: version, help, output of -v, shell completion, and encodings."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

from reports.cli import app, streams
from reports.cli.app import load_commands, main

ROOT = Path(__file__).parents[2]
PROGRAM = [sys.executable, "-c", "import sys; from reports.cli.app import main; sys.exit(main())"]
COMMANDS = load_commands()


def run_as(directory: Path, *arguments: str, **environment: str) -> subprocess.CompletedProcess:
    """Run the program in its own process and return the completed process."""
    return subprocess.run(
        [*PROGRAM, *arguments],
        cwd=directory,
        capture_output=True,
        check=False,
        env={**os.environ, "PYTHONPATH": str(ROOT), **environment},
    )


def test_the_version_is_that_of_what_is_installed(ocp) -> None:
    done = ocp("--version")
    assert (done.code, done.out.strip()) == (0, f"centralpath {version('centralpath')}")


@pytest.mark.costly_cases("estimate")
@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_every_help_is_whole_and_shows_examples(ocp, name: str) -> None:
    short, long = ocp(*name.split(), "-h"), ocp(*name.split(), "--help")
    assert short.code == 0 and short.out == long.out
    told = " ".join(long.out.split())
    assert " ".join((COMMANDS[name].help or "").split()) in told, "no sentence is cut"
    assert "Examples:" in long.out and f"  ocp {name}" in long.out
    assert max(map(len, long.out.split("Settings")[0].splitlines())) <= 80


def test_the_list_of_commands_is_whole(ocp) -> None:
    told = ocp("--help").out
    assert "..." not in told.partition("Commands:")[2]
    for command in COMMANDS.values():
        assert " ".join((command.help or "").split("\n\n")[0].split()) in " ".join(told.split())


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_examples_are_understood(ocp, name: str, monkeypatch) -> None:
    """Every example passes the parser, so that its options exist and its numbers are in range."""
    seen = []
    monkeypatch.setattr(app, "execute", lambda *given: seen.append(given) or 0)
    for line in COMMANDS[name].declared.examples:
        done = ocp(*line.split())
        assert (done.code, done.err) == (0, ""), line
    assert len(seen) == len(COMMANDS[name].declared.examples) > 0


@pytest.mark.costly
def test_stages_are_logged_at_info_and_solvers_at_debug(ocp, caplog) -> None:
    silent = ocp("solve", "wall-1d", "--contact", "barrier", "-q")
    assert silent.err == "" and "ocp.routes" not in silent.out
    told = ocp("solve", "wall-1d", "--contact", "barrier", "-q", "-v").err
    assert "ocp.routes.homotopy: " in told and "ocp.routes.session: " in told
    assert "ocp.programs.solver" not in told
    assert "ocp.programs.solver: ipopt" in ocp("solve", "wall-1d", "--contact", "barrier", "-q", "-vv").err
    assert ocp("solve", "wall-1d", "--contact", "barrier", "-q").err == "", "what was asked for once is not kept"


def test_logging_is_pythons_own(caplog) -> None:
    """In Python each stage of a solve logs one line, by loggers named after modules."""
    from dynamics.contact import Barrier
    from ocp import solve
    from problems import get

    with caplog.at_level(logging.INFO, logger="ocp"):
        found = solve(get("wall-1d"), Barrier(mu=1e-3))
    stages = [record for record in caplog.records if record.name == "ocp.routes.homotopy"]
    assert len(stages) == len(found.stages)
    assert all(record.levelno == logging.INFO for record in stages)
    for record, stage in zip(stages, found.stages, strict=True):
        assert f"{stage.iterations} it" in record.getMessage()
    assert any(record.name == "ocp.routes.session" for record in caplog.records), "what was built"


def test_levels_are_set_back(capsys) -> None:
    loggers = [logging.getLogger(name) for name in streams.PACKAGES]
    before = [(logger.level, list(logger.handlers)) for logger in loggers]
    with streams.log_to_stderr(2):
        logging.getLogger("ocp.anything").debug("heard %s", "once")
    assert "ocp.anything: heard once" in capsys.readouterr().err
    assert [(logger.level, logger.handlers) for logger in loggers] == before


@pytest.mark.costly
@pytest.mark.parametrize("encoding", ["cp1252", "ascii", "utf-8"])
def test_output_in_every_encoding(tmp_path: Path, encoding: str) -> None:
    """The sign of complementarity, which cp1252 lacks, does not end the program."""
    done = run_as(tmp_path, "settings", "laws", PYTHONIOENCODING=encoding, PYTHONUTF8="0", LC_ALL="C")
    assert done.returncode == 0, done.stderr
    sign = "⟂" if encoding == "utf-8" else "_|_"
    assert f"0 <= lam {sign} gap" in done.stdout.decode(encoding)


@pytest.mark.costly
@pytest.mark.parametrize("encoding", ["cp1252", "ascii"])
def test_a_solve_in_another_encoding_is_stored_all_the_same(tmp_path, encoding: str) -> None:
    solved = ("solve", "wall-1d", "--contact", "barrier", "--pdf", "a.pdf")
    done = run_as(tmp_path, *solved, PYTHONIOENCODING=encoding, PYTHONUTF8="0", LC_ALL="C")
    assert done.returncode == 0, done.stderr
    assert b"lam*gap" in done.stderr if encoding == "ascii" else b"lam\xb7gap" in done.stderr
    shown = run_as(tmp_path, "show", "wall-1d", PYTHONIOENCODING=encoding, PYTHONUTF8="0")
    assert shown.returncode == 0, shown.stderr
    assert (tmp_path / "a.pdf").read_bytes().startswith(b"%PDF")


def test_signs_are_written_in_words() -> None:
    assert streams.to_ascii("0 ≤ λ ⟂ φ, 1e-3 N·s – é") == "0 <= lam _|_ phi, 1e-3 N*s - e"
    assert streams.to_ascii("日") == "?"


@pytest.mark.parametrize(("words", "found"), [("ocp so", "solve"), ("ocp solve --st", "--starts")])
def test_the_shell_completes_commands_and_options(tmp_path, words: str, found: str) -> None:
    done = run_as(tmp_path, _OCP_COMPLETE="complete_bash", COMP_WORDS=words, COMP_CWORD=str(len(words.split()) - 1))
    assert done.stdout.decode().split() == [found]


def test_an_interrupted_or_plain_program_gives_its_code() -> None:
    assert main(["--version"]) == 0
    assert main(["nothing"]) == 2
