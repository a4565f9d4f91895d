"""``ocp solve`` and ``ocp.solve`` take the same arguments and store the same runs to the last bit."""

from __future__ import annotations

import inspect
import re
from dataclasses import asdict, fields, replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from dynamics.contact import Barrier, Exact, Randomized
from ocp import (
    Direct,
    Feedback,
    InputError,
    MultipleShooting,
    OpenLoop,
    Solution,
    load,
    roll_out,
    save,
    solve,
    store,
)
from ocp.store.json_values import to_json
from problems import get, spec
from reports.cli.options.shared import SolverOptions

LAWS: dict[str, dict[str, Any]] = {
    "exact": {},
    "barrier": {"mu": 0.002},
    "adaptive": {"sigma": 0.03},
    "randomized": {"sigma": 0.05, "samples": 4},
}
SMALL: dict[str, dict[str, Any]] = {
    "push-1d": {"N": 5, "goal_x": 0.7},
    "wall-1d": {"N": 5},
    "push-disc": {"N": 4, "M": 2.5},
}


def words(option: str, values: dict[str, Any]) -> list[str]:
    return [word for key, value in values.items() for word in (option, f"{key}={value}")]


def stored_hash(solution: Solution, root: Path) -> str:
    return store.load(save(solution, root)).meta["hash"]


@pytest.fixture(scope="module")
def pushed() -> Solution:
    return solve("push-disc", "barrier", mu=1e-3, N=6)


@pytest.mark.costly
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("name", SMALL)
def test_python_stores_what_the_command_line_stores(ocp, tmp_path, name: str, law: str) -> None:
    """The hash in a run's name covers all arrays and the description except times."""
    given = words("-p", SMALL[name]) + words("-c", LAWS[law])
    told = ocp("solve", name, "--contact", law, *given, "--json").json
    solution = solve(name, contact=law, **SMALL[name], **LAWS[law])
    line, python = store.load(told["run"]), store.load(save(solution, tmp_path / "python"))
    assert python.meta["hash"] == line.meta["hash"]
    drop = [key for key in line.data.data_vars if "seconds" in str(key)]
    xr.testing.assert_identical(python.data.drop_vars(drop), line.data.drop_vars(drop))
    assert solution.cost == told["cost"]


@pytest.mark.costly
def test_method_policy_and_settings_are_those_of_the_command_line(ocp, tmp_path) -> None:
    told = ocp(
        "solve",
        "push-disc",
        "--contact",
        "barrier",
        "-p",
        "N=4",
        "-p",
        "scenarios=2",
        "--method",
        "multiple-shooting",
        "--policy",
        "feedback",
        "-s",
        "policy.penalty=0.01",
        "-s",
        "max_iter=200",
        "--json",
    ).json
    named = solve(
        "push-disc",
        method="multiple-shooting",
        policy="feedback",
        params={"N": 4, "scenarios": 2},
        settings={"policy.penalty": 0.01, "max_iter": 200},
    )
    made = solve(
        get("push-disc", N=4, scenarios=2),
        Barrier(),
        MultipleShooting(),
        Feedback(0.01),
        settings={"max_iter": "200"},
    )
    assert {stored_hash(named, tmp_path), stored_hash(made, tmp_path)} == {told["hash"]}


@pytest.mark.costly
def test_names_objects_keywords_and_dicts_say_the_same(tmp_path) -> None:
    law = {"sigma": 0.05, "samples": 4, "base": "barrier", "base.mu": 0.01}
    made = Randomized(0.05, 4, base=Barrier(mu=0.01))
    answers = [
        solve("wall-1d", "randomized", contact_settings=law, N=3),
        solve(spec("wall-1d"), "randomized", sigma=0.05, samples=4, base=Barrier(0.01), N=3),
        solve("wall-1d", made, "direct", "open-loop", params={"N": 3}),
        solve(get("wall-1d", N=3), contact=made, method=Direct(), policy=OpenLoop()),
    ]
    assert len({stored_hash(one, tmp_path) for one in answers}) == 1


