"""Damaged runs are found, named with the reason, and not loaded."""

from __future__ import annotations

from pathlib import Path

import pytest

from ocp import store
from ocp.errors import DamagedRun
from tests.resealed import having, lacking, reseal
from tests.unit.ocp.store.test_store import solution


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(bytes(content))


def sealed_with(change):
    return lambda file: reseal(file.parent, change)


@pytest.mark.one_case_in(3)
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


@pytest.mark.parametrize("part", ["audit", "stages", "status", "iterations"])
def test_a_solution_with_a_part_missing_is_damaged(tmp_path: Path, part: str) -> None:
    path = store.save(solution(), tmp_path, []).path
    reseal(path, lacking(part))
    with pytest.raises(DamagedRun, match=rf"meta\.json does not describe a run: {part} is missing"):
        store.load(path)
