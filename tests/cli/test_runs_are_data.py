"""Runs are data: code that they name is never loaded, only a file that the user names with --source."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from ocp import load, store
from ocp.errors import DamagedRun, InputError
from problems import registry
from problems.drawing import Circle
from reports.documents.common import page_header
from reports.drawing.notation import plain
from reports.drawing.view import RunView
from tests.resealed import reseal

EVIL = """
from pathlib import Path
Path(__file__).with_suffix(".ran").touch()
name, title = "mine", "Evil"
raise SystemExit(0)
"""
MINE = """
from pathlib import Path
import casadi as ca
from problems.library import wall_1d
from problems.drawing import Circle
count = Path(__file__).with_suffix(".count")
count.write_text(count.read_text() + "x" if count.exists() else "x")
name, title = "mine", "A disc and a wall"
equations = "m dot(v) = u + lambda"
Params, build0 = wall_1d.Params, wall_1d.build

def build(params):
    from dataclasses import replace
    return replace(build0(params), name="mine")

def draw(params, state):
    return [Circle(float(state[0]), 0.0, 0.1)]
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a problem's file and a run of each kind of that problem."""
    from reports.cli.app import main

    root = tmp_path_factory.mktemp("made")
    (root / "mine.py").write_text(MINE)
    mine, kept = str(root / "mine.py"), ["--out", str(root / "runs"), "--quiet"]
    for line in (
        ["solve", mine, "-p", "N=4"],
        [
            "continue",
            mine,
            "--contact",
            "barrier",
            "-p",
            "N=4",
            "--over",
            "mu",
            "--from",
            "0.1",
            "--to",
            "0.01",
            "--steps",
            "2",
        ],
        ["sweep", mine, "-p", "N=4", "--over", "m=1:2:2"],
        ["estimate", mine, "-p", "N=4", "-n", "100"],
    ):
        assert main([*line, *kept]) == 0
    return root


@pytest.fixture
def received(made: Path, tmp_path: Path) -> dict[str, Path]:
    """Return a mapping from kind to a run that names code, which reports when it is loaded."""
    (tmp_path / "evil.py").write_text(EVIL)
    shutil.copytree(made / "runs", tmp_path / "runs")
    found = {}
    for entry in store.list_runs(tmp_path / "runs"):
        (entry.path / "evil.py").write_text(EVIL)
        # Code is named as a source, inside the run or beside it, or as a problem's name.
        for field, word in (("source", str(entry.path / "evil.py")), ("problem", "evil.py")):
            run = tmp_path / f"{len(found)}" / entry.path.name
            shutil.copytree(entry.path, run)

            def change(meta, field=field, word=word) -> None:
                meta["record"][field] = word
                if field == "problem":
                    meta["problem"] = meta["record"]["source"] = word

            reseal(run, change)
            assert entry.meta is not None
            found[f"{entry.meta['kind']} {field}"] = run
    return found


COMMANDS = {
    "report": ["-o", "a.pdf"],
    "animate": ["-o", "a.gif", "--fps", "5"],
    "replay": [],
    "export": ["-o", "a.c"],
    "evaluate": [],
    "runs": [],
    "runs export": ["-o", "a.npz"],
    "figure": ["--out", "runs"],
}


@pytest.mark.costly
@pytest.mark.parametrize("command", COMMANDS)
def test_no_command_runs_what_a_run_names(ocp, received: dict[str, Path], tmp_path: Path, command: str) -> None:
    # A page takes more than a second.
    chosen = ("solve source", "estimate problem") if command == "report" else received
    for run in map(received.__getitem__, chosen):
        done = ocp(*command.split(), str(run), *COMMANDS[command])
        assert done.code in (0, 2), done.err
        assert done.err.count("\n") <= 1 and "internal" not in done.err
    assert not list(tmp_path.rglob("*.ran"))


@pytest.mark.costly
def test_nor_does_a_start_or_a_decision(ocp, made: Path, received: dict[str, Path]) -> None:
    run = received["solve source"]
    for line in (
        ["solve", str(made / "mine.py"), "-p", "N=4", "--from"],
        ["estimate", str(made / "mine.py"), "-p", "N=4", "-n", "10", "--at"],
    ):
        assert ocp(*line, str(run), "-q").code == 0
    with pytest.raises(InputError, match=r"never loads code.*--source FILE"):
        load(run)
    assert not list(run.parents[1].rglob("*.ran"))


@pytest.mark.cheap_cases("export")
@pytest.mark.parametrize("command", ["replay", "report", "animate", "export"])
def test_source_names_the_code(ocp, made: Path, command: str) -> None:
    run = next(e.path for e in store.list_runs(made / "runs") if e.meta and e.meta.get("grade"))
    line = (command, str(run), *COMMANDS[command], "--source")
    assert ocp(*line, str(made / "mine.py")).code == 0
    other = made / "other.py"
    other.write_text(MINE.replace('"mine"', '"other"'))
    refused = ocp(*line, str(other))
    assert refused.code == 2 and "defines other, and the run is of mine" in refused.err
    assert ocp(*line, str(made / "none.py")).code == 2


