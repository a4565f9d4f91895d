"""A contact law from a user's file works in every command that takes ``--contact``."""

from __future__ import annotations

import pickle
import shutil
from pathlib import Path

import pytest

from ocp import solve
from ocp.transcription.factories import contact_law
from tests.unit.test_examples import EXAMPLES

LAW = (EXAMPLES / "logistic.py").read_text()
SHORT = ("-p", "N=6")


@pytest.fixture
def law(tmp_path: Path) -> Path:
    return Path(shutil.copy(EXAMPLES / "logistic.py", tmp_path))


@pytest.mark.costly
def test_a_run_under_it_is_replayed_and_exported_where_the_file_is_named(ocp, law: Path) -> None:
    done = ocp("solve", "push-1d", *SHORT, "--contact", law.name, "-c", "width=0.03", "--json")
    assert done.code == 0 and done.json["contact"] == "logistic"
    told = ocp("runs", "@last", "--json").json
    assert told["record"]["contact_settings"] == {"width": 0.03}
    assert ocp("replay", "@last").code == 0, "the exact law needs no file"
    own = ocp("replay", "@last", "--contact", law.name, "--json").json
    assert own["contact_settings"] == {"width": 0.03}, "those of the run"
    assert own["cost"] == pytest.approx(done.json["cost"], rel=1e-6)
    for words in (["replay", "@last", "--contact", "logistic"], ["export", "@last", "-o", "a.c"]):
        refused = ocp(*words)
        assert refused.code == 2
        assert f"logistic is the law of the file {law}, and a run never loads code" in refused.err
    assert ocp("export", "@last", "-o", "a.c", "--contact", law.name).code == 0
    law.write_text(LAW + "\n# another\n")
    assert "has changed since" in ocp("replay", "@last", "--contact", law.name).out


@pytest.mark.costly
@pytest.mark.parametrize(
    "words",
    [
        ["sweep", "push-1d", *SHORT, "--over", "contact.width=0.02:0.1:2"],
        ["continue", "push-1d", *SHORT, "--over", "contact.width", "--from", "0.1", "--to", "0.05", "--steps", "1"],
        ["estimate", "push-1d", *SHORT, "-n", "200"],
        ["mpc", "push-1d", "--phase", "relaxed", "--steps", "2"],
        ["train", "ball-throw", "--iterations", "1", "--algorithm", "zopg"],
    ],
    ids=lambda words: words[0],
)
def test_every_command_takes_it(ocp, law: Path, words: list[str]) -> None:
    done = ocp(*words, "--contact", law.name)
    assert done.code == 0, done.err
    assert "logistic" in ocp("runs", "@last").out
    told = ocp("report", "@last", "-o", "a.pdf")
    assert told.code == 0, told.err


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ('LAW_PREFIX + "width"]\n', 'LAW_PREFIX + "w"]\n', "target(...) failed: line 48: KeyError"),
        ("ca.diag(F)", "F", "target(system, z, F, p) must return mu of shape"),
        ('"logistic"', '"barrier"', "there is a law called barrier already"),
        (": float = setting(", " = setting(", "'width' is a field but has no type annotation"),
        (
            "    width:",
            "    def __init__(self, width=1.0) -> None: ...\n    size:",
            "must say the type of each setting",
        ),
        ("def target", "def targets", "Logistic must define target"),
        ("ContactLaw):", "object):", "one class derived from dynamics.contact.ContactLaw; found"),
        ("    width:", "    wid:", "parameters(...) failed: line 39: AttributeError"),
        ("softplus(t", "(", "SyntaxError"),
    ],
)
def test_a_wrong_file_is_one_sentence(ocp, law: Path, old: str, new: str, sentence: str) -> None:
    law.write_text(LAW.replace(old, new))
    done = ocp("solve", "planar-push", "--contact", law.name, "-q", *SHORT)
    assert done.code == 2 and sentence in done.err, done.err
    assert done.err.count("\n") == 1


def test_what_is_no_law_is_told(ocp, law: Path) -> None:
    assert "there is no such file" in ocp("solve", "wall-1d", "--contact", "none.py").err
    assert "no setting 'wdth'" in ocp("solve", "wall-1d", "--contact", law.name, "-c", "wdth=1").err
    assert "or give the path of a file" in ocp("solve", "wall-1d", "--contact", "logistik").err
    shown = ocp("settings", law.name).out
    assert "logistic (-c NAME=VALUE)" in shown and "width=0.01 (number > 0 [m]): scale" in shown


@pytest.mark.costly
def test_python_takes_the_file_too_and_sends_the_law_to_other_processes(law: Path) -> None:
    found = solve("push-1d", contact=str(law), contact_settings={"width": 0.05}, N=6)
    assert found.record["contact"] == "logistic"
    assert found.record["contact_source"] == str(law)
    made = contact_law(str(law), {"width": 0.05})
    again = pickle.loads(pickle.dumps(made))
    assert type(again) is type(made) and again.settings() == {"width": 0.05}
