"""Files of users with the names of our packages do no harm, or are reported."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
OURS = ("dynamics", "ocp", "problems", "reports")


def python(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run Python in ``folder``, with this checkout after it on the search path."""
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )


def put(folder: Path, name: str, kind: str) -> Path:
    """Create a module, a package or a folder called ``name`` that exits if imported; return its file."""
    if kind == "file":
        place = folder / f"{name}.py"
    else:
        (folder / name).mkdir()
        place = folder / name / ("__init__.py" if kind == "package" else "notes.txt")
    place.write_text("raise SystemExit('the wrong one')")
    return place


@pytest.mark.costly
@pytest.mark.parametrize("kind", ["file", "package", "folder"])
def test_the_working_directory_does_not_stand_for_our_packages(tmp_path: Path, kind: str) -> None:
    for name in OURS:
        if (name, kind) not in (("ocp", "file"), ("ocp", "package")):
            put(tmp_path, name, kind)
    done = python(tmp_path, "-m", "ocp", "list", "--json")
    assert done.returncode == 0, done.stderr
    assert "push-1d" in [item["name"] for item in json.loads(done.stdout)["problems"]]


@pytest.mark.costly
@pytest.mark.parametrize("kind", ["file", "package"])
def test_the_installed_program_never_looks_into_the_working_directory(tmp_path: Path, kind: str) -> None:
    for name in OURS:
        put(tmp_path, name, kind)
    program = tmp_path / "elsewhere" / "ocp"
    program.parent.mkdir()
    program.write_text("from reports.cli.app import main\nraise SystemExit(main())")
    done = python(tmp_path, str(program), "list")
    assert done.returncode == 0 and "push-1d" in done.stdout, done.stderr


@pytest.mark.cheap_cases("dynamics-import ocp")
@pytest.mark.parametrize(
    ("name", "code"),
    [
        ("dynamics", "import ocp"),
        ("problems", "from ocp import solve; solve('push-1d')"),
        ("reports", "import ocp.plugins; ocp.plugins.reports.load()"),
        ("problems", "import sys; from reports.cli.app import main; sys.exit(main(['list']))"),
    ],
)
def test_what_a_script_has_beside_it_is_named_in_one_sentence(tmp_path: Path, name: str, code: str) -> None:
    place = put(tmp_path, name, "package")
    place.write_text("")
    done = python(tmp_path, "-c", code)
    *_, last = done.stderr.strip().splitlines()
    assert done.returncode in (1, 2)
    assert f"{place} has the name of the package {name} of centralpath and hides it" in last


@pytest.mark.costly
def test_a_file_of_that_name_is_no_trouble_until_ours_is_needed(tmp_path: Path) -> None:
    put(tmp_path, "problems", "file")
    done = python(tmp_path, "-c", "import ocp; print(ocp.__version__)")
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.costly_cases("dynamics-file")
@pytest.mark.parametrize(("name", "kind"), [("problems", "package"), ("dynamics", "file")])
def test_doctor_says_what_a_script_in_this_folder_would_find(tmp_path, name, kind) -> None:
    clean = python(tmp_path, "-m", "ocp", "doctor", "--json")
    assert json.loads(clean.stdout)["scripts here"] == "no name hidden"
    place = put(tmp_path, name, kind)
    found = json.loads(python(tmp_path, "-m", "ocp", "doctor", "--json").stdout)
    assert f"{place} has the name of the package {name}" in found["scripts here"]


def test_the_program_started_by_a_script_there_ends_with_one_sentence(tmp_path: Path) -> None:
    place = put(tmp_path, "dynamics", "file")
    place.write_text("")
    code = "import sys; from reports.cli.start import main; sys.argv = ['ocp', 'settings']; main()"
    done = python(tmp_path, "-c", code)
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert f"{place} has the name of the package dynamics" in done.stderr


def test_a_problem_file_that_means_the_one_beside_it_is_told(tmp_path: Path) -> None:
    place = put(tmp_path, "dynamics", "file")
    (tmp_path / "own.py").write_text("from dynamics import Mine\n")
    done = python(tmp_path, "-m", "ocp", "show", "own.py")
    assert done.returncode == 2
    assert f"{place} has the name of a package of centralpath; rename it" in done.stderr
