"""The architecture page's tables and figure: packages, their layers and what they import."""

from __future__ import annotations

import ast
import tomllib
from collections.abc import Iterator
from pathlib import Path

from reports.site.markdown import table
from reports.site.measured import DOCS

ROOT = DOCS.parent
_HEAD = (
    "# Architecture\n\n"
    "Four packages, one direction: `dynamics <- ocp <- problems <- reports`. A system is a "
    "symbolic graph; a contact law closes it; a transcription turns a problem into an NLP; a "
    "route solves it; three judges examine the solution; the store keeps it; reports show it. "
    "The walk of one solve through the files is in `CONTRIBUTING.md`.\n\n"
    "The figure and the table below are drawn from the code: the layers are the import "
    "contracts of `pyproject.toml`, where a line imports only lines below it, and the imports "
    "are read from the source files.\n\n"
)
PACKAGES = ("dynamics", "ocp", "problems", "reports")


def pages() -> dict[str, str]:
    """``architecture.md``: the layers as text, then each package with its imports."""
    names = sorted(_units())
    rows = [
        (f"`{name}`", _summary(name), ", ".join(f"`{other}`" for other in _imports(name, names)))
        for name in names
    ]
    listed = table(("package", "contents", "imports"), rows)
    return {"architecture.md": f"{_HEAD}```text\n{layers()}```\n\n{listed}"}


def layers() -> str:
    """Every import contract of ``pyproject.toml`` that orders layers, the lowest layer last."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    lines = []
    for contract in settings["tool"]["importlinter"]["contracts"]:
        if contract["type"] == "layers":
            lines.append("".join(f"{name}/" for name in contract.get("containers", ["."])))
            lines += [f"    {layer}" for layer in contract["layers"]]
    return "\n".join(lines) + "\n"


def _units() -> Iterator[str]:
    """Packages one level below the four, as ``ocp.routes``."""
    for package in PACKAGES:
        for folder in (ROOT / package).iterdir():
            if (folder / "__init__.py").exists():
                yield f"{package}.{folder.name}"


def _summary(name: str) -> str:
    source = (ROOT / name.replace(".", "/") / "__init__.py").read_text(encoding="utf-8")
    return (ast.get_docstring(ast.parse(source)) or "").partition("\n")[0].replace("``", "`")


def _imports(name: str, names: list[str]) -> list[str]:
    """The other packages of ``names`` that a package's modules import."""
    found = set()
    for file in (ROOT / name.replace(".", "/")).rglob("*.py"):
        found |= {".".join(module.split(".")[:2]) for module in _imported(file)}
    return sorted(found.intersection(names) - {name})


def _imported(file: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
