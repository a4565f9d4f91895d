"""``ocp gradients``: output, stored runs, resuming, users' files, and rejected input."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from ocp import store
from reports.cli.app import main

TEMPLATE = Path(__file__).parents[2] / "examples" / "dropped_ball.py"
LINE = """import numpy as np
theta = [2.0, 3.0]
parameters = "a [m] first; b [s] second"
outputs = "y [m]; z [N]"
def rollout(theta, h=0.1):
    return np.stack([theta[:, 0] * theta[:, 1], theta[:, 1] ** 2 + 0 * h], axis=1)
def gradient(theta):
    rows = np.zeros((len(theta), 2, 2))
    rows[:, 0, 0], rows[:, 0, 1], rows[:, 1, 1] = theta[:, 1], theta[:, 0], 2 * theta[:, 1]
    return rows
slope = [[3.0, 2.0], [0.0, 6.0]]
"""


@pytest.fixture
def gradients(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "line.py").write_text(LINE)

    def call(*words: str) -> tuple[int, dict, str]:
        code = main(["gradients", *words, "--json", "--quiet", "-n", "100"])
        out, err = capsys.readouterr()
        return code, json.loads(out) if out.strip() else {}, err

    return call


@pytest.mark.costly
def test_a_file_is_its_own_scene_and_its_entries_are_chosen(gradients) -> None:
    code, document, _ = gradients("line.py")
    (row,) = document["worlds"]
    assert code == 0 and row["verdict"] == "right" and row["slope"] == 3.0 and row["settings"] == {"h": 0.1}
    assert document["parameter"] == {"name": "a", "unit": "m"} and document["kind"] == "gradients"
    code, document, _ = gradients("line.py", "--parameter", "1", "--component", "1", "-s", "h=0.5")
    (row,) = document["worlds"]
    assert (row["slope"], row["truth"], row["settings"]) == (6.0, 6.0, {"h": 0.5})
    assert document["output"] == {"name": "z", "unit": "N"}


def test_a_wrong_gradient_of_a_file_is_seen(gradients, tmp_path: Path) -> None:
    (tmp_path / "line.py").write_text(LINE.replace("= theta[:, 1], theta[:, 0]", "= 2 * theta[:, 1], theta[:, 0]"))
    _, document, _ = gradients("line.py")
    assert document["worlds"][0]["verdict"] == "not-the-derivative"


@pytest.mark.costly
def test_the_run_is_stored_reported_and_exported(gradients, tmp_path: Path, capsys) -> None:
    code, document, _ = gradients("line.py", "--pdf", "a.pdf", "--tag", "mine")
    stored = store.load(document["run"])
    assert code == 0 and stored.kind == "gradients" and stored.meta["tags"] == ["mine"]
    assert (tmp_path / "a.pdf").read_bytes().startswith(b"%PDF")
    np.testing.assert_allclose(stored.data["secants"].values, 3.0, rtol=1e-5)
    assert stored.data["secants"].attrs["units"] == "(m)/(m)"
    assert main(["report", document["run"], "-o", "b.pdf", "--quiet"]) == 0
    assert (tmp_path / "a.pdf").read_bytes() == (tmp_path / "b.pdf").read_bytes()
    assert main(["runs", "export", document["run"], "-o", "c.csv", "--quiet"]) == 0
    header = (tmp_path / "c.csv").read_text().splitlines()[0].split(",")
    assert header[:2] == ["world", "amplitude"] and "secants [(m)/(m)]" in header
    capsys.readouterr()
    again = gradients("line.py")[1]
    assert store.load(again["run"]).meta["hash"] == stored.meta["hash"]


def test_a_file_that_raises_in_the_middle_leaves_the_other_worlds(gradients, tmp_path: Path) -> None:
    failing = LINE.replace(
        "    return np.stack", "    if len(theta) > 10: raise ValueError('lost')\n    return np.stack"
    )
    (tmp_path / "failing.py").write_text(failing)
    code, document, _ = gradients("line.py", "--world", "failing.py")
    assert code == 0 and [row["verdict"] for row in document["worlds"]] == ["right", "failed"]
    assert "lost" in document["worlds"][1]["sentence"] and document["status"] == "partly failed"


HOVER = """import numpy as np
def rollout(theta):  # push-1d with the weights of the input's increments alone
    du = np.diff(theta, axis=1, prepend=-0.5)
    return 0.1 * np.square(du).sum(axis=1, keepdims=True)
def gradient(theta):
    du = np.diff(theta, axis=1, prepend=-0.5, append=theta[:, -1:])
    return 0.2 * (du[:, :-1] - du[:, 1:])[:, None]
