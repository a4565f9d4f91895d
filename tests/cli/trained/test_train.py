"""``ocp train``, and the commands that read its runs: evaluate, report, animate, runs."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from ocp import store
from reports.cli.app import main
from tests.cli.conftest import Done, Ocp

SMALL = (
    "ball-throw",
    "-s",
    "samples=8",
    "-s",
    "rate=0.1",
    "-s",
    "episodes=3",
    "-s",
    "evaluate_every=2",
    "--iterations",
    "6",
)


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a store with two seeds of two algorithms, trained in parallel."""
    root = tmp_path_factory.mktemp("trained")
    asked = ["--seeds", "2", "-a", "fopg,zopg", "--jobs", "2", "--out", str(root), "--quiet"]
    assert main(["train", *SMALL, *asked]) == 0
    return root


def runs_of(root: Path) -> list[store.StoredRun]:
    found = [store.load(entry.path) for entry in store.list_runs(root)]
    return sorted(found, key=lambda run: (run.record["algorithm"], run.meta["seed"]))


def strict(done: Done) -> dict:
    assert done.code == 0, done.err
    return json.loads(done.out)


@pytest.mark.costly
def test_each_seed_of_each_algorithm_is_a_run(trained: Path) -> None:
    runs = runs_of(trained)
    made = [(run.kind, run.record["algorithm"], run.meta["seed"]) for run in runs]
    assert made == [("train", name, seed) for name in ("fopg", "zopg") for seed in (0, 1)]
    for run in runs:
        data, asked = run.data, run.record
        assert data.sizes["iteration"] == 7 and asked["iterations"] == 6
        assert asked["params"]["h"] == 0.02
        law = asked["contact"], asked["contact_settings"].get("law")
        assert law == (("adaptive", "quartic") if asked["algorithm"] == "fopg" else ("exact", None))
        assert asked["algorithm_settings"]["samples"] == 8
        judged = np.isfinite(data["evaluation_return"].values)
        assert list(np.flatnonzero(judged)) == [0, 2, 4, 6]
        assert list(data["env_steps"].values) == [400.0 * k for k in range(7)]
        assert (np.diff(data["wall_s"].values) >= 0).all() and data["wall_s"].units == "s"
        assert all("units" in variable.attrs for variable in data.data_vars.values())
        best = np.nanmax(data["evaluation_return"].values)
        assert run.meta["return"] == run.meta["evaluation"]["return"] == best
        assert run.meta["untrained"]["return"] == data["evaluation_return"].values[0] < best
    # Seeds share no random numbers, so that no two policies are equal.
    assert len({run.data["theta"].values.tobytes() for run in runs}) == 4


@pytest.mark.costly
def test_the_stored_episode_obeys_the_exact_law(trained: Path) -> None:
    from problems.library.ball_throw import Params, roll

    data = runs_of(trained)[0].data
    x, u, lam = (data[name].values[0] for name in ("x", "u", "lam"))
    assert x == pytest.approx(roll(Params(), *u[0]), abs=1e-7)
    assert list(data["time"].values) == pytest.approx(list(0.02 * np.arange(51)))
    # The floor's impulse is the change of momentum beyond gravity's.
    thrown = u[0, 1] * np.sin(u[0, 0]) + 9.81 * 0.02 / 2
    before = np.concatenate([[thrown], x[1:-1, 3]])
    assert lam[:, 0] == pytest.approx(x[1:, 3] - before + 0.02 * 9.81, abs=1e-7)
    assert lam.max() > 1.0


@pytest.mark.costly
def test_the_result_does_not_depend_on_the_number_of_jobs(trained: Path, ocp: Ocp) -> None:
    found = strict(ocp("train", *SMALL, "--seeds", "2", "-a", "fopg,zopg", "--jobs", "1", "--json"))
    assert [run["hash"] for run in found["runs"]] == [r.meta["hash"] for r in runs_of(trained)]
    mean = np.mean([run["return"] for run in found["runs"][:2]])
    assert found["groups"][0]["return_mean"] == pytest.approx(mean)
    assert [group["label"] for group in found["groups"]] == ["fopg adaptive", "zopg exact"]


