"""The run store: stored runs are read back complete or not at all."""

from __future__ import annotations

import errno
import json
import math
import os
import re
import signal
import subprocess
import sys
import textwrap
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
from ocp.store import atomic, lookup
from problems import get
from tests.resealed import having, lacking, reseal


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


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(bytes(content))


def sealed_with(change):
    return lambda file: reseal(file.parent, change)


@pytest.mark.parametrize(
    ("file", "harm", "reason"),
    [
        ("solution.nc", Path.unlink, "No such file"),
        ("solution.nc", cut, "checksum"),
        ("solution.nc", flip, "checksum"),
        ("meta.json", Path.unlink, "No such file"),
        ("meta.json", cut, "does not end in its checksum"),
        ("meta.json", flip, "does not match its checksum"),
        ("meta.json", lambda path: path.write_text("[1]"), "does not end in its checksum"),
        ("meta.json", sealed_with(having(schema=99)), "schema version 99"),
        ("meta.json", sealed_with(lacking("schema")), "no schema"),
        ("meta.json", sealed_with(lacking("hash", "kind")), "hash is missing"),
        ("meta.json", sealed_with(having(kind="song")), "kind is 'song', expected one of solve"),
    ],
)
def test_damage_is_named(tmp_path: Path, file: str, harm, reason: str) -> None:
    path = store.save(solution(), tmp_path, []).path
    harm(path / file)
    with pytest.raises(DamagedRun) as caught:
        store.load(path)
    assert file in str(caught.value)
    assert reason in str(caught.value)


def test_an_unreadable_netcdf_with_the_right_checksum_is_damaged(tmp_path: Path) -> None:
    path = store.save(solution(), tmp_path, []).path
    reseal(path, having(), solution=b"not netCDF")
    with pytest.raises(DamagedRun, match="not a readable netCDF"):
        store.load(path)


def test_a_listing_shows_damaged_runs_with_the_reason(tmp_path: Path) -> None:
    good, bad = (store.save(solution(), tmp_path, []).path for _ in range(2))
    (bad / "meta.json").unlink()
    entries = {entry.path: entry for entry in store.list_runs(tmp_path)}
    assert entries[good].meta is not None
    assert entries[bad].meta is None
    assert "meta.json" in entries[bad].damage


def test_a_missing_run_is_wrong_usage(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no run"):
        store.load(tmp_path / "nothing")


def test_a_study_is_no_solution(tmp_path: Path) -> None:
    told = {"argv": [], "record": {}, "status": "done", "verdict": "All hold.", "claims": []}
    path = store.write_run(tmp_path, "toy", dataset(), {"kind": "figure", **told}).path
    with pytest.raises(InputError, match="figure"):
        store.load(path).solution(get("wall-1d"))


@pytest.mark.parametrize("part", ["audit", "stages", "status", "iterations"])
def test_a_solution_with_a_part_missing_is_damaged(tmp_path: Path, part: str) -> None:
    path = store.save(solution(), tmp_path, []).path
    reseal(path, lacking(part))
    with pytest.raises(DamagedRun, match=rf"meta\.json does not describe a run: {part} is missing"):
        store.load(path)


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


@pytest.mark.parametrize("call", [store.check_writable, lambda r: store.save(solution(), r, []).path])
def test_a_root_that_is_a_file_is_refused(tmp_path: Path, call) -> None:
    root = tmp_path / "runs"
    root.write_text("")
    with pytest.raises(InputError, match="--out"):
        call(root)


@pytest.mark.parametrize("fails", ["fsync", "rename"])
def test_a_full_disk_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fails: str) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(*((os, "fsync") if fails == "fsync" else (Path, "rename")), full)
    with pytest.raises(InputError, match="disk is full"):
        store.save(solution(), tmp_path, [])
    assert list((tmp_path / "toy").iterdir()) == []


KILLED_WHILE_WRITING = textwrap.dedent(
    """
    import sys, time
    import xarray as xr
    from pathlib import Path
    from ocp.store import runs as store
    def hang(*_):
        print("writing", flush=True)
        time.sleep(60)
    store.flush = hang
    store.write_run(Path(sys.argv[1]), "toy", xr.Dataset({"a": ("n", [1.0])}), {"kind": "continue"})
    """
)


@pytest.mark.costly
def test_kill_leaves_no_half_run_and_the_next_save_sweeps(tmp_path: Path) -> None:
    command = [sys.executable, "-c", KILLED_WHILE_WRITING, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "writing\n"
        store.save(solution(), tmp_path, [])
        living = [p for p in (tmp_path / "toy").iterdir() if p.name.startswith(".")]
        assert len(living) == 1, "a save must not sweep what a living process is writing"
        process.send_signal(signal.SIGKILL)
    assert living[0].exists()
    assert len(store.list_runs(tmp_path)) == 1, "a half run must not be listed"
    store.save(solution(), tmp_path, [])
    assert not living[0].exists()
    assert len(store.list_runs(tmp_path)) == 2


def test_a_removal_cut_short_leaves_no_half_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = store.save(solution(), tmp_path, []).path

    def killed(place: Path) -> None:
        (place / "meta.json").unlink()
        raise KeyboardInterrupt

    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(atomic.shutil, "rmtree", killed)
        lookup.remove_runs([path])
    assert store.list_runs(tmp_path) == []
    store.save(solution(), tmp_path, [])
    assert not [child for child in path.parent.iterdir() if child.name.startswith(".")]


@pytest.mark.parametrize("ending", [KeyboardInterrupt, ValueError])
def test_a_file_is_replaced_whole_or_not_at_all(tmp_path: Path, ending: type) -> None:
    file = tmp_path / "figure.pdf"
    atomic.write_file(file, b"old")
    with pytest.raises(ending), atomic.replace_file(file) as draft:
        draft.write_bytes(b"half")
        raise ending
    assert file.read_bytes() == b"old"
    atomic.write_file(file, b"new")
    assert file.read_bytes() == b"new"
    assert [path.name for path in tmp_path.iterdir()] == ["figure.pdf"]


def test_only_one_module_renames_into_place() -> None:
    """In ocp, problems and reports no other module moves files; dynamics has its own cache."""
    root = Path(store.__file__).parents[2]
    moves = r"(replace|rename)"
    by_hand = re.compile(rf"mkstemp|mkdtemp|os\.{moves}\(|[a-z)]\.{moves}\([a-z_]+\)")
    found = {
        str(file.relative_to(root))
        for package in ("ocp", "problems", "reports")
        for file in (root / package).rglob("*.py")
        if by_hand.search(file.read_text())
    }
    assert found == {"ocp/store/atomic.py", "ocp/store/runs.py"}


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
