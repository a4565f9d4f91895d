"""The papers behind the problems, read from ``references.bib``."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

_FILE = Path(__file__).with_name("references.bib")


def full_citation(key: str) -> str:
    """Return ``authors: title, year`` of an entry; a key that is not there stands for itself."""
    entry = _entries().get(key)
    if entry is None:
        return key
    names = [" ".join(reversed(name.split(", "))) for name in entry["author"].split(" and ")]
    last = f" and {names[-1]}" if len(names) > 1 else names[-1]
    where = f", {entry['booktitle']}" if "booktitle" in entry else ""
    title = entry["title"] + ("" if entry["title"].endswith("?") else ",")
    return f"{', '.join(names[:-1])}{last}: {title}{where} {entry['year']}".replace(",,", ",")


@cache
def _entries() -> dict[str, dict[str, str]]:
    found = {}
    for key, body in re.findall(r"@\w+\{([^,]+),\n(.*?)\n\}", _FILE.read_text(), re.DOTALL):
        found[key] = dict(re.findall(r"(\w+) = \{(.*)\}", body))
    return found