def test_a_file_is_a_problem(tmp_path) -> None:
    file = tmp_path / "mine.py"
    file.write_text(Path(inspect.getfile(spec("wall-1d").build)).read_text())
    found = solve(file, N=3)
    assert found.record["source"] == str(file) and found.data.sizes["interval"] == 3
    np.testing.assert_array_equal(found.data["x"], solve("wall-1d", N=3).data["x"])


def test_the_defaults_are_those_of_the_command_line() -> None:
    line = {field.name: field.default for field in fields(SolverOptions)}
    python = {key: one.default for key, one in inspect.signature(solve).parameters.items()}
    same = ("contact", "method", "policy", "solver", "seed")
    assert {key: line[key] for key in same} == {key: python[key] for key in same}


@pytest.mark.parametrize(
    ("line", "python"),
    [
        (["push-disk"], {"problem": "push-disk"}),
        (["heaviside"], {"problem": "heaviside"}),
        (["wall-1d", "--contact", "barier"], {"contact": "barier"}),
        (["wall-1d", "-c", "muu=1"], {"contact_settings": {"muu": 1}}),
        (["wall-1d", "--contact", "barrier", "-c", "mu=-1"], {"contact": "barrier", "mu": -1}),
        (["wall-1d", "--contact", "barrier", "-c", "mu=x"], {"contact": "barrier", "mu": "x"}),
        (["wall-1d", "-p", "Nn=3"], {"params": {"Nn": 3}}),
        (["wall-1d", "--method", "dirct"], {"method": "dirct"}),
        (["wall-1d", "--policy", "feedbak"], {"policy": "feedbak"}),
        (["wall-1d", "--solver", "ipop"], {"solver": "ipop"}),
        (["wall-1d", "-s", "stratgy=scholtes"], {"settings": {"stratgy": "scholtes"}}),
        (["wall-1d", "-s", "max_itr=3"], {"settings": {"max_itr": 3}}),
        (["wall-1d", "-s", "policy.penalty=1"], {"settings": {"policy.penalty": 1}}),
    ],
    ids=lambda given: " ".join(given[1:] or given) if isinstance(given, list) else "",
)
def test_what_is_wrong_is_told_in_the_same_words(ocp, line, python) -> None:
    told = ocp("solve", *line)
    assert told.code == 2
    with pytest.raises(InputError) as refused:
        solve(**{"problem": "wall-1d", **python})
    assert told.err == f"error: {refused.value}\n"


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        (
            {"problem": "planar-hand", "contact": "randomized", "base": 0.1},
            "base is a parameter of planar-hand and a setting of the randomized law; say"
            " params={'base': ...} or contact_settings={'base': ...}",
        ),
        (
            {"contact": "barrier", "muu": 1e-3},
            "solve has no argument 'muu' (did you mean 'mu'?); the barrier law takes mu, kappa; wall-1d takes",
        ),
        (
            {"contact": "barrier", "mu": 1.0, "contact_settings": {"mu": 2.0}},
            "mu is given twice; give it once",
        ),
        ({"max_iter": 3}, "max_iter is not an argument of solve; use settings={'max_iter': ...}"),
        ({"contact": Exact(), "mu": 1.0}, "the law is already built; pass mu to Exact(...)"),
        (
            {"contact": Exact(), "contact_settings": {"mu": 1.0}},
            "mu cannot be set: the law is made already; give it to Exact(...)",
        ),
        ({"problem": get("wall-1d"), "m": 2.0}, "the problem is already built; pass m to problems"),
        (
            {"problem": get("wall-1d"), "params": {"m": 2.0}},
            "m cannot be set: wall-1d is already built",
        ),
        ({"problem": 3}, "a problem is a name, a file or an ocp.Problem, got int"),
        (
            {"policy": Feedback(), "settings": {"policy.penalty": 1.0}},
            "penalty cannot be set: the policy is made already; give it to Feedback(...)",
        ),
    ],
    ids=lambda given: "" if isinstance(given, dict) else given[:24],
)
def test_whose_a_keyword_is(given: dict[str, Any], sentence: str) -> None:
    with pytest.raises(InputError, match=re.escape(sentence)):
        solve(**{"problem": "wall-1d", **given})


