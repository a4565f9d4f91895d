"""``python -m tests.check FILE``: check one file in seconds.

Checks the style and types of the file, and runs tests that import its module, in order of the number of modules
that they import; ``make test`` runs the rest.
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import grimp

ROOT = Path(__file__).parents[1]
PACKAGES = ("dynamics", "ocp", "problems", "reports")
GENERATOR = "docs.generator"
"""Package that writes the documentation; it imports the other packages, and none of them imports it."""
MOST = 3
"""Maximum number of test files to run, since the whole suite may import the file's module."""


def module_of(file: Path) -> str:
    """Return the dotted module name of a file in this repository."""
    return ".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def imported(file: Path) -> set[str]:
    """Return the modules of this repository that a file imports, including those that define the imported names."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {_home(node.module, alias.name) for alias in node.names}
    return {name for name in found if name.startswith((*PACKAGES, GENERATOR))}


@cache
def _home(module: str, name: str) -> str:
    """Return the module that defines ``name``: ``module``, a submodule of it, or one from which it imports the name."""
    folder = ROOT / module.replace(".", "/")
    if (folder / f"{name}.py").is_file() or (folder / name).is_dir():
        return f"{module}.{name}"
    room = folder / "__init__.py"
    if module.partition(".")[0] in PACKAGES and room.is_file():
        for node in ast.parse(room.read_text()).body:
            if isinstance(node, ast.ImportFrom) and any(a.name == name for a in node.names):
                return _home(str(node.module), name)
    return module


def tests_of(file: Path) -> list[Path]:
    """Return the test files that check a file, first those that import the fewest modules.

    They import the file's module; if no test does, they import its package or a module that imports it, and so
    on.
    """
    if ROOT / "tests" in file.parents:
        return [file]
    graph = grimp.build_graph(*PACKAGES, GENERATOR, cache_dir=None)
    every = sorted((ROOT / "tests").rglob("test_*.py"))
    needs = {test: imported(test) for test in every if "benchmarks" not in test.parts}
    near, seen = {module_of(file)}, set[str]()
    while near:
        mine = [test for test, modules in needs.items() if modules & near]
        if mine:
            return sorted(mine, key=lambda test: len(needs[test]))
        seen |= near
        rooms = {room for one in near if "." in (room := one.rpartition(".")[0])}
        near = {m for one in near for m in graph.find_modules_that_directly_import(one)}
        near = (near | rooms) - seen
    return []


def commands(file: Path) -> list[list[str]]:
    """Return the commands that check a file, in their order."""
    found = [
        ["ruff", "check", str(file)],
        ["ruff", "format", "--check", str(file)],
        ["basedpyright", str(file)],
    ]
    tests = [str(test) for test in tests_of(file)[:MOST]]
    problem = re.search(r'^name(?:, \w+)* = "([\w-]+)"', file.read_text(), re.MULTILINE)
    if problem and ROOT / "problems" in file.parents:
        # Problems are loaded by name, so that no test imports them.
        found.append(["pytest", str(ROOT / "tests/unit/problems/test_problems.py"), "-k", problem[1]])
    return [*found, ["pytest", *tests]] if tests else found


def main(name: str) -> int:
    """Run all checks of a file and print the checks that failed; return the exit code."""
    bin_folder = Path(sys.executable).parent
    file = Path(name).resolve()
    failed = [
        " ".join(command)
        for command in commands(file)
        if subprocess.run([bin_folder / command[0], *command[1:]], cwd=ROOT).returncode
    ]
    for command in failed:
        print(f"failed: {command}", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