@pytest.mark.costly
def test_evaluate_says_first_what_the_policy_is_worth(trained: Path, ocp: Ocp) -> None:
    run = runs_of(trained)[0]
    done = ocp("evaluate", str(run.path), "--episodes", "3", "--json")
    found, own = strict(done), run.meta["evaluation"]
    # The throw always starts in the same state, so that any episodes give the result of training.
    assert found["return"]["mean"] == pytest.approx(own["return"], rel=1e-12)
    assert found["own"] == own and found["contact"] == "exact"
    assert found["length"] == {
        "mean": 50,
        "interval": [50, 50],
        "least": 50,
        "most": 50,
        "unit": "1",
    }
    assert (found["fallen"], found["unsolved"]) == (0, 0)
    assert done.err.splitlines()[0] == found["verdict"]
    softened = strict(ocp("evaluate", str(run.path), "--contact", "barrier", "-c", "mu=0.1", "--json"))
    assert softened["return"]["mean"] != pytest.approx(own["return"], rel=1e-3)
    alone = strict(ocp("evaluate", str(run.path), "--episodes", "1", "--json"))
    assert alone["return"]["interval"] is None


@pytest.mark.costly
def test_a_trained_run_is_reported_animated_and_listed(trained: Path, ocp: Ocp) -> None:
    paths = [str(run.path) for run in runs_of(trained)]
    assert ocp("report", *paths, "-o", "all.pdf").code == 0
    assert ocp("report", paths[0], "-o", "one.pdf").code == 0
    assert Path("all.pdf").read_bytes()[:5] == Path("one.pdf").read_bytes()[:5] == b"%PDF-"
    shown = strict(ocp("animate", paths[0], "-o", "a.gif", "--fps", "10", "--json"))
    assert shown["panels"] == ["the policy of fopg under the exact law"]
    assert shown["duration_s"] == pytest.approx(1.0)
    listed = strict(ocp("runs", "--out", str(trained), "--json"))["runs"]
    assert {(entry["algorithm"], entry["seed"]) for entry in listed} == {
        (name, seed) for name in ("fopg", "zopg") for seed in (0, 1)
    }
    table = ocp("runs", "--out", str(trained)).out
    assert table.count("return -") == 4
    for seed in (0, 1):
        assert f"train, fopg, seed {seed}, adaptive" in table
        assert f"train, zopg, seed {seed}, exact" in table
    assert "algorithm_settings" in ocp("runs", paths[0]).out


def test_what_takes_no_policy_says_what_does(ocp: Ocp) -> None:
    small = ("-s", "samples=2", "-p", "horizon=3", "--iterations", "1")
    assert ocp("train", "ball-throw", *small).code == 0
    for command in (["replay", "@last"], ["export", "@last", "-o", "a.c"]):
        done = ocp(*command)
        assert done.code == 2 and done.out == ""
        assert "ocp evaluate" in done.err


def test_what_can_be_trained_is_told(ocp: Ocp) -> None:
    told = ocp("train", "--help").out
    for words in ("half-cheetah", "fopg:", "smoothing=rollout", "discount=1", "hidden=affine"):
        assert words in told, words
    listed = strict(ocp("list", "--json"))
    assert {"ball-throw", "hopper"} <= {task["name"] for task in listed["tasks"]}
    assert {"fopg", "ars"} <= {algorithm["name"] for algorithm in listed["algorithms"]}


@pytest.mark.costly
def test_physical_parameters_are_learned_beside_the_policy(ocp: Ocp) -> None:
    """From throws the restitution, initially 0.4, is learned to be 0.7; gravity is known."""
    asked = ("-s", "psi=restitution", "-s", "psi.restitution=0.4", "-s", "psi.steps=50")
    found = strict(ocp("train", *SMALL, *asked, "-s", "psi.search_iterations=40", "--json"))
    run = store.load(Path(found["runs"][0]["run"]))
    psi = dict(zip(run.data["physical"].values, run.data["psi"].values, strict=True))
    assert psi["restitution"] == pytest.approx(0.7, abs=0.01) and psi["g"] == 9.81
    assert run.record["algorithm_settings"]["of"] == "fopg"
    assert found["groups"][0]["label"] == "fopg with psi"
    judged = strict(ocp("evaluate", str(run.path), "--episodes", "3", "--json"))
    assert judged["return"]["mean"] == pytest.approx(run.meta["return"], rel=1e-12)
