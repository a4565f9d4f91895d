"""The run store: stored runs are read back complete or not at all."""

from __future__ import annotations

import json
import math
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from dynamics.contact import Barrier
from ocp import solve, store
from ocp.errors import DamagedRun, InputError, NotWritten
from ocp.judge.audit import Audit
from ocp.judge.certificate import Certificate, ContactChange
from ocp.judge.constraints import Violation
from ocp.judge.findings import make_finding
from ocp.judge.measures import Worst
from ocp.judge.referee import RefereeReport
from ocp.judge.route_report import Attempt, RouteReport
from ocp.labelled import LabelledArrays
from ocp.programs.solver import Status
from ocp.routes.homotopy import StageRecord
from ocp.solution import Solution
from ocp.store import atomic
from problems import get
from tests.resealed import reseal


def dataset(shift: float = 0.0) -> xr.Dataset:
    x = np.linspace(0, 1, 6).reshape(1, 3, 2) + shift
    return xr.Dataset(
        {
            "x": (("scenario", "node", "state"), x, {"units": "see state"}),
            "lam": (("scenario", "interval"), [[0.0, math.nan]], {"units": "N s"}),
        },
        coords={"state": ["q", "v"], "time": ("node", [0.0, 0.1, 0.2], {"units": "s"})},
    )


def solution(seconds: float = 1.0, cost: float = 2.5) -> Solution:
    audit = Audit(
        complementarity=1e-9,
        complementarity_min=1e-9,
        dynamics_residual=1e-12,
        law_residual=0.0,
        constraint_violation=0.0,
        penetration=0.0,
        exact_penetration=math.nan,
        exact_cost=math.inf,
        state_gap=0.0,
        active_steps=3,
        task_gradient=0.5,
        worst=[Violation("dynamics", "q", 0, 2, 1e-12)],
    )
    stage = StageRecord("contact.mu", 1e-3, 2.5, 1e-3, 1e-9, 7, seconds, "solved")
    record = {"problem": "toy", "contact": "exact", "seed": 4, "law_parameters": {"contact.mu": 1e-3}}
    problem = get("wall-1d")
    values = dict(zip(problem.parameters.names, problem.parameters.values.tolist(), strict=True))
    certificate = Certificate("not", moves=[ContactChange("opening contact", "wall", 0, 2, 4)])
    refereed = RefereeReport(
        3.0,
        0.5,
        "true gaps",
        findings=[make_finding("costs-more-at-quarter-step", cost=3.0)],
        force_distance=Worst(0.1, "wall", 0, 2),
        nonuniqueness="the contact forces at step 1 are not unique",
        branch_cost=27.5,
    )
    return Solution(
        LabelledArrays.of(dataset()),
        cost,
        Status.SOLVED,
        audit,
        certificate,
        refereed,
        9.0,
        [stage],
        7,
        seconds,
        2 * seconds,
        record,
        problem=problem,
        values={**values, "contact.mu": 1e-3},
        route=RouteReport(
            "law path",
            [Attempt(1, "solved", 3.0, 3.5, 4.0, 9, True)],
            "0123456789",
            failures=["RuntimeError: x"],
            audit_s=seconds,
        ),
    )


def test_a_solution_survives_the_disk(tmp_path: Path) -> None:
    original = solution()
    run = store.load(store.save(original, tmp_path, ["ocp", "solve", "toy"]).path)
    again = run.solution(original.problem)
    xr.testing.assert_identical(again.data, original.data)
    assert again.stages == original.stages
    assert again.record == original.record
    assert again.route == original.route and again.run_hash == run.meta["hash"]
    assert again.values == {p.name: p.value for p in original.problem.parameters}
    assert run.meta["verdict"] == original.verdict
    assert (again.cost, again.status, again.iterations) == (2.5, Status.SOLVED, 7)
    assert again.audit.worst == original.audit.worst
    assert replace(again.referee, refined_cost=0.0) == replace(original.referee, refined_cost=0.0)
    assert again.certificate.moves == original.certificate.moves
    assert (again.certificate.stationarity, again.idle_cost) == ("not", 9.0)
    assert math.isnan(again.audit.exact_cost), "what JSON cannot hold comes back as NaN"
    assert run.meta["argv"] == ["ocp", "solve", "toy"]
    assert run.meta["seed"] == 4
    assert {"python", "casadi", "numpy"} <= set(run.meta["versions"])


@pytest.mark.costly
def test_threads_of_a_process_may_load_and_save_at_once(tmp_path: Path) -> None:
    kept = store.save(solution(), tmp_path, []).path

    def load(turn: int) -> bool:
        path = store.save(solution(), tmp_path, []).path if turn % 8 == 0 else kept
        return store.load(path).data.identical(solution().data)

    with ThreadPoolExecutor(4) as pool:
        assert all(pool.map(load, range(80)))


def test_meta_is_strict_json(tmp_path: Path) -> None:
    path = store.save(solution(), tmp_path, []).path

    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is not JSON")

    meta = json.loads((path / "meta.json").read_text(), parse_constant=refuse)
    assert meta["audit"]["exact_cost"] is None
    assert meta["schema"] == store.SCHEMA


