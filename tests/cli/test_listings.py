"""Output of the commands that list runs, problems, tasks and this machine."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import pytest

from dynamics.laws import LAWS
from problems import names, spec
from problems.registry import arena_names
from problems.tasks import registry as tasks
from tests.cli.test_commands import strict


@pytest.mark.costly
def test_a_run_is_named_by_a_part_of_its_name(ocp, store_of_runs: Path) -> None:
    several = ocp("runs", "push", "--out", str(store_of_runs))
    assert several.code == 2 and "give more" in several.err
    run = next((store_of_runs / "push-1d").iterdir())
    found = strict(ocp("runs", run.name[-10:], "--out", str(store_of_runs), "--json").out)
    assert found["run"] == str(run)
    assert found["problem"] == "push-1d"


@pytest.mark.costly
def test_runs_lists_the_damaged_ones_too(ocp, store_of_runs: Path) -> None:
    listed = strict(ocp("runs", "--out", str(store_of_runs), "--json").out)["runs"]
    assert sorted(entry["problem"] for entry in listed) == [
        "push-1d",
        "push-1d",
        "push-disc",
        "wall-1d",
        "wall-1d",
    ]
    assert all(entry["damage"] is None for entry in listed)
    ocp("solve", "wall-1d", "--contact", "barrier", "--quiet")
    meta = next(Path("runs").rglob("meta.json"))
    meta.write_text("{")
    damaged = ocp("runs", "--json")
    assert damaged.code == 0
    assert "meta.json" in strict(damaged.out)["runs"][0]["damage"]
    assert "damaged" in ocp("runs").out


def test_list_of_one_kind_has_no_other(ocp) -> None:
    found = strict(ocp("list", "arena", "--json").out)
    assert list(found) == ["arena"]
    assert [item["name"] for item in found["arena"]] == arena_names()
    assert all(line.startswith(" ") for line in ocp("list", "arena").out.splitlines()[1:])
    refused = ocp("list", "arenas")
    assert refused.code == 2 and "unknown kind 'arenas'" in refused.err and "arena," in refused.err


def test_list_json(ocp) -> None:
    found = strict(ocp("list", "--json").out)
    assert set(found) >= {"problems", "contacts", "methods", "policies", "solvers", "figures"}
    assert [item["name"] for item in found["problems"]] == names()
    assert [item["name"] for item in found["tasks"]] == tasks.names()
    assert [item["name"] for item in found["contacts"]] == list(LAWS)
    for kind, wanted in {
        "methods": {"direct", "multiple-shooting", "single-shooting"},
        "policies": {"open-loop", "feedback"},
        "solvers": {"ipopt", "fatrop", "uno", "sleqp"},
    }.items():
        assert {item["name"] for item in found[kind]} == wanted
    assert all(item["summary"] for items in found.values() for item in items)


@pytest.mark.one_case_in(4)
@pytest.mark.parametrize("name", names())
def test_show(ocp, name: str) -> None:
    found = strict(ocp("show", name, "--json").out)
    assert found["equations"]
    assert {p["name"]: p["value"] for p in found["parameters"]} == spec(name).params({}).model_dump()
    assert all(parameter["unit"] for parameter in found["parameters"])
    text = ocp("show", name).out
    unwrapped = " ".join(text.split())
    assert all(" ".join(line.split()) in unwrapped for line in found["equations"])
    assert "Source: " in text
    for key, golden in spec(name).golden.items():
        assert found["golden"][key] == asdict(golden)
        assert f"{key} {golden.method} {golden.cost:.9g} {golden.certificate}" in unwrapped
        assert golden.remarks in unwrapped
    assert "…" not in text


@pytest.mark.parametrize("name", tasks.names())
def test_show_tells_of_the_task_of_that_name_too(ocp, name: str) -> None:
    found = strict(ocp("show", name, "--json").out)["task"]
    expected = tasks.spec(name).params({}).model_dump()
    assert {p["name"]: p["value"] for p in found["parameters"]} == expected
    text = " ".join(ocp("show", name).out.split())
    assert f"The learning task {name}: {tasks.spec(name).title}" in text
    assert found["equations"]
    assert all(" ".join(line.split()) in text for line in found["equations"])
    assert "…" not in text
    assert strict(ocp("show", "wall-1d", "--json").out)["task"] is None


def test_doctor_json(ocp) -> None:
    found = strict(ocp("doctor", "--json").out)
    assert set(found["roots"].values()) == {found["root"]}
    assert found["solvers"]["ipopt"] is True
    assert found["linear_solvers"]["mumps"] is True
    assert {"casadi", "numpy", "python", "centralpath"} <= set(found["versions"])
    assert found["threads"] >= 1


def test_doctor_clears_the_cache_and_counts(ocp, tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    objects = tmp_path / "cache" / "centralpath" / "objects"
    objects.mkdir(parents=True, mode=0o700)
    for name in ("one", "two"):
        (objects / f"{name}.so").write_bytes(b"kernel")
    assert strict(ocp("doctor", "--json").out)["kernels"]["objects"] == 2
    done = ocp("doctor", "--clear-cache", "--json")
    assert strict(done.out)["cleared"] == 2
    assert strict(done.out)["kernels"]["objects"] == 0
    assert list(objects.iterdir()) == []
    again = ocp("doctor", "--clear-cache")
    assert "0 compiled objects removed from the kernel cache" in again.out


def test_doctor_refuses_two_roots() -> None:
    from ocp.errors import InputError
    from reports.cli.doctor_command import common_root

    with pytest.raises(InputError, match="reports from /elsewhere"):
        common_root({"ocp": "/here", "reports": "/elsewhere"})
