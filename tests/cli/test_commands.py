"""Output of the commands: documented keys, and strict JSON."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from problems import spec

SOLVE_KEYS = {
    "problem",
    "contact",
    "method",
    "policy",
    "solver",
    "status",
    "success",
    "cost",
    "exact_cost",
    "iterations",
    "build_s",
    "solve_s",
    "evaluation_s",
    "solver_s",
    "iteration_s",
    "complementarity",
    "complementarity_min",
    "dynamics_residual",
    "penetration",
    "run",
    "params",
    "seed",
    "versions",
}
POINT_KEYS = {"value", "status", "success", "cost", "exact_cost", "iterations", "complementarity"}
TIMES = {
    "certificate_s",
    "build_s",
    "solve_s",
    "audit_s",
    "seconds",
    "evaluation_s",
    "solver_s",
    "iteration_s",
    "run",
    "pdf",
    "created",
}


def strict(text: str) -> Any:
    """Return the parsed JSON document, which must not contain NaN or infinity."""

    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is not JSON")

    return json.loads(text, parse_constant=refuse)


def without_times(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: without_times(item) for key, item in value.items() if key not in TIMES}
    return [without_times(item) for item in value] if isinstance(value, list) else value


@pytest.mark.costly
def test_solve_json(ocp) -> None:
    done = ocp(
        "solve",
        "wall-1d",
        "--contact",
        "barrier",
        "-c",
        "mu=1e-3",
        "-p",
        "m=2",
        "--seed",
        "3",
        "--json",
    )
    assert done.code == 0
    found = strict(done.out)
    assert set(found) >= SOLVE_KEYS
    assert (found["problem"], found["contact"], found["method"]) == ("wall-1d", "barrier", "direct")
    assert (found["status"], found["success"], found["seed"]) == ("solved", True, 3)
    assert found["params"] == spec("wall-1d").params({"m": 2.0}).model_dump()
    assert found["complementarity"] == pytest.approx(1e-3, rel=1e-6), "lam gap = mu"
    assert found["iterations"] == sum(stage["iterations"] for stage in found["stages"])
    assert Path(found["run"]).is_dir()
    assert "Solved" in done.err, "people's lines go to stderr"


@pytest.mark.costly
def test_the_split_of_the_time_adds_up(ocp) -> None:
    done = ocp("solve", "wall-1d", "--contact", "barrier", "--json")
    found = strict(done.out)
    assert found["evaluation_s"] + found["solver_s"] == pytest.approx(found["solve_s"], rel=1e-12)
    spent = [stage["evaluation_s"] for stage in found["stages"]]
    assert all(0 < s < stage["seconds"] for s, stage in zip(spent, found["stages"], strict=True))
    assert found["evaluation_s"] == pytest.approx(sum(spent), rel=1e-12)
    each = found["iteration_s"]
    assert each["evaluation"] * found["iterations"] == pytest.approx(found["evaluation_s"])
    assert each["solver"] * found["iterations"] == pytest.approx(found["solver_s"])
    assert "ms per iteration" in done.err
    stored = strict(ocp("runs", found["run"], "--json").out)
    assert stored["evaluation_s"] == found["evaluation_s"]


def test_a_failure_keeps_its_run_and_says_so(ocp) -> None:
    """From a guess without contact, shooting under the exact law has no gradient."""
    done = ocp(
        "solve", "push-1d", "--contact", "exact", "--method", "single-shooting", "-s", "homotopy=false", "--json"
    )
    found = strict(done.out)
    assert done.code == 3
    assert (found["success"], found["status"]) == (False, "no-progress")
    assert "no-progress" in done.err.lower() and "homotopy" in done.err
    assert Path(found["run"]).is_dir()


def test_a_failure_names_the_worst_constraints(ocp) -> None:
    done = ocp(
        "solve",
        "push-disc",
        "--contact",
        "barrier",
        "-s",
        "max_iter=3",
        "-s",
        "homotopy=false",
        "--json",
    )
    found = strict(done.out)
    assert done.code == 3
    assert found["status"] == "iteration-limit"
    assert found["worst"]
    first = found["worst"][0]
    assert first["name"] in done.err and first["component"] in done.err
    assert first["amount"] == max(item["amount"] for item in found["worst"])


@pytest.mark.costly
def test_a_rerun_gives_identical_json_but_for_times(ocp) -> None:
    arguments = ["solve", "cart-walls", "--contact", "exact", "--starts", "3", "--json", "--quiet"]
    first, second = (strict(ocp(*arguments).out) for _ in range(2))
    assert without_times(first) == without_times(second)
    assert first["hash"] == second["hash"]
    assert len(first["others"]) == 3
    other = strict(ocp(*arguments, "--seed", "1").out)
    assert other["hash"] != first["hash"]


@pytest.mark.costly
def test_continue_json(ocp) -> None:
    done = ocp(
        "continue",
        "wall-1d",
        "--contact",
        "barrier",
        "--over",
        "contact.mu",
        "--from",
        "1e-1",
        "--to",
        "1e-4",
        "--scale",
        "log",
        "--steps",
        "3",
        "--json",
    )
    assert done.code == 0
    found = strict(done.out)
    assert set(found) >= {"points", "iterations", "nlp_builds", "run"}
    assert all(set(point) >= POINT_KEYS for point in found["points"])
    assert [point["value"] for point in found["points"]] == pytest.approx([1e-1, 1e-2, 1e-3, 1e-4])
    for point in found["points"]:
        assert point["complementarity"] == pytest.approx(point["value"], rel=1e-5)
    assert found["iterations"] >= sum(point["iterations"] for point in found["points"])
    assert found["events"] == []
    assert found["nlp_builds"] == 1
    listed = strict(ocp("runs", "--json").out)["runs"]
    assert [entry["kind"] for entry in listed] == ["continue"]


@pytest.mark.costly
def test_events_are_told_by_every_output_of_a_continuation(ocp) -> None:
    done = ocp(
        "continue",
        "planar-push",
        "--contact",
        "exact",
        "--over",
        "goal_x",
        "--from",
        "0.3",
        "--to",
        "0.35",
        "--steps",
        "1",
        "--json",
    )
    found = strict(done.out)
    event = next(event for event in found["events"] if event["kind"] == "contact")
    assert (event["contact"], event["change"], event["steps"]) == ("push+", "opens", [2])
    assert 0.3 < event["value"] < 0.35
    assert event["cost"] == pytest.approx(85.805682, rel=1e-6)
    assert f"1 contact event: 'push+' opens at step 2 (goal_x = {event['value']:.6g})" in (found["verdict"])
    assert "push+ opens" in done.err


@pytest.mark.costly
def test_replay_json(ocp, store_of_runs: Path) -> None:
    done = ocp("replay", "wall-1d", "--out", str(store_of_runs / "..missing"), "--json")
    assert done.code == 2
    run = str(next(p for p in (store_of_runs / "wall-1d").iterdir() if "record" in describe(p)))
    plan = describe(Path(run))
    exact = strict(ocp("replay", run, "--json").out)
    assert exact["cost"] == pytest.approx(plan["audit"]["exact_cost"], rel=1e-12)
    assert exact["state_gap"] == pytest.approx(plan["audit"]["state_gap"], rel=1e-9)
    same = strict(ocp("replay", run, "--contact", "barrier", "-c", "mu=1e-3", "--json").out)
    assert same["cost"] == pytest.approx(plan["cost"], rel=1e-6), "under its own law it is itself"
    assert same["state_gap"] < 1e-6
    wide = strict(ocp("replay", run, "--contact", "barrier", "-c", "mu=1", "--json").out)
    assert wide["state_gap"] > 0.1


def describe(run: Path) -> dict[str, Any]:
    meta = json.loads((run / "meta.json").read_text())
    return meta if meta["kind"] == "solve" else {}


@pytest.mark.costly
def test_replay_of_a_feedback_policy(ocp, store_of_runs: Path) -> None:
    found = strict(ocp("replay", "push-disc", "--out", str(store_of_runs), "--json").out)
    assert found["inputs"] == "feedback"
    assert len(found["final_state"]) == 3
    plan = describe(Path(found["run"]))
    assert found["cost"] == pytest.approx(plan["audit"]["exact_cost"], rel=1e-9)
