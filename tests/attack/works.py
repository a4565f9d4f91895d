"""Small commands of every kind that attacks run, and a store with one run of each."""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ocp import store
from ocp.errors import DamagedRun, InputError
from tests.attack.forked import Server

PROBLEM = '''\
"""A mass that is pushed along a line: a user's own problem."""

from problems.library.push_1d import *  # a user's file may build on a named problem
'''


@dataclass(frozen=True)
class Work:
    """Command that stores a run, or writes the file ``leaves``."""

    name: str
    arguments: tuple[str, ...]
    leaves: str = ""


def _work(name: str, line: str, leaves: str = "") -> Work:
    return Work(name, (*line.split(), "--quiet"), leaves)


MAKING = (
    _work("solve", "solve wall-1d -p N=4"),
    _work(
        "continue",
        "continue wall-1d --contact barrier -p N=4 --over contact.mu --from .1 --to .01 --steps 4",
    ),
    _work("estimate", "estimate heaviside -n 2000 --sweep sigma=0.1:1:4"),
    _work("sweep", "sweep push-1d -p N=3 --over M=1:2:4"),
    _work(
        "train",
        "train ball-throw --iterations 4 -s samples=4 -s unroll=4 -s hidden=4 -s episodes=2"
        " -s evaluate_every=2 -p horizon=6 -j 1",
    ),
)
"""Commands that store a run; an estimate, a sweep and a training continue after a kill."""
TAKING = (
    _work("report", "report @1 -o out.pdf", "out.pdf"),
    _work("animate", "animate @5 -o out.html", "out.html"),
    _work("export", "export push-1d -p N=3 -o out.c", "out.c"),
    _work("runs export", "runs export heaviside -o out.npz", "out.npz"),
    _work("solve with a PDF", "solve wall-1d -p N=4 --pdf out.pdf --tag night", "out.pdf"),
)
"""Commands that write a file."""
ONE_AT_A_TIME = threading.Lock()
"""Lock for the netCDF library, which is not thread-safe."""
KINDS = tuple(work.name for work in MAKING)


def furnish(server: Server, directory: Path) -> Path:
    """Create a store ``runs`` in a directory, with one run of every kind; return the directory."""
    directory.mkdir(parents=True, exist_ok=True)
    for work in MAKING:
        end = server.run(work.arguments, directory)
        assert end.code == 0, f"{end.line}: {end.err}"
    return directory


def run_of(root: Path, kind: str) -> Path:
    """Return the path of the only run of a kind in a store."""
    (found,) = [entry.path for entry in store.list_runs(root) if (entry.meta or {}).get("kind") == kind]
    return found


def state_of(root: Path) -> dict[str, bytes]:
    """Return a mapping from relative path to content of all files below a directory, except hidden ones."""
    return {
        str(file.relative_to(root)): file.read_bytes()
        for file in sorted(root.rglob("*"))
        if file.is_file() and not any(part.startswith(".") for part in file.relative_to(root).parts)
    }


def harm_to(root: Path, before: dict[str, bytes], where: str) -> list[tuple[str, str]]:
    """Return the faults in a store: earlier runs that are lost or altered, and incomplete runs."""
    after, found = state_of(root), []
    for name, content in before.items():
        if name not in after:
            found.append(("lost run", f"{name}: {where}"))
        elif after[name] != content:
            found.append(("altered run", f"{name}: {where}"))
    for entry in store.list_runs(root):
        try:
            with ONE_AT_A_TIME:
                store.load(entry.path)
        except (DamagedRun, InputError) as error:
            found.append(("half run", f"{error}: {where}"))
    return found


def hashes(root: Path, but: Sequence[str] = ()) -> list[str]:
    """Return the content hashes of the runs in a store, except those at the paths ``but``."""
    entries = (entry for entry in store.list_runs(root) if str(entry.path) not in but)
    return [(entry.meta or {}).get("hash", "damaged") for entry in entries]


def leftovers(root: Path) -> list[str]:
    """Return the paths of hidden drafts below a directory."""
    return [str(path.relative_to(root)) for path in root.rglob(".ocp-partial-*")]


def whole(file: Path) -> bool:
    """Return whether a file of a known kind is complete."""
    content = file.read_bytes()
    match file.suffix:
        case ".pdf":
            return content.startswith(b"%PDF") and content.rstrip().endswith(b"%%EOF")
        case ".html":
            return content.rstrip().endswith(b"</html>")
        case ".gif":
            return content.startswith(b"GIF8") and content.endswith(b";")
        case ".json":
            return bool(json.loads(content))
        case ".c":
            return content.count(b"{") == content.count(b"}") > 0 and content.endswith(b"\n")
        case ".npz":
            return content[:2] == b"PK" and b"PK\x05\x06" in content[-os.sysconf("SC_PAGE_SIZE") :]
        case _:
            return bool(content)
