"""Structure of the four packages: one root, one direction of imports, one version, and small folders."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from graphlib import TopologicalSorter
from importlib import import_module
from importlib.metadata import version
from pathlib import Path

import grimp
import pytest

from tests import check

ROOT = Path(__file__).parents[2]
IMPORTERS = ("import_module", "__import__")
PACKAGES = ("dynamics", "ocp", "problems", "reports")


def test_all_four_packages_come_from_one_root() -> None:
    """Other distributions have packages named ocp and reports, which must not shadow ours."""
    roots = {name: Path(import_module(name).__file__ or "").parents[1] for name in PACKAGES}
    assert set(roots.values()) == {ROOT}


def test_the_version_is_told_once() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert version("centralpath") == project["version"]


def test_no_module_needs_one_that_needs_it() -> None:
    """The graph of imports at run time has no cycles."""
    graph = grimp.build_graph(*PACKAGES, exclude_type_checking_imports=True)
    needs = {name: graph.find_modules_directly_imported_by(name) for name in graph.modules}
    order = list(TopologicalSorter(needs).static_order())
    assert order.index("dynamics.contact.step") < order.index("ocp.solve.solve")


@pytest.mark.costly
@pytest.mark.parametrize(("floor", "above"), [(name, PACKAGES[i + 1 :]) for i, name in enumerate(PACKAGES[:-1])])
def test_a_floor_loads_nothing_from_above(floor: str, above: tuple[str, ...]) -> None:
    """Modules of a package, imported in a fresh interpreter, load no package above it and no matplotlib."""
    modules = [
        ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        for path in sorted((ROOT / floor).rglob("*.py"))
    ]
    code = (
        f"import sys\nfor name in {modules!r}: __import__(name)\n"
        f"print([m for m in sys.modules if m.split('.')[0] in {(*above, 'matplotlib')!r}])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "[]"


@pytest.mark.costly
def test_no_module_is_named_by_a_text_put_together() -> None:
    """No import has a computed name, which would hide the dependence from readers, grimp and renames."""
    for path in (file for package in PACKAGES for file in (ROOT / package).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            called = node.func if isinstance(node, ast.Call) else None
            if getattr(called, "attr", getattr(called, "id", "")) in IMPORTERS:
                assert isinstance(node, ast.Call)
                assert not isinstance(node.args[0], ast.JoinedStr | ast.BinOp), path


HEAVY = "scipy pandas xarray matplotlib netCDF4 typst rich multiprocessing jax"
"""Names of libraries that are loaded on first use, not by importing ocp or by ``ocp list``."""


LIST = """from contextlib import redirect_stdout
from io import StringIO
from reports.cli.app import main
with redirect_stdout(StringIO()): assert main(["list"]) == 0"""


def test_help_loads_nothing_of_ours() -> None:
    code = "import sys, reports.cli.app; print([p for p in ('ocp', 'casadi') if p in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.stdout.strip() == "[]"


@pytest.mark.costly
@pytest.mark.parametrize("code", ["import ocp", LIST], ids=["import ocp", "ocp list"])
def test_asking_what_there_is_loads_no_heavy_library(code: str) -> None:
    told = f"print('loaded', [name for name in {HEAVY.split()!r} if name in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-c", f"import sys\n{code}\n{told}"],
        capture_output=True,
        text=True,
        cwd=ROOT,
        check=True,
    )
    assert done.stdout.splitlines()[-1] == "loaded []"


def test_no_room_is_crowded() -> None:
    """No folder has more than 22 files."""
    rooms = {file.parent for name in PACKAGES for file in (ROOT / name).rglob("*.py")}
    crowded = {str(room.relative_to(ROOT)): n for room in rooms if (n := len([*room.glob("*.py")])) > 22}
    assert crowded == {}


def test_the_map_of_the_house_is_true() -> None:
    """CONTRIBUTING.md has at most 150 lines, and every file and folder that it names exists."""
    text = (ROOT / "CONTRIBUTING.md").read_text()
    named = re.findall(r"`((?:dynamics|ocp|problems|reports|tests|examples)/[\w/.]+)`", text)
    assert [name for name in named if not (ROOT / name).exists()] == []
    assert len(text.splitlines()) <= 150 and len(named) > 25


@pytest.mark.costly
def test_a_file_is_checked_by_its_own_tests() -> None:
    nearest = {
        "docs/generator/roles.py": "tests/docs/test_site.py",
        "ocp/store/atomic.py": "tests/unit/ocp/store/test_interrupted_writes.py",
        "ocp/judge/audit.py": "tests/unit/ocp/judge/test_audit.py",
        "dynamics/systems/parameters.py": "tests/unit/dynamics/test_parameters.py",
        "tests/unit/test_words.py": "tests/unit/test_words.py",
    }
    for file, test in nearest.items():
        assert ROOT / test in check.tests_of(ROOT / file)[: check.MOST], file
    commands = check.commands(ROOT / "problems/library/hopper_1d.py")
    assert ["-k", "hopper-1d"] in [command[-2:] for command in commands]
