"""The digest of a user's file changes with its content and imports, and with nothing else."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import problems
from ocp.errors import InputError
from problems.loading import import_file
from problems.source_digest import dependency_files, source_digest

MAIN = """
from pathlib import Path
import numpy as np
import casadi as ca
import near
from pack import inner
from dynamics.systems import signals

def build(params):
    from late import value
    return np.load(Path(__file__).parent / "data" / "table.npy"), value

if __name__ == "__main__":
    import script
    print("plan.txt")
"""
FILES = {
    "main.py": MAIN,
    "near.py": "import far\nfrom importlib import import_module\nnamed = import_module('named')\n",
    "far.py": "value = 1.0\n",
    "named.py": "value = 5.0\n",
    "late.py": "value = 2.0\n",
    "pack/__init__.py": "",
    "pack/inner.py": "from . import deep\nfrom .deep import value\n",
    "pack/deep.py": "value = 3.0\n",
    "pack/unused.py": "value = 4.0\n",
    "script.py": "value = 6.0\n",
    "plan.txt": "plan",
    "data/table.npy": "numbers",
    "other.py": "value = 7.0\n",
}
DECISIVE = {
    "main.py",
    "near.py",
    "far.py",
    "named.py",
    "late.py",
    "pack/__init__.py",
    "pack/inner.py",
    "pack/deep.py",
    "data/table.npy",
}


@pytest.fixture(autouse=True)
def _untouched() -> Iterator[None]:
    """Restore imported modules and the search path after the test."""
    modules, path = dict(sys.modules), list(sys.path)
    yield
    sys.path[:] = path
    for name in set(sys.modules) - set(modules):
        del sys.modules[name]


def made(folder: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    return folder / next(iter(files))


def test_the_parts_are_those_that_are_used(tmp_path: Path) -> None:
    file = made(tmp_path, FILES)
    assert {str(part.relative_to(tmp_path)) for part in dependency_files(file).values()} == DECISIVE


@pytest.mark.parametrize("name", FILES)
def test_the_digest_is_of_what_is_used(tmp_path: Path, name: str) -> None:
    file = made(tmp_path, FILES)
    before = source_digest(file)
    (tmp_path / name).write_text(FILES[name] + "\n# changed\n")
    assert (source_digest(file) != before) == (name in DECISIVE)
    (tmp_path / name).write_text(FILES[name])
    assert source_digest(file) == before


def test_the_place_and_the_name_play_no_part(tmp_path: Path) -> None:
    here = made(tmp_path / "here", FILES)
    there = made(tmp_path / "there", FILES).rename(tmp_path / "there/moved.py")
    assert source_digest(here) == source_digest(there)


def test_circles_and_broken_texts_end(tmp_path: Path) -> None:
    file = made(tmp_path, {"a.py": "import b", "b.py": "import a\ndef (", "c.py": ""})
    assert set(dependency_files(file)) == {"", "b"}
    with pytest.raises(InputError, match=r"cannot read .*absent\.py: No such file"):
        source_digest(tmp_path / "absent.py")


def test_a_module_beside_the_file_is_found_and_read_again(tmp_path: Path) -> None:
    """This also holds for a file of the same size and time, and for one imported by an unchanged module."""
    chain = {"mine.py": "import near\nvalue = near.far.value\n", "near.py": "import far\n"}
    file = made(tmp_path, {**chain, "far.py": "value = 1\n"})
    assert import_file(file).value == 1
    made(tmp_path, {"far.py": "value = 2\n"})
    assert not list(tmp_path.rglob("*.pyc"))
    assert import_file(file).value == 2
    made(tmp_path, {"mine.py": "value = 3\n"})
    assert import_file(file).value == 3
    made(tmp_path, {"mine.py": "value = 4\n"})
    assert import_file(file).value == 4


def test_packages_without_init_in_one_another_are_followed(tmp_path: Path) -> None:
    deep = tmp_path / "outside" / "of" / "all.py"
    deep.parent.mkdir(parents=True)
    deep.write_text("value = 1.0\n")
    file = tmp_path / "main.py"
    file.write_text("from outside.of.all import value\n")
    assert dependency_files(file)["outside.of.all"] == deep
    before = source_digest(file)
    deep.write_text("value = 2.0\n")
    assert source_digest(file) != before


def test_two_folders_do_not_mix(tmp_path: Path) -> None:
    """Both folders have a module of the same name."""
    files = [
        made(tmp_path / str(value), {"mine.py": "import near\n", "near.py": f"value = {value}\n"}) for value in (1, 2)
    ]
    found = [import_file(file).near.value for file in (*files, *files)]
    assert found == [1, 2, 1, 2]


def test_nothing_beside_a_file_hides_what_is_installed(tmp_path: Path) -> None:
    file = made(tmp_path, {"mine.py": "import colorsys\n", "colorsys.py": "hls_to_rgb = None\n"})
    sys.modules.pop("colorsys", None)
    assert import_file(file).colorsys.hls_to_rgb is not None
    assert set(dependency_files(file)) == {""}


def test_a_problem_knows_what_it_was_made_of(tmp_path: Path) -> None:
    text = (Path(__file__).parents[3] / "examples/slope.py").read_text()
    file = made(tmp_path, {"mine.py": text})
    found = problems.load(file)
    assert found.digest == source_digest(file)
    assert found.problem().origin.source_digest == found.digest
    assert problems.get("push-1d").origin.source_digest is None
