"""Runs changed by hand whose checksums agree all the same, as a sender can make them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ocp.store.run_files import META_FILE, seal_run


def reseal(run: Path, change: Callable[[dict[str, Any]], Any], **parts: bytes) -> None:
    """Let ``change`` work on the description of a stored run, and seal it again.

    ``parts`` are other files, by their names without ending.
    """
    meta = json.loads((run / META_FILE).read_bytes())
    names = list(meta["parts"])
    del meta["checksum"], meta["parts"]
    given = {name: (run / name).read_bytes() for name in names}
    given |= {name: parts[stem] for name in names if (stem := Path(name).stem) in parts}
    change(meta)
    for name, content in seal_run(meta, given).items():
        (run / name).write_bytes(content)


def seal_text(run: Path, body: bytes) -> None:
    """Make ``body``, an object in JSON but for its last brace, the description, and seal it."""
    end = f',\n "checksum": "{hashlib.sha256(body).hexdigest()}"\n}}\n'
    (run / META_FILE).write_bytes(body + end.encode())


def having(**entries: Any) -> Callable[[dict[str, Any]], Any]:
    """A change that sets entries."""
    return lambda meta: meta.update(entries)


def lacking(*names: str) -> Callable[[dict[str, Any]], Any]:
    """A change that removes entries."""
    return lambda meta: [meta.pop(name) for name in names]
