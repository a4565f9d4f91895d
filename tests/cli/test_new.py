"""``ocp new``: every template is written under the given name, loads, solves, and is drawn."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ocp import solve
from problems import load
from problems.drawing import Circle, ContactFrame

KINDS = {"plain": [], "scene": ["--scene"], "machine": ["--machine"]}
COSTS = {"plain": 0.00142025, "scene": 0.117522, "machine": 0.155373}


def written(ocp, kind: str) -> Path:
    done = ocp("new", "my-robot", *KINDS[kind], "--json")
    assert done.code == 0 and done.json["template"] == kind
    assert done.json["file"] == "my-robot.py"
    return Path("my-robot.py")


@pytest.mark.parametrize("kind", KINDS)
def test_a_template_loads_under_its_new_name_and_is_drawn(ocp, kind: str) -> None:
    found = load(written(ocp, kind))
    assert found.name == "my-robot" and found.title
    problem = found.problem({"N": 3})
    assert problem.name == "my-robot" and problem.N == 3
    x0 = problem.initial_states(problem.parameters.values)[0]
    assert found.draw is not None and any(isinstance(s, Circle) for s in found.draw(found.params({}), x0))
    frames = [] if found.frames is None else found.frames(found.params({}), x0)
    assert all(isinstance(frame, ContactFrame) for frame in frames)
    assert len(frames) == {"plain": 0, "scene": 3, "machine": 3}[kind]
    text = Path("my-robot.py").read_text()
    assert text.count("my-robot") == 1 and text.count("  # ") > 5, "it explains itself"


@pytest.mark.cheap_cases("plain")
@pytest.mark.parametrize("kind", KINDS)
def test_a_template_solves_in_few_steps(ocp, kind: str) -> None:
    found = solve(load(written(ocp, kind)).problem({"N": 2}), contact="exact")
    assert found.success and found.certificate.stationarity == "B"


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_template_solves_and_survives_as_it_stands(ocp, kind: str) -> None:
    done = ocp("solve", str(written(ocp, kind)), "--contact", "exact", "--require", "survives", "--json")
    assert done.code == 0, done.err
    np.testing.assert_allclose(done.json["cost"], COSTS[kind], rtol=1e-4)


def test_a_file_that_exists_is_kept(ocp) -> None:
    Path("mine.py").write_text("x = 1\n")
    done = ocp("new", "mine")
    assert (done.code, done.out) == (2, "")
    assert done.err == "error: mine.py exists; choose another name, or move the file away\n"
    assert Path("mine.py").read_text() == "x = 1\n"
    Path("loop.py").symlink_to("nowhere")
    assert ocp("new", "loop.py").code == 2


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["two words"], "must be a word"),
        (["../up"], "must be a word"),
        (["push-disc"], "is a problem of the workbench"),
        (["mine", "--scene", "--machine"], "give one of them"),
    ],
)
def test_a_bad_request_is_refused(ocp, words: list[str], told: str) -> None:
    done = ocp("new", *words)
    assert done.code == 2 and told in done.err and not list(Path().iterdir())
