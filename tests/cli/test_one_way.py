"""One solve with its PDF loads few modules of this package and calls functions in few files."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
MODULES, FILES = 220, 141
"""Maximum numbers of loaded modules, and of files with called functions, in ``ocp solve --pdf``."""

MEASURE = """
import cProfile, json, os, sys

packages = ("dynamics", "ocp", "problems", "reports")
roots = tuple(os.path.join(sys.argv[1], p, "") for p in packages)
profile = cProfile.Profile(builtins=False)
profile.enable()
from reports.cli.app import main
# As many samples as take the route of the usual effort, but no longer.
code = main(["solve", "push-disc", "-p", "N=5", "--contact", "exact", "--effort", "3000", "--pdf", "x.pdf", "-q"])
profile.disable()
codes = [entry.code for entry in profile.getstats()]
# Bodies of modules and classes have no fast locals; names such as <listcomp> do not count.
called = {c.co_filename for c in codes if not isinstance(c, str) and c.co_flags & 1 and c.co_name[0] != "<"}
ours = [m for m in sys.modules if m.split(".")[0] in packages]
files = sorted(file for file in called if file.startswith(roots))
print(json.dumps({"code": code, "files": files, "modules": sorted(ours)}))
"""


def printed(program: str, directory: Path) -> dict:
    found = subprocess.run([sys.executable, "-c", program, str(ROOT)], cwd=directory, capture_output=True, text=True)
    assert found.returncode == 0, found.stderr
    return json.loads(found.stdout.splitlines()[-1])


def test_a_solve_with_its_pdf_loads_and_calls_little(tmp_path: Path) -> None:
    found = printed(MEASURE, tmp_path)
    assert found["code"] == 0 and (tmp_path / "x.pdf").exists()
    assert len(found["modules"]) <= MODULES, found["modules"]
    assert len(found["files"]) <= FILES, found["files"]
    of_others = (
        "ocp.learning",
        "ocp.gradients",
        "ocp.jobs",
        "problems.studies",
        "problems.tasks",
    )
    assert not [name for name in found["modules"] if name.startswith(of_others)]


@pytest.mark.costly
def test_pdf_loads_no_study_and_no_policy_learning(tmp_path: Path) -> None:
    program = "import json, sys; import reports.documents.pdf; print(json.dumps({'m': sorted(sys.modules)}))"
    loaded = printed(program, tmp_path)["m"]
    assert not [name for name in loaded if name.startswith(("problems.studies", "ocp.learning"))]


LOADED = """
import json, sys
{}
print(json.dumps([name for name in {} if name in sys.modules]))
"""
HEAVY = ("xarray", "pandas", "matplotlib", "scipy.optimize", "scipy.stats", "dask", "typst")
"""Libraries of datasets, drawings and statistics, which no start-up loads."""
UNUSED_BY_IMPORT = (
    *(*HEAVY, "numpy", "casadi", "pydantic", "scipy", "netCDF4", "rich", "typer", "importlib.metadata"),
    *("dynamics.contact", "dynamics.batch", "ocp.problem", "ocp.solve", "ocp.store", "ocp.mpc", "ocp.learning"),
)
"""Modules that ``import ocp`` loads only when they are used."""
UNUSED_BY_PROBLEMS = ("ocp.learning", "ocp.gradients", "ocp.store", "ocp.judge", "dynamics.batch")
"""Modules that the list of problems does not need besides those of :data:`UNUSED_BY_LISTS`."""
UNUSED_BY_SOLVE = ("dynamics.systems.planar.machine", "ocp.learning", "numpy.f2py.crackfortran", "unittest")
"""Modules that one solve does not need; SciPy would load the last two, by copying NumPy's namespace."""
UNUSED_BY_LISTS = (*HEAVY, "scipy", "netCDF4", "rich", "problems.library", "problems.bodies", "problems.arena")
"""Modules that ``ocp list`` does not need: it reads titles of problems from their source."""


def loaded(program: str, names: tuple[str, ...], directory: Path) -> dict:
    return printed(LOADED.format(program, names), directory)


def test_importing_ocp_loads_no_library_of_datasets_or_drawings(tmp_path: Path) -> None:
    assert loaded("import ocp", UNUSED_BY_IMPORT, tmp_path) == []


def test_public_names_are_those_of_their_modules_in_any_order_of_imports(tmp_path: Path) -> None:
    program = "import ocp.solve.request, ocp.errors, ocp, json; from ocp import InputError, solve"
    checks = {
        "solve": "ocp.solve is solve is ocp.solve.__globals__['solve']",
        "error": "InputError is ocp.errors.InputError",
    }
    values = ", ".join(f"'{name}': {check}" for name, check in checks.items())
    assert printed(f"{program}; print(json.dumps({{{values}}}))", tmp_path) == dict.fromkeys(checks, True)


@pytest.mark.costly
@pytest.mark.parametrize(
    ("command", "unused"),
    [
        (["list", "-q"], UNUSED_BY_LISTS),
        (["list", "problems", "-q"], (*UNUSED_BY_LISTS, *UNUSED_BY_PROBLEMS)),
        (["solve", "wall-1d", "-q", "--effort", "quick"], (*HEAVY, *UNUSED_BY_SOLVE)),
    ],
)
def test_a_command_loads_no_unused_modules(command: list[str], unused: tuple[str, ...], tmp_path: Path) -> None:
    assert loaded(f"from reports.cli.app import main; assert main({command}) == 0", unused, tmp_path) == []