def test_a_solution_tells_itself_in_one_line(pushed: Solution) -> None:
    text = repr(pushed)
    assert text.startswith("<Solution of push-disc, barrier mu=0.001, direct, open-loop: Solved:")
    assert f"cost {pushed.cost:.6g}" in text and "\n" not in text and len(text) < 160


class Checked(HTMLParser):
    """Parser that checks that tags are closed in order and that nothing is loaded from other servers."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.sources: list[str] = []
        self.text: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.sources += [value or "" for key, value in attrs if key in ("src", "href")]
        if tag not in ("img", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text.append(data)


def test_a_notebook_shows_verdict_and_strobe_offline(pushed: Solution) -> None:
    page = Checked()
    page.feed(pushed._repr_html_())
    page.close()
    assert page.open == []
    assert [source[:26] for source in page.sources] == ["data:image/svg+xml;base64,"]
    headline, *_ = pushed.verdict.split("\n")
    assert headline in page.text and "barrier, contact.mu = 0.001" in page.text


def test_a_solution_comes_back_from_the_store(pushed: Solution, tmp_path) -> None:
    again = load(save(pushed, tmp_path))
    xr.testing.assert_identical(again.data, pushed.data)
    assert repr(again) == repr(pushed) and again.verdict == pushed.verdict
    for part in ("audit", "certificate", "referee"):
        ours, theirs = (to_json(asdict(getattr(one, part))) for one in (again, pushed))
        assert ours == theirs
    assert again.problem.parameters.defaults == pushed.problem.parameters.defaults
    own = pushed.replay("barrier", mu=1e-3)
    xr.testing.assert_identical(again.replay("barrier", mu=1e-3).data, own.data)


def test_runs_are_named_and_kept_as_on_the_command_line(ocp, pushed: Solution, tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("OCP_RUNS", str(tmp_path / "kept"))
    run = save(pushed, tags=["first"])
    assert run.parent.parent == tmp_path / "kept"
    assert repr(load("@last")) == repr(load(run.name[-6:])) == repr(pushed)
    (listed,) = ocp("runs", "--tag", "first", "--json").json["runs"]
    assert listed["run"] == str(run)


def test_a_problem_of_ones_own_is_handed_to_load(tmp_path) -> None:
    mine = replace(get("wall-1d", N=3), name="mine")
    run = save(solve(mine), tmp_path)
    with pytest.raises(InputError, match=r"a problem built in Python.*problem="):
        load(run)
    assert load(run, mine).problem is mine


def test_a_replay_is_labelled_and_measured(pushed: Solution) -> None:
    replay = pushed.replay("barrier", mu=1e-2)
    plan, data = pushed.data, replay.data
    rolled = roll_out(pushed.problem, plan["u"].values, pushed.values, Barrier(mu=1e-2))
    np.testing.assert_array_equal(data["x"], rolled.x)
    np.testing.assert_allclose(data["lam"] * data["gap"], 1e-2, rtol=1e-8)
    assert list(data["state"].values) == list(plan["state"].values)
    assert data["x"].attrs == plan["x"].attrs and data["time"].equals(plan["time"])
    assert replay.cost == rolled.cost and replay.planned_cost == pushed.cost
    assert replay.state_gap == abs(rolled.x - plan["x"].values).max() > 0
    assert repr(replay).startswith("<Replay of push-disc under barrier, open-loop: cost")


@pytest.mark.costly
def test_pictures_and_pages_of_a_solution(pushed: Solution, tmp_path) -> None:
    assert pushed.report(tmp_path / "one.pdf").read_bytes().startswith(b"%PDF")
    assert pushed.animate(tmp_path / "one.gif", fps=4).read_bytes().startswith(b"GIF89a")
    strobe, *panels = pushed.plot().axes
    assert strobe.get_xlabel() == spec("push-disc").axes[0] and strobe.patches
    planned = [line.get_ydata() for panel in panels for line in panel.lines]
    for state in pushed.data["x"].values[0].T:
        assert any(np.array_equal(line, state) for line in planned)
