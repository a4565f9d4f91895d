"""Digest of a user's file, of the modules that it imports from its folder, and of data files in this folder.

Installed modules, and the four packages of this program, are identified by their versions instead
(:mod:`ocp.store.provenance`).
"""

from __future__ import annotations

import ast
import hashlib
import site
import sys
import sysconfig
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path

from ocp.distribution import PACKAGES


def source_digest(path: Path) -> str:
    """Return the SHA-256, in hex, of a file and all files that it depends on, independent of the folder's path.

    The file depends on the modules that it imports, directly or through other modules and also inside functions,
    except installed modules and those of this program. It also depends on data files in its folder whose names are
    strings in one of these modules (``np.load(HERE / "table.npy")``). Code that runs only as a program (``if __name__
    == "__main__"``) is ignored.

    Raises :class:`~ocp.errors.InputError` if a file cannot be read.
    """
    from ocp.store.provenance import file_digest

    files = dependency_files(path)
    digest = hashlib.sha256()
    for name in sorted(files):
        digest.update(f"{name} {file_digest(files[name])}\n".encode("utf-8", "surrogateescape"))
    return digest.hexdigest()


def dependency_files(path: Path) -> dict[str, Path]:
    """Return the files of :func:`source_digest`; keys are ``""``, names of modules, and ``./name`` for data files."""
    file = path.resolve()
    search = _DependencySearch(search_path(file.parent))
    search.add_file("", file)
    return search.files


_folders: list[str] = []
"""Folders of users' files imported so far, the latest first; they are at the end of ``sys.path``."""


def search_path(folder: Path) -> list[str]:
    """Return the module search path for a file in ``folder``, without the folders of users' files elsewhere."""
    return [*(folder_on_path for folder_on_path in sys.path if folder_on_path not in _folders), str(folder)]


def open_to_imports(folder: Path) -> None:
    """Add ``folder`` to ``sys.path`` for the whole process, so that imports inside functions also work.

    The folder is added after all installed packages, so that its modules hide no installed package.
    """
    own_path, other_folders = search_path(folder), [other for other in _folders if other != str(folder)]
    _folders[:] = [str(folder), *other_folders]
    sys.path[:] = [*own_path, *other_folders]


def folder_modules(path: Path) -> dict[str, Path]:
    """Return the modules among the :func:`dependency_files` of a file, as a mapping from name to file."""
    return {name: file for name, file in dependency_files(path).items() if name and "/" not in name}


@dataclass
class _DependencySearch:
    path: Sequence[str]
    files: dict[str, Path] = field(default_factory=dict)

    def add_file(self, name: str, file: Path, package: str = "") -> None:
        """Add a file to ``files`` and, if it is a module, all files that it imports or names."""
        self.files[name] = file
        if file.suffix != ".py":
            return
        try:
            tree = ast.parse(file.read_bytes())
            nodes = list(_nodes(tree))
        except (OSError, SyntaxError, ValueError, RecursionError):
            return
        for node in nodes:
            for module in _imported(node, package):
                self._module(module)
            data = _named_path(node)
            if data and _is_file(file.parent, data):
                self.files[f"./{data}"] = file.parent / data

    def _module(self, name: str) -> None:
        """Add the module with the full name ``name`` and its parent packages, up to an installed package."""
        path, module = self.path, ""
        for part in name.split("."):
            module = f"{module}.{part}" if module else part
            spec = None if module in PACKAGES else _spec(part, path)
            origin = None if spec is None else spec.origin and Path(spec.origin).resolve()
            if spec is None or (origin and any(map(origin.is_relative_to, _installed_folders()))):
                return
            inside = spec.submodule_search_locations
            if spec.origin and module not in self.files:
                package = module if inside is not None else module.rpartition(".")[0]
                self.add_file(module, Path(spec.origin), package)
            path = list(inside or ())


def _spec(name: str, path: Sequence[str]) -> ModuleSpec | None:
    """Return the import specification of a module without importing its package; None if there is none.

    ``name`` is the last part of the module's full name.
    """
    try:
        spec = PathFinder.find_spec(name, path)
    except (ImportError, OSError, ValueError):
        return None
    return spec if spec is None or spec.origin is None or Path(spec.origin).is_file() else None


@cache
def _installed_folders() -> set[Path]:
    """Return the folders of the standard library and of installed packages."""
    kinds = ("stdlib", "platstdlib", "purelib", "platlib")
    folders = [sysconfig.get_path(kind) for kind in kinds]
    folders += [*site.getsitepackages(), site.getusersitepackages()]
    return {Path(folder).resolve() for folder in folders}


def _nodes(tree: ast.AST) -> Iterator[ast.AST]:
    """Yield all nodes of a syntax tree except the nodes under ``if __name__ == "__main__"``."""
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        yield node
        if isinstance(node, ast.If) and ast.unparse(node.test) == "__name__ == '__main__'":
            waiting += node.orelse
        else:
            waiting += ast.iter_child_nodes(node)


def _imported(node: ast.AST, package: str) -> Iterator[str]:
    """Yield full names of modules that a node may import; the last part may be the name of an attribute instead."""
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    elif isinstance(node, ast.ImportFrom):
        above = package.split(".") if package else []
        base = above[: len(above) + 1 - node.level] if node.level else []
        name = ".".join([*base, *([node.module] if node.module else [])])
        yield from (f"{name}.{alias.name}" if name else alias.name for alias in node.names)
        if name:
            yield name
    elif isinstance(node, ast.Call) and node.args:
        called = node.func
        function_name = called.attr if isinstance(called, ast.Attribute) else getattr(called, "id", "")
        first = node.args[0]
        if function_name in ("import_module", "__import__") and isinstance(first, ast.Constant):
            yield str(first.value).lstrip(".")


def _named_path(node: ast.AST) -> str:
    """Return the relative path that a string, or strings joined by ``/``, may name; "" for other nodes."""
    steps: list[str] = []
    while isinstance(node, ast.BinOp) and isinstance(node.op, ast.Div):
        if not (isinstance(node.right, ast.Constant) and isinstance(node.right.value, str)):
            return ""
        steps.insert(0, node.right.value)
        node = node.left
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        steps.insert(0, node.value)
    text = "/".join(steps)
    return text if 0 < len(text) <= 255 and text.isprintable() else ""


def _is_file(folder: Path, name: str) -> bool:
    try:
        return (folder / name).is_file() and not Path(name).is_absolute()
    except (OSError, ValueError):
        return False
