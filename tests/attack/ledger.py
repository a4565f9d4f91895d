"""Counts of attempts and faults of each attack, stored as JSON under ``build/attack``, one file per attack.

``python -m tests.attack.ledger`` writes the site's table from the files of the last complete
``make test-attack``, so that tests do not change the tree.
"""

from __future__ import annotations

import json
import sys
import threading
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.attack.program import ROOT

KEPT = ROOT / "build" / "attack"
TABLE = "promises"


@dataclass
class Tally:
    """Attempts and faults of one attack; ``promise`` is the promise to users that a fault would break."""

    name: str
    promise: str
    attack: str
    order: int
    command: str
    attempts: int = 0
    faults: list[tuple[str, str]] = field(default_factory=list)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def count(self, found: Iterable[tuple[str, str]], attempts: int = 1) -> None:
        """Add attempts and the faults found, pairs of kind and text."""
        with self._lock:
            self.attempts += attempts
            self.faults += found

    def told(self) -> str:
        """Return a text of all kinds of faults with their numbers and examples."""
        kinds = Counter(kind for kind, _ in self.faults)
        lines = [f"{len(self.faults)} faults in {self.attempts} attempts"]
        for kind, number in kinds.items():
            some = list(dict.fromkeys(words for one, words in self.faults if one == kind))
            lines += [f"{kind}: {number}", *(f"    {words}" for words in some[:12])]
        return "\n".join(lines)

    def keep(self, seed: int) -> None:
        """Store the counts as JSON for the table."""
        KEPT.mkdir(parents=True, exist_ok=True)
        counts = {
            "order": self.order,
            "promise": self.promise,
            "attack": self.attack,
            "attempts": self.attempts,
            "faults": len(self.faults),
            "command": self.command,
            "seed": seed,
        }
        (KEPT / f"{self.name}.json").write_text(json.dumps(counts, indent=1))


def rows(kept: list[dict[str, Any]]) -> list[list[str | int]]:
    """Return the rows of the table in order; attacks that differ only in a parameter are merged."""
    merged: dict[tuple[int, str, str, str], list[int]] = {}
    for one in kept:
        key = (one["order"], one["promise"], one["attack"], one["command"])
        counts = merged.setdefault(key, [0, 0])
        counts[0] += one["attempts"]
        counts[1] += one["faults"]
    found, before = [], ""
    for (_, promise, attack, command), counts in sorted(merged.items()):
        found.append(["" if promise == before else promise, attack, *counts, f"`{_file(command)}`"])
        before = promise
    return found


def _file(command: str) -> str:
    """Return the file name in a command, which is short enough for the table."""
    return command.partition(" -k ")[0].rpartition("/")[2]


def main() -> int:
    """Write the table from the counts of the last attacks; return the exit code."""
    # This is no global import, since attacks do not need the site's generator.
    from docs.generator.measured import write_table

    kept = [json.loads(file.read_bytes()) for file in KEPT.glob("*.json")]
    if not kept:
        print(f"{KEPT} holds no counts; make test-attack writes them", file=sys.stderr)
        return 2
    columns = ("promise", "attack", "attempts", "faults", "file")
    seeds = sorted({one["seed"] for one in kept})
    file = write_table(
        TABLE,
        title="Promises, and the attacks on them",
        command="make test-attack",
        columns=columns,
        rows=rows(kept),
        note=f"`pytest -m attack tests/attack/FILE` repeats what one file holds;"
        f" ATTACK_SEED = {', '.join(map(str, seeds))}.",
    )
    print(Path(file).relative_to(ROOT))
    return 0


if __name__ == "__main__":
    sys.exit(main())
