"""``ocp solve MODEL.nl``: a model that Pyomo 6.10 wrote, its names, its .sol file, and what is refused.

The model is in tests/data: the leader pays ``(x - 2)² + (y - 3)² + exp(z)`` with z in [-1, 2], and the
follower chooses ``y = min(x, 1)``, as ``y - x + s = 0`` and ``0 <= s ⟂ 1 - y >= 0``. The best x is 2.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

DATA = Path(__file__).parents[1] / "data"
COST = 4 + np.exp(-1)


@pytest.fixture
def model(tmp_path: Path) -> Path:
    for suffix in ("nl", "row", "col"):
        shutil.copy(DATA / f"leader.{suffix}", tmp_path)
    return tmp_path / "leader.nl"


def test_a_model_of_pyomo_is_solved_and_certified(ocp, model: Path) -> None:
    done = ocp("solve", "leader.nl", "--json")
    assert done.code == 0
    document = json.loads(done.out)
    assert document["success"] and document["stationarity"] == "B"
    assert document["cost"] == pytest.approx(COST, abs=1e-7)
    values = {name: document["x"][name] for name in ("x", "y", "z", "s")}
    assert values == pytest.approx({"x": 2, "y": 1, "z": -1, "s": 1}, abs=1e-6)
    lines = model.with_suffix(".sol").read_text().splitlines()
    options = lines.index("Options")
    assert lines[options + 1 : options + 9] == ["3", "1", "1", "0", "3", "3", "5", "5"]
    numbers = [float(line) for line in lines[options + 9 : -1]]
    assert numbers[3:] == pytest.approx([2, 1, -1, 1, 0], abs=1e-6)
    assert numbers[1] == pytest.approx(4, abs=1e-5), "of the pair's row: the cost by 1 - y"
    assert lines[-1] == "objno 0 0"


def test_a_model_without_solution_exits_3_and_names_the_row(ocp, model: Path) -> None:
    model.write_text(
        model.read_text().replace("4 0\t#bal", "4 5\t#bal").replace("3\t#x", "2 0\t#x").replace("2 0\t#s", "0 0 1\t#s")
    )
    done = ocp("solve", "leader.nl")
    assert done.code == 3 and "bal" in done.out
    assert model.with_suffix(".sol").read_text().rstrip().endswith("objno 0 200")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["leader.nl", "--contact", "barrier"], "--contact has no effect on an .nl file"),
        (["leader.nl", "-s", "tol=abc"], "tol"),
        (["other.nl"], "other.nl cannot be read"),
        (["integer.nl"], "2 integer variables"),
    ],
)
def test_bad_input_exits_2(ocp, model: Path, words: list[str], message: str) -> None:
    text = model.read_text().replace(" 0 0 0 0 0 \t# discrete", " 2 0 0 0 0 \t# discrete")
    model.with_name("integer.nl").write_text(text)
    done = ocp("solve", *words)
    assert done.code == 2 and message in done.err
    assert not list(model.parent.glob("*.sol"))