def test_the_hash_tells_content_and_ignores_times(tmp_path: Path) -> None:
    def stored(what: Solution, argv: list[str]) -> str:
        return store.load(store.save(what, tmp_path, argv).path).meta["hash"]

    first = stored(solution(seconds=1.0), ["a"])
    assert stored(solution(seconds=9.0), ["b"]) == first
    assert stored(solution(cost=2.6), ["a"]) != first
    assert stored(solution().with_data(dataset(1e-15)), ["a"]) != first
    renamed = dataset().rename({"x": "y"})
    assert stored(solution().with_data(renamed), ["a"]) != first


def test_identical_runs_in_one_second_are_both_kept(tmp_path: Path) -> None:
    paths = {store.save(solution(), tmp_path, []).path for _ in range(4)}
    assert len(paths) == 4
    assert {entry.path for entry in store.list_runs(tmp_path)} == paths


def test_nothing_but_the_two_files(tmp_path: Path) -> None:
    path = store.save(solution(), tmp_path, []).path
    assert {file.name for file in path.iterdir()} == {"solution.nc", "meta.json"}
    assert [child.name for child in path.parent.iterdir()] == [path.name]


def test_a_name_cannot_leave_the_store(tmp_path: Path) -> None:
    data = dataset()
    path = store.write_run(tmp_path / "runs", "../evil name/..", data, {"kind": "continue"}).path
    assert path.parent.parent == tmp_path / "runs"


def test_a_missing_run_is_wrong_usage(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no run"):
        store.load(tmp_path / "nothing")


def test_a_study_is_no_solution(tmp_path: Path) -> None:
    told = {"argv": [], "record": {}, "status": "done", "verdict": "All hold.", "claims": []}
    path = store.write_run(tmp_path, "toy", dataset(), {"kind": "figure", **told}).path
    with pytest.raises(InputError, match="figure"):
        store.load(path).solution(get("wall-1d"))


def test_survival_follows_from_the_findings(tmp_path: Path) -> None:
    """A run stores whether its plan survives beside the findings that say why not; both must agree."""
    path = store.save(solution(), tmp_path, []).path
    referee = store.load(path).meta["referee"]
    assert (referee["survives"], referee["survives_at_h"]) == (False, False) and referee["reasons"] == ["it costs 3"]
    reseal(path, lambda meta: meta["referee"].update(survives=True))
    with pytest.raises(DamagedRun, match=r"referee\.survives is True, expected False by its other entries"):
        store.load(path)


def test_the_split_of_the_time_is_stored_and_no_part_of_the_hash(tmp_path: Path) -> None:
    first, second = (
        store.load(store.save(replace(solution(), evaluation_s=s), tmp_path, []).path) for s in (0.25, 0.75)
    )
    assert first.solution(solution().problem).evaluation_s == 0.25
    assert second.meta["solver_s"] == pytest.approx(second.meta["solve_s"] - 0.75)
    assert first.meta["hash"] == second.meta["hash"]


@pytest.mark.costly
def test_multipliers_survive_the_disk_by_name(tmp_path: Path) -> None:
    solved = solve(get("push-disc"), Barrier(mu=1e-3))
    run = store.load(store.save(solved, tmp_path, []).path)
    for name in ("lam_g_dynamics", "lam_g_gap_definition", "lam_g_contact", "lam_x_u", "lam_x_x"):
        np.testing.assert_array_equal(run.data[name].values, solved.data[name].values)
        assert "cost" in run.data[name].attrs["units"]
    assert run.data["lam_g_dynamics"].dims == ("scenario", "interval", "state")
    assert run.data["lam_x_u"].dims == ("scenario", "interval", "control")
    shifted = solved.data.assign(lam_g_contact=2 * solved.data["lam_g_contact"])
    other = store.load(store.save(solved.with_data(shifted), tmp_path, []).path)
    assert other.meta["hash"] != run.meta["hash"], "they are content"


def test_runs_are_found_by_their_names_without_opening_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs of the same second are in the order in which they were written, damaged ones included."""
    paths = [store.save(solution(), tmp_path, []).path for _ in range(3)]
    (paths[1] / "meta.json").write_bytes(b"damaged")
    for place, path in enumerate(paths):
        os.utime(path, ns=(place, place))
    monkeypatch.setattr("ocp.store.runs.read_meta", None)
    assert store.run_paths(tmp_path) == paths
    assert [store.find_run(f"@{k}", tmp_path) for k in (3, 2, 1)] == paths
    assert store.find_run("@last", tmp_path) == paths[-1]


def test_an_array_that_netcdf_cannot_hold_is_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    def failing(*_: object, **__: object) -> None:
        raise RuntimeError("NetCDF: HDF error")

    monkeypatch.setattr("netCDF4.Dataset", failing)
    with pytest.raises(NotWritten, match="NetCDF: HDF error") as caught:
        atomic.netcdf_bytes(LabelledArrays({}), "the run")
    assert caught.value.exit_code == 1
