"""Built distributions contain all code and no pictures, and work without this checkout."""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
import tarfile
import zipfile
from pathlib import Path

import pytest

from reports.cli.new_command import TASKS, TEMPLATES

ROOT = Path(__file__).parents[2]
PACKAGES = ("dynamics", "ocp", "problems", "reports")
PICTURES = (".gif", ".png", ".mp4")

pytestmark = pytest.mark.slow


def run(*command: str | Path, cwd: Path, **more: str) -> subprocess.CompletedProcess[str]:
    """Run a command without this checkout on the path, and check that it succeeds."""
    bare = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "VIRTUAL_ENV")}
    done = subprocess.run([*map(str, command)], cwd=cwd, capture_output=True, text=True, env=bare | more)
    assert done.returncode == 0, done.stdout + done.stderr
    return done


def built(target: str, folder: Path) -> Path:
    """Build the wheel or the sdist with the installed backend, without network; return the file."""
    tools = os.environ.get("PYTHONPATH", "")
    run(sys.executable, "-m", "hatchling", "build", "-t", target, "-d", folder, cwd=ROOT, PYTHONPATH=tools)
    (file,) = folder.iterdir()
    return file


def tracked(*folders: str) -> set[str]:
    listed = subprocess.run(["git", "ls-files", *folders], cwd=ROOT, capture_output=True, text=True, check=True)
    return set(listed.stdout.splitlines())


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return built("wheel", tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="module")
def elsewhere(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the programs folder of a new environment with the wheel, which uses the libraries of this one.

    A path file names the folder of these libraries. Path files in that folder are not read, so that
    the editable install of this checkout is not found.
    """
    home = tmp_path_factory.mktemp("elsewhere") / "env"
    run(sys.executable, "-m", "venv", "--without-pip", home, cwd=home.parent)
    python = home / "bin" / "python"
    where = "import sysconfig; print(sysconfig.get_path('purelib'))"
    site = Path(run(python, "-c", where, cwd=home).stdout.strip())
    (site / "borrowed.pth").write_text(sysconfig.get_path("purelib") + "\n")
    run(
        sys.executable,
        "-m",
        "pip",
        "--python",
        python,
        "install",
        "--no-deps",
        "--no-index",
        "--quiet",
        wheel,
        cwd=home,
    )
    return home / "bin"


def test_the_wheel_holds_the_packages_whole_and_no_pictures(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    packed = {name for name in names if name.partition("/")[0] in PACKAGES}
    copied = {f"reports/cli/templates/{file}" for file in (*TEMPLATES.values(), *TASKS.values())}
    assert packed == tracked(*PACKAGES) | copied
    assert {f"{name}/py.typed" for name in PACKAGES} <= packed
    assert {"reports/documents/references.bib", "reports/documents/templates/solve.typ"} <= packed
    assert not [name for name in names if name.endswith(PICTURES)]
    assert wheel.stat().st_size < 2e6


def test_the_sdist_holds_sources_and_tests_and_no_pictures(tmp_path: Path) -> None:
    file = built("sdist", tmp_path)
    with tarfile.open(file) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    wanted = tracked(*PACKAGES, "tests", "examples", "docs", "Makefile", "constraints.txt")
    assert {name for name in wanted if not name.endswith(PICTURES)} <= names
    assert not [name for name in names if name.endswith(PICTURES)]


def test_the_wheel_solves_and_reports_in_an_empty_folder(elsewhere: Path, tmp_path: Path) -> None:
    done = run(
        elsewhere / "ocp",
        "solve",
        "push-1d",
        "--contact",
        "barrier",
        "--pdf",
        "one.pdf",
        cwd=tmp_path,
    )
    assert "Solved: cost 1.38692" in done.stdout
    assert (tmp_path / "one.pdf").read_bytes().startswith(b"%PDF")
    assert [path.parent.name for path in tmp_path.glob("runs/*/*")] == ["push-1d"]
    run(elsewhere / "ocp", "new", "mine", "--machine", cwd=tmp_path)
    assert "push-up on one arm" in run(elsewhere / "ocp", "show", "mine.py", cwd=tmp_path).stdout


def test_the_wheel_is_whole_from_python_too(elsewhere: Path, tmp_path: Path) -> None:
    code = (
        "import ocp, sys; s = ocp.solve('wall-1d', N=4); assert 'svg' in s._repr_html_();"
        "print(ocp.__version__, ocp.load(ocp.save(s)).cost == s.cost, ocp.__file__)"
    )
    version, same, place = run(elsewhere / "python", "-c", code, cwd=tmp_path).stdout.split()
    assert (version, same) == ("0.1.0", "True")
    assert Path(place).is_relative_to(elsewhere.parent)
    for name in ("problems", "reports"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('the wrong one')")
    for program in (["ocp"], ["python", "-m", "ocp"]):
        first, *rest = program
        assert "push-disc" in run(elsewhere / first, *rest, "list", cwd=tmp_path).stdout