"""


@pytest.mark.costly
def test_the_cost_of_a_stored_plan_is_differentiated_by_its_inputs(gradients, tmp_path: Path, capsys) -> None:
    """A pusher without a goal stays at its start, which is an optimum: random directions remain."""
    (tmp_path / "hover.py").write_text(HOVER)
    solve = "solve push-1d -p N=3 -p w_end=0 -p w_x=0 --effort quick --json --quiet"
    assert main(solve.split()) == 0
    solved = json.loads(capsys.readouterr().out)
    code, document, _ = gradients("@last", "--world", "exact", "--world", "hover.py", "--refinements", "0")
    assert code == 0 and document["kind"] == "gradients" and document["record"]["plan"] in solved["run"]
    assert [row["world"] for row in document["worlds"]] == [
        f"{w} along d{i}" for i in (1, 2, 3) for w in ("exact", "hover")
    ]
    assert {row["verdict"] for row in document["worlds"]} == {"right"}, document["verdict"]
    assert main(["report", document["run"], "-o", "plan.pdf", "--quiet"]) == 0
    capsys.readouterr()
    for words, message in (
        (["@last"], "is a run of ocp gradients, expected a run of ocp solve"),
        (["@2", "--parameter", "1"], "choose entries of a file"),
        (["@2", "--world", "penalty"], "unknown world 'penalty'"),
    ):
        code, _, err = gradients(*words)
        assert code == 2 and message in err and len(err.strip().splitlines()) == 1


BAD = {
    "nothing.py": "there is no such file",
    "two-ball": "did you mean 'two-balls'",
    "line.py --world mujoco": "and not line.py",
    "line.py --parameter 2": "theta has 2 parameters",
    "line.py --component 2": "does not name entry 2",
    "line.py -s k=1": "no simulator has a setting 'k'",
    "two-balls --world line.py --tolerance 2": "tolerance",
}


@pytest.mark.parametrize("words", BAD)
def test_bad_input_gets_one_sentence(gradients, words: str) -> None:
    code, document, err = gradients(*words.split())
    assert code == 2 and not document and BAD[words] in err and len(err.strip().splitlines()) == 1


BAD_FILES = {
    "x = 1": "must define rollout(theta)",
    "def rollout(theta): return theta": "must define theta",
    "theta = 'a'\ndef rollout(theta): return theta": "theta",
    "theta = 0.0\ndef rollout(theta): return theta": "needs a size > 0",
    "theta = 1.0\ndef rollout(theta): return theta[:, 0]": "returned the shape",
    "theta = 1.0\ndef rollout(theta): return 1 / 0": "ZeroDivisionError",
    "theta = 1.0\ndef rollout(theta, h): return theta": "argument h of rollout has no default",
    "theta = 1.0\nsharper = {'h': 2}\ndef rollout(theta): return theta": "sharper names 'h'",
    "theta = 1.0\nlonger = {'n': 2}\ndef rollout(theta, h=1.0): return theta": "longer names 'n'",
    "import numpy as np\ntheta = 1.0\ndef rollout(theta): return theta + np.random.rand()": "seed its random numbers",
}


@pytest.mark.parametrize("text", BAD_FILES)
def test_a_bad_file_gets_one_sentence(gradients, tmp_path: Path, text: str) -> None:
    (tmp_path / "bad.py").write_text(text)
    code, _, err = gradients("bad.py")
    assert code == 2 and BAD_FILES[text] in err and len(err.strip().splitlines()) == 1


def test_the_template_runs_and_its_gradient_is_right(gradients, tmp_path: Path, capsys) -> None:
    assert main(["new", "sim", "--world"]) == 0
    assert "ocp gradients sim.py" in capsys.readouterr().out
    assert (tmp_path / "sim.py").read_text() == TEMPLATE.read_text()
    code, document, _ = gradients("sim.py", "--refinements", "0")
    assert code == 0 and document["worlds"][0]["verdict"] == "right"


@pytest.mark.parametrize(
    ("stated", "changed", "message"),
    [
        (
            "slope = [[3.0, 2.0], [0.0, 6.0]]",
            "slope = [[3.0], [2.0], [0.0], [6.0]]",
            "(m, 2), got [[3.0]",
        ),
        ("slope = [[3.0, 2.0], [0.0, 6.0]]", "slope = [[3.0, 2.0], [0.0, np.nan]]", "finite numbers (m, 2)"),
        ("slope = [[3.0, 2.0], [0.0, 6.0]]", "truth = lambda theta: theta * np.nan", "at the nominal parameters"),
    ],
)
def test_what_a_file_states_is_checked(gradients, tmp_path: Path, stated: str, changed: str, message: str) -> None:
    (tmp_path / "line.py").write_text(LINE.replace(stated, changed))
    code, document, err = gradients("line.py")
    assert code == 2 and not document and message in err and err.count("\n") == 1
