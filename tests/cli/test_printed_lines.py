"""Printed lines: quiet and plain output, 80 columns, one line for a stage or a point."""

from __future__ import annotations

import math

import pytest

from tests.cli.test_commands import strict


@pytest.mark.costly
def test_quiet_and_plain_output(ocp) -> None:
    loud = ocp("solve", "wall-1d", "--contact", "barrier")
    assert "Solved" in loud.out and "run: " in loud.out
    assert "lam·gap" in loud.err
    quiet = ocp("solve", "wall-1d", "--contact", "barrier", "--quiet")
    assert quiet.out.splitlines()[0] == loud.out.splitlines()[0]
    assert quiet.err == ""


@pytest.mark.cheap_cases("show cart-walls")
@pytest.mark.parametrize(
    "arguments",
    [
        ["solve", "push-disc", "--contact", "exact"],
        ["solve", "wall-1d", "--contact", "randomized", "-c", "base=barrier", "-c", "samples=4"],
        ["solve", "push-disc", "--contact", "barrier", "-s", "max_iter=3", "-s", "homotopy=false"],
        ["solve", "push-1d", "--contact", "barrier", "--starts", "2"],
        [
            "continue",
            "push-1d",
            "--contact",
            "barrier",
            "--over",
            "M",
            "--from",
            "1",
            "--to",
            "2",
            "--steps",
            "2",
        ],
        ["runs"],
        ["runs", "wall-1d"],
        ["show", "cart-walls"],
        ["--help"],
    ],
    ids=lambda arguments: " ".join(arguments[:2]),
)
def test_everything_fits_80_columns(ocp, arguments: list[str]) -> None:
    ocp("solve", "wall-1d", "--contact", "randomized", "-c", "base=barrier", "-c", "samples=4")
    done = ocp(*arguments)
    assert done.code in (0, 3)
    # Sentences may be long; a line of a table has columns, two blanks apart.
    lines = [line.rstrip() for line in (done.out + done.err).splitlines()]
    tables = [line for line in lines if "  " in line.strip()]
    assert tables
    assert max(map(len, tables)) <= 80


@pytest.mark.costly
def test_a_stage_is_told_in_one_line_without_a_terminal(ocp) -> None:
    done = ocp("solve", "push-1d", "--contact", "barrier", "-c", "mu=1e-2", "--json")
    rows = [line.split() for line in done.err.partition("cost under")[0].splitlines()]
    assert rows[0] == ["stage", "parameter", "cost", "lam·gap", "residual", "iter", "s"]
    stages = done.json["stages"]
    told = [row for row in rows[1:] if row[0].isdigit() and row[-1] != "cost."]
    assert [int(row[0]) for row in told] == sorted({int(row[0]) for row in told}), "each once"
    for row in told:
        stage = stages[int(row[0]) - 1]
        assert row[-2] == str(stage["iterations"]) and f"{stage['cost']:.7g}" in row
    hidden = set(range(1, len(stages) + 1)) - {int(row[0]) for row in told}
    assert all(stages[n - 1]["label"] == "neighbour" for n in hidden)
    quiet = ocp("solve", "push-1d", "--contact", "barrier", "-c", "mu=1e-2", "-q")
    assert quiet.err == ""


@pytest.mark.costly
def test_a_point_of_a_continuation_is_told_in_one_line(ocp) -> None:
    done = ocp(
        "continue",
        "wall-1d",
        "--contact",
        "barrier",
        "--over",
        "m",
        "--from",
        "1",
        "--to",
        "2",
        "--steps",
        "2",
        "--json",
    )
    rows = [line.split() for line in done.err.splitlines()]
    assert [row[0] for row in rows[1:4]] == ["1", "1.5", "2"]
    assert [float(row[1]) for row in rows[1:4]] == pytest.approx(
        [point["cost"] for point in done.json["points"]], rel=1e-6
    )
    assert sum(row[0] == "1.5" for row in rows) == 1


def test_what_is_not_finite_is_null(ocp, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    from reports.cli.streams import Output

    Output(as_json=True, quiet=False).document({"a": math.nan, "b": [math.inf, 1.0]})
    assert strict(capsys.readouterr().out) == {"a": None, "b": [None, 1.0]}


def test_jit_without_a_compiler_is_one_line(ocp, monkeypatch: pytest.MonkeyPatch) -> None:
    from dynamics.batch.engines import compiler

    def none() -> None:
        raise compiler.CompilerError("no C compiler found (looked for cc)")

    monkeypatch.setattr(compiler, "find_compiler", none)
    done = ocp("solve", "wall-1d", "--contact", "barrier", "-s", "jit=true", "--json", "--quiet")
    assert done.code == 0
    line = "no C compiler found (looked for cc); functions are interpreted"
    assert strict(done.out)["jit"] == line
    assert done.err.splitlines().count(f"jit: {line}") == 1
