"""Bad input of ``ocp collect`` and ``ocp learn`` gives a sentence."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from tests.cli.conftest import Ocp
from tests.cli.test_learned import COLLECT

LEARN = ("learn", "data.nc", "--model")
CASES = {
    "problem": (["collect", "push-2d", "-o", "x.nc"], "did you mean 'push-1d'"),
    "objective": (["collect", "coulomb", "-o", "x.nc"], "has no transitions"),
    "few samples": ([*COLLECT[:2], "-n", "20", "-o", "x.nc"], "needs at least 30, ten per state"),
    "odd samples": ([*COLLECT[:2], "-n", "2.5", "-o", "x.nc"], "--samples must be a whole number"),
    "many samples": ([*COLLECT[:2], "-n", "1e15", "-o", "x.nc"], "take fewer"),
    "place": ([*COLLECT[:2], "-o", "."], ". is a directory; name a file such as data.nc"),
    "parameter": ([*COLLECT, "-p", "width=-1"], "width (distance of the centres"),
    "model": ([*LEARN, "ewdb", "-o", "x.nc"], "unknown model 'ewdb' (did you mean 'ewda'?)"),
    "no data": (["learn", "none.nc", "--model", "ewda", "-o", "x.nc"], "file not found"),
    "zero noise": ([*LEARN, "ewda", "--noise", "0", "-o", "x.nc"], "must be above 0, got 0; 0.2"),
    "negative noise": ([*LEARN, "mlp", "--noise", "-1", "-o", "x.nc"], "must be at least 0, got"),
    "drowning noise": ([*LEARN, "mlp", "--noise", "1e9", "-o", "x.nc"], "standard deviations"),
    "noise no number": ([*LEARN, "mlp", "--noise", "nan", "-o", "x.nc"], "must be a finite number"),
    "network's": (
        [*LEARN, "ewda", "--hidden", "8", "-o", "x.nc"],
        "--hidden is a setting of networks",
    ),
    "hidden": ([*LEARN, "mlp", "--hidden", "8,x", "-o", "x.nc"], "must be a whole number >= 1"),
    "no layer": ([*LEARN, "mlp", "--hidden", "0", "-o", "x.nc"], "must be whole numbers >= 1"),
    "wide": ([*LEARN, "mlp", "--hidden", "99999,99999", "-o", "x.nc"], "of memory, and this"),
    "columns": ([*LEARN, "ewda", "--columns", "a=b", "-o", "x.nc"], "is for tables"),
    "another problem": (
        [*LEARN, "ewda", "--problem", "push-disc", "-o", "x.nc"],
        "the states are qu [m], qa [m], and push-disc has ox [m]",
    ),
    "a model as data": (
        ["learn", "model.nc", "--model", "ewda", "-o", "x.nc"],
        "holds a model of kind ewda, not transitions",
    ),
    "a table as netCDF": (["show", "table.nc"], "is not a netCDF file"),
    "cut data": (["learn", "cut.nc", "--model", "ewda", "-o", "x.nc"], "truncated or damaged"),
    "cut model": (["show", "cut.nc"], "truncated or damaged"),
    "nan in a table": (
        ["learn", "nan.csv", "--model", "ewda", "-o", "x.nc"],
        "2 of 30 rows hold values that are not finite (4, 9, counted from 0; x is nan in row 4)",
    ),
    "constant column": (
        ["learn", "constant.csv", "--model", "ewda", "-o", "x.nc"],
        "u never varies, so nothing can be learned from it",
    ),
    "few rows": (["learn", "few.csv", "--model", "mlp", "-o", "x.nc"], "5 rows are too few"),
    "no column": (
        ["learn", "nan.csv", "--model", "ewda", "--problem", "push-1d", "-o", "x.nc"],
        "no column for qu [m]; it has x, u, x_next; map one with columns qu=COLUMN",
    ),
    "odd map": (
        ["learn", "nan.csv", "--model", "ewda", "--columns", "x", "-o", "x.nc"],
        "--columns: expected name=value",
    ),
    "model's problem": (
        ["solve", "push-disc", "--contact", "ewda", "-c", "model=model.nc"],
        "states qu, qa, but push-disc has ox, oy, ax, ay",
    ),
    "cut model in a solve": (
        ["solve", "push-1d", "--contact", "mlp", "-c", "model=cut.nc"],
        "truncated or damaged",
    ),
    "no model in a solve": (
        ["solve", "push-1d", "--contact", "mlp", "-c", "model=none.nc"],
        "none.nc: file not found",
    ),
    "data as a model": (
        ["solve", "push-1d", "--contact", "ewda", "-c", "model=data.nc"],
        "holds transitions, not a model; learn one from them",
    ),
}


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with data, a model, and files that are neither."""
    from reports.cli.app import main

    root = tmp_path_factory.mktemp("files")
    data, model = str(root / "data.nc"), str(root / "model.nc")
    assert main(["collect", "push-1d", "-n", "200", "-o", data, "-q"]) == 0
    assert main(["learn", data, "--model", "ewda", "-o", model, "-q"]) == 0
    # Zeros follow the numbers; a file without them is complete.
    (root / "cut.nc").write_bytes((root / "data.nc").read_bytes().rstrip(b"\0")[:-400])
    rows = [[f"{i}", f"{i % 7}", f"{i + 1}"] for i in range(30)]
    tables = {
        "constant.csv": [[x, "2", y] for x, _, y in rows],
        "few.csv": rows[:5],
        "nan.csv": [["" if i in (4, 9) else row[0], *row[1:]] for i, row in enumerate(rows)],
        "table.nc": rows,
    }
    for name, lines in tables.items():
        (root / name).write_text("\n".join(["x,u,x_next", *map(",".join, lines)]))
    return root


@pytest.mark.costly_cases(
    "problem",
    "objective",
    "wide",
    "another problem",
    "a model as data",
    "cut data",
    "cut model",
    "model's problem",
    "cut model in a solve",
    "no model in a solve",
    "data as a model",
)
@pytest.mark.parametrize("case", CASES)
def test_bad_input_is_told_in_a_sentence(ocp: Ocp, files: Path, case: str) -> None:
    words, message = CASES[case]
    for file in files.iterdir():
        Path(file.name).write_bytes(file.read_bytes())
    done = ocp(*words)
    assert done.code == 2, done.err
    assert message in done.err and done.out == ""
    assert done.err.startswith("error: ") and done.err.count("\n") == 1
    assert not Path("x.nc").exists()


def test_training_without_jax_names_the_extra(ocp: Ocp, files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "jax", None)
    data = str(files / "data.nc")
    done = ocp("learn", data, "--model", "mlp", "-o", "x.nc")
    assert done.code == 2 and "pip install 'centralpath[learn]'" in done.err
    assert ocp("learn", data, "--model", "ewda", "-o", "x.nc", "-q").code == 0


def test_a_next_state_that_never_varies_is_told(ocp: Ocp) -> None:
    """The next value of the thrown ball's hand state is the same in all transitions."""
    assert ocp("collect", "ball-throw", "--samples", "300", "-o", "data.nc").code == 0
    done = ocp("learn", "data.nc", "--model", "ewda", "-o", "model.nc")
    assert done.code == 2
    assert "the next hand never varies" in done.err
