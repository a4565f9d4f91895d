"""Stored runs that are changed and then get matching checksums, as a malicious sender could do."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ocp.store.run_files import META_FILE, seal_run


def reseal(run: Path, change: Callable[[dict[str, Any]], Any], **parts: bytes) -> None:
    """Apply ``change`` to the description of a stored run, and write it with a matching checksum.

    ``parts`` maps the names of other files, without ending, to their new content.
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
    """Write the description ``body``, a JSON object without its last brace, with a matching checksum."""
    end = f',\n "checksum": "{hashlib.sha256(body).hexdigest()}"\n}}\n'
    (run / META_FILE).write_bytes(body + end.encode())


def having(**entries: Any) -> Callable[[dict[str, Any]], Any]:
    """Return a change of a description that sets ``entries``."""
    return lambda meta: meta.update(entries)


def lacking(*names: str) -> Callable[[dict[str, Any]], Any]:
    """Return a change of a description that removes the entries ``names``."""
    return lambda meta: [meta.pop(name) for name in names]
