"""Tab completion offers valid values: problems, laws, settings, parameters, figures."""

from __future__ import annotations

import pytest

from reports.cli.app import main

ASKED = {
    "ocp so": ["solve"],
    "ocp solve pu": ["push-1d", "push-box", "push-cube", "push-disc", "push-t"],
    "ocp solve push-disc --contact bar": ["barrier"],
    "ocp solve push-disc --contact barrier -c ": ["mu=", "kappa="],
    "ocp solve push-disc -p goal": ["goal_x=", "goal_y="],
    "ocp solve push-disc -s max_it": ["max_iter="],
    "ocp solve push-disc --method sin": ["single-shooting"],
    "ocp figure N": ["N0", "N1", "N2", "N3"],
    "ocp report @": ["@last"],
    "ocp solve no-such-problem -p ": [],
}


@pytest.mark.parametrize(("line", "words"), ASKED.items(), ids=list(ASKED))
def test_completion(line: str, words: list[str], monkeypatch, capfd) -> None:
    monkeypatch.setenv("_OCP_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", line)
    monkeypatch.setenv("COMP_CWORD", str(len(line.split(" ")) - 1))
    assert main([]) == 0
    found = capfd.readouterr()
    assert sorted(found.out.split()) == sorted(words)
    assert found.err == ""
