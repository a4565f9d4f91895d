"""Examples of the README and the site's pages have the right solutions.

:mod:`tests.docs.test_pages` checks that every command on them works as printed.
"""

from __future__ import annotations

import json
from pathlib import Path
from statistics import median

import numpy as np
import pytest

from docs.generator.measured import cell
from dynamics.contact import Exact
from ocp import solve
from problems import spec
from reports.cli.app import main
from tests.benchmarks.gradients import factor
from tests.docs.pages import ROOT, blocks

README, DOCS = ROOT / "README.md", ROOT / "docs"
LARGEST = 8192


def saved(page: Path, file: str, folder: Path) -> Path:
    """Write the block of ``page`` with the title ``file`` to that file; return its path."""
    source = next(b.text for b in blocks(page.read_text()) if b.file == file)
    (folder / file).write_text(source)
    return folder / file


def test_the_readme_is_short() -> None:
    assert len(README.read_bytes()) <= LARGEST


@pytest.mark.parametrize(
    ("table", "title", "columns", "number"),
    [
        ("smoothings", "Which smoothing", 5, 6),
        ("smoothings-in-the-loop", "And in the loop", 7, 3),
        ("gradient-worlds", "Which gradient", 5, 3),
    ],
)
def test_its_tables_say_what_was_measured(table: str, title: str, columns: int, number: int) -> None:
    measured = json.loads((DOCS / "generated" / "data" / f"{table}.json").read_text())
    written = factor if table == "gradient-worlds" else cell
    wanted = {tuple(map(written, row[:columns])) for row in measured["rows"]}
    text = README.read_text().partition(f"## {title}")[2].partition("\n## ")[0]
    lines = [line for line in text.splitlines() if line.startswith("| ")][2:]
    rows = [tuple(part.strip() for part in line.strip("| ").split(" | ")) for line in lines]
    assert len(rows) == number and set(rows) <= wanted


def test_its_table_of_the_arena_says_what_was_measured() -> None:
    answers = json.loads((DOCS / "generated" / "data" / "arena" / "answers.json").read_text())["answers"]
    text = README.read_text().partition("## And on tasks of others")[2].partition("\n## ")[0]
    rows = [line.strip("| ").split(" | ")[1:] for line in text.splitlines() if line.startswith("| ")][2:]
    measured = []
    for task in ("cartpole-friction", "acrobot-stops", "pushing-obstacle"):
        columns = []
        for way in ("default", "published"):
            rows_of_way = [row for row in answers if row["task"] == task and row["way"] == way]
            costs = [row["cost"] for row in rows_of_way if row["feasible"]]
            certified = sum(row["solved"] for row in rows_of_way)
            columns.append(f"{certified} · {median(costs):.3g}" if costs else f"{certified}")
        measured.append(columns)
    assert rows == measured


@pytest.mark.costly
def test_added_problem_catches_the_mass(tmp_path: Path) -> None:
    """The mass comes to rest at 0.8 m and needs the walls at 0 and 1 m."""
    file = saved(DOCS / "reference" / "problem-file.md", "catch.py", tmp_path)
    found = solve(spec(str(file)).problem({}), contact=Exact())
    x = found.data["x"].values[0]
    assert found.success
    assert x[:, 0].min() >= -1e-9 and x[:, 0].max() <= 1 + 1e-9
    assert x[-1] == pytest.approx([0.8, 0.0], abs=0.05)


@pytest.mark.costly
def test_built_machine_lifts_itself(tmp_path: Path) -> None:
    """The bar ends at rest at -0.5 rad (nose up), on tail and hand alone."""
    file = saved(DOCS / "theory" / "machines.md", "push_up.py", tmp_path)
    found = solve(spec(str(file)).problem({}), contact=Exact())
    assert found.success
    end = found.data["x"].values[0, -1]
    assert end[2] == pytest.approx(-0.5, abs=0.02)
    assert abs(end[4:]).max() < 0.05
    height = {"tail": end[1] + 0.3 * np.sin(end[2]), "nose": end[1] - 0.3 * np.sin(end[2])}
    assert height["tail"] == pytest.approx(0.05, abs=1e-6)
    assert height["nose"] - 0.4 * np.sin(end[2] + end[3]) == pytest.approx(0.05, abs=1e-6)
    weight = found.data["normal_impulse"].values[0, -1]
    assert weight[1] == 0 and weight.sum() == pytest.approx(1.3 * 9.81 * 0.05, rel=0.05)


def test_machine_example_shows_and_draws(tmp_path: Path) -> None:
    path = str(saved(DOCS / "theory" / "machines.md", "push_up.py", tmp_path))
    assert main(["show", path]) == 0
    drawn = spec(path)
    assert drawn.draw is not None
    assert len(drawn.draw(drawn.params({}), np.zeros(8))) == 1 + 2 + 3


@pytest.mark.costly
def test_python_example_gives_what_it_says() -> None:
    source = next(b.text for b in blocks(README.read_text()) if "solution.verdict" in b.text)
    scope: dict = {}
    exec(compile(source, str(README), "exec"), scope)
    solution, replay = scope["solution"], scope["solution"].replay(scope["Exact"]())
    assert solution.success
    assert replay.cost == pytest.approx(solution.audit.exact_cost, rel=1e-12)
