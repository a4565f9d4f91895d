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
import json, os, sys

packages = ("dynamics", "ocp", "problems", "reports")
roots, called = tuple(os.path.join(sys.argv[1], p, "") for p in packages), set()

def profile(frame, event, argument):
    code = frame.f_code
    # Bodies of modules and classes have no fast locals; names such as <listcomp> do not count.
    if event == "call" and code.co_flags & 1 and code.co_name[0] != "<":
        if code.co_filename.startswith(roots):
            called.add(code.co_filename)

sys.setprofile(profile)
from reports.cli.app import main
code = main(["solve", "push-disc", "-p", "N=10", "--contact", "exact", "--pdf", "x.pdf", "-q"])
sys.setprofile(None)
ours = [m for m in sys.modules if m.split(".")[0] in packages]
print(json.dumps({"code": code, "files": sorted(called), "modules": sorted(ours)}))
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
heavy = ("xarray", "pandas", "matplotlib", "scipy.optimize", "dask")
print(json.dumps([name for name in heavy if name in sys.modules]))
"""


def test_importing_ocp_loads_no_library_of_datasets_or_drawings(tmp_path: Path) -> None:
    assert printed(LOADED.format("import ocp"), tmp_path) == []


@pytest.mark.costly
@pytest.mark.parametrize("command", [["list", "-q"], ["solve", "wall-1d", "-q"]])
def test_a_command_without_datasets_loads_none(command: list[str], tmp_path: Path) -> None:
    assert printed(LOADED.format(f"from reports.cli.app import main; assert main({command}) == 0"), tmp_path) == []