def test_what_needs_code_says_so_in_a_sentence(ocp, made: Path) -> None:
    run = next(e.path for e in store.list_runs(made / "runs") if e.meta and e.meta.get("grade"))
    told = json.loads((run / "meta.json").read_text())["record"]["source"]
    for command in ("replay", "export"):
        done = ocp(command, str(run), *COMMANDS[command])
        assert done.code == 2 and done.err.count("\n") == 1
        assert "--source FILE" in done.err and told in done.err


def test_source_is_for_runs_of_a_file(ocp) -> None:
    run = ocp("solve", "wall-1d", "--contact", "barrier", "-p", "N=4", "--json", "-q").json["run"]
    done = ocp("replay", run, "--source", "a.py")
    assert done.code == 2 and "wall-1d is not defined in a file; drop --source" in done.err


def test_load_takes_the_file_by_name(made: Path) -> None:
    run = next(e.path for e in store.list_runs(made / "runs") if e.meta and e.meta.get("grade"))
    again = load(run, source=made / "mine.py")
    assert again.replay().cost == pytest.approx(again.audit.exact_cost, rel=1e-9)


@pytest.mark.costly
def test_a_run_shows_its_problem_without_the_file(ocp, made: Path, tmp_path: Path) -> None:
    """The motion is the same as with the file, at nodes as drawn and linear between them."""
    run = next(e.path for e in store.list_runs(made / "runs") if e.meta and e.meta.get("grade"))
    shapes = {}
    for how in ([], ["--source", str(made / "mine.py")]):
        done = ocp("animate", str(run), "-o", "a.gif", "--fps", "7", "--json", *how)
        assert done.code == 0 and done.json["frames"] == 4
        own = registry.load(how[1]) if how else None
        view = RunView.of(store.load(run), own)
        assert (view.spec is None) == (not how)
        assert view.title == "A disc and a wall"
        times = np.linspace(0, view.time[-1], 9)
        assert view.picture is not None
        assert view.picture.shapes("", view.time)[0] == [Circle(1.0, 0.0, 0.1)]
        shapes[len(how)] = [
            [disc.x for (disc,) in view.picture.shapes(suffix, times) if isinstance(disc, Circle)]
            for suffix in ("", "_replay")
        ]
    np.testing.assert_allclose(shapes[0], shapes[2], rtol=0, atol=1e-14)
    kept = page_header(RunView.of(store.load(run)))
    named = page_header(RunView.of(store.load(run), registry.load(made / "mine.py")))
    assert sorted(kept["parameters"]) == sorted(named["parameters"])
    assert kept["equations"] == [] and kept["typed"] == [plain("m dot(v) = u + lambda")]
    assert "--source FILE" in kept["unloaded"] and named["unloaded"] == ""


def test_what_is_not_drawn_ahead_says_why(ocp, made: Path, tmp_path: Path) -> None:
    (tmp_path / "late.py").write_text(
        MINE.replace("return [Circle", "if state[0] < 0.9: return None\n    return [Circle")
    )
    solved = ocp("solve", "late.py", "-p", "N=4", "--json", "-q")
    assert solved.code == 0, "a run is never lost for its drawing"
    done = ocp("animate", solved.json["run"], "-o", "a.gif")
    assert done.code == 2 and "draw(params, state)" in done.err and "has no drawing" in done.err


def test_a_flip_in_what_is_kept_of_the_problem_is_found(made: Path, tmp_path: Path) -> None:
    source = next(e.path for e in store.list_runs(made / "runs") if e.meta and e.meta.get("grade"))
    run = shutil.copytree(source, tmp_path / "run")
    content = (run / "problem.json").read_bytes()
    for bit in np.random.default_rng(14).choice(8 * len(content), 100, replace=False):
        changed = bytearray(content)
        changed[bit // 8] ^= 1 << bit % 8
        (run / "problem.json").write_bytes(changed)
        with pytest.raises(DamagedRun, match=r"problem\.json"):
            store.load(run)


@pytest.mark.one_case_in(3)
@pytest.mark.parametrize(
    "harm",
    [
        b"[]",
        b"{}",
        b'{"title": 1}',
        b"[" * 10_000,
        b'{"title": "a", "equations": [], "axes": ["x", "y"], "parameters": {}, "undrawn": "",'
        b' "motions": {"": {"shapes": [[{"kind": "__import__", "name": "os"}]], "contacts": []}}}',
    ],
)
def test_a_drawing_of_another_kind_is_damage(ocp, made: Path, tmp_path: Path, harm: bytes) -> None:
    source = next(e.path for e in store.list_runs(made / "runs") if e.meta and e.meta.get("grade"))
    run = shutil.copytree(source, tmp_path / "run")
    reseal(run, lambda meta: None, problem=harm)
    done = ocp("animate", str(run), "-o", "a.gif")
    assert done.code == 4 and done.err.count("\n") == 1, done.err
