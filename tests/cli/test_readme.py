"""What the README shows must work as it stands."""

import re
from pathlib import Path

import pytest

from dynamics.contact import Exact
from ocp import solve
from problems import spec
from reports.cli.app import main

README = Path(__file__).parents[2] / "README.md"


def python_blocks() -> list[str]:
    return re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)


@pytest.fixture
def example(tmp_path: Path) -> Path:
    source = next(block for block in python_blocks() if 'name = "catch"' in block)
    path = tmp_path / "catch.py"
    path.write_text(source)
    return path


def test_added_problem_works_with_solve_and_show(example: Path, tmp_path: Path) -> None:
    assert main(["show", str(example)]) == 0
    assert main(["solve", str(example), "--contact", "exact", "--out", str(tmp_path / "r")]) == 0


def test_added_problem_catches_the_mass(example: Path) -> None:
    """The mass is to rest at 0.8 m; the walls at 0 and 1 m must hold it in on the way."""
    found = solve(spec(str(example)).problem({}), contact=Exact())
    x = found.data["x"].values[0]
    assert found.success
    assert x[:, 0].min() >= -1e-9 and x[:, 0].max() <= 1 + 1e-9
    assert x[-1] == pytest.approx([0.8, 0.0], abs=0.05)


def test_python_example_runs(tmp_path: Path) -> None:
    source = next(block for block in python_blocks() if "solution.verdict" in block)
    scope: dict = {}
    exec(compile(source, str(README), "exec"), scope)
    solution, replay = scope["solution"], scope["solution"].replay(scope["Exact"]())
    assert solution.success
    assert replay.cost == pytest.approx(solution.audit.exact_cost, rel=1e-12)
