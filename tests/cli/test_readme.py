"""What the README shows must work as it stands."""

import re
from pathlib import Path

import numpy as np
import pytest

from dynamics.contact import Exact
from ocp import solve
from problems import spec
from reports.cli.app import main

README = Path(__file__).parents[2] / "README.md"


def python_blocks() -> list[str]:
    return re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)


def saved(name: str, folder: Path) -> Path:
    """The block that defines a problem, as the file that the README calls it."""
    source = next(block for block in python_blocks() if f'"{name}"' in block)
    path = folder / f"{name.replace('-', '_')}.py"
    path.write_text(source)
    return path


@pytest.fixture
def example(tmp_path: Path) -> Path:
    return saved("catch", tmp_path)


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


def test_built_machine_lifts_itself(tmp_path: Path) -> None:
    """The bar ends turned by -0.5 rad (nose up) and at rest, on tail and hand alone."""
    found = solve(spec(str(saved("push-up", tmp_path))).problem({}), contact=Exact())
    assert found.success
    assert found.verdict in README.read_text()
    end = found.data["x"].values[0, -1]
    assert end[2] == pytest.approx(-0.5, abs=0.02)
    assert abs(end[4:]).max() < 0.05
    height = {"tail": end[1] + 0.3 * np.sin(end[2]), "nose": end[1] - 0.3 * np.sin(end[2])}
    assert height["tail"] == pytest.approx(0.05, abs=1e-6)
    assert height["nose"] - 0.4 * np.sin(end[2] + end[3]) == pytest.approx(0.05, abs=1e-6)
    weight = found.data["normal_impulse"].values[0, -1]
    assert weight[1] == 0 and weight.sum() == pytest.approx(1.3 * 9.81 * 0.05, rel=0.05)


def test_machine_example_shows_and_draws(tmp_path: Path) -> None:
    path = str(saved("push-up", tmp_path))
    assert main(["show", path]) == 0
    drawn = spec(path)
    assert drawn.draw is not None
    assert len(drawn.draw(drawn.params({}), np.zeros(8))) == 1 + 2 + 3


def test_python_example_runs(tmp_path: Path) -> None:
    source = next(block for block in python_blocks() if "solution.verdict" in block)
    scope: dict = {}
    exec(compile(source, str(README), "exec"), scope)
    solution, replay = scope["solution"], scope["solution"].replay(scope["Exact"]())
    assert solution.success
    assert replay.cost == pytest.approx(solution.audit.exact_cost, rel=1e-12)
