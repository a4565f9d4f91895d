"""What each attack did and what fell: kept as JSON under ``build/attack``, one file an attack.

``python -m tests.attack.ledger`` makes the table of the site from the files of the last whole
``make test-attack``, so that tests leave the tree as it is.
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
    """Attempts and faults of one attack; ``promise`` is what would be broken by a fault."""

    name: str
    promise: str
    attack: str
    order: int
    command: str
    attempts: int = 0
    faults: list[tuple[str, str]] = field(default_factory=list)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def count(self, found: Iterable[tuple[str, str]], attempts: int = 1) -> None:
        """Note attempts, and what was wrong with them."""
        with self._lock:
            self.attempts += attempts
            self.faults += found

    def told(self) -> str:
        """Every kind of fault with its number and one example each."""
        kinds = Counter(kind for kind, _ in self.faults)
        lines = [f"{len(self.faults)} faults in {self.attempts} attempts"]
        for kind, number in kinds.items():
            some = list(dict.fromkeys(words for one, words in self.faults if one == kind))
            lines += [f"{kind}: {number}", *(f"    {words}" for words in some[:12])]
        return "\n".join(lines)

    def keep(self, seed: int) -> None:
        """Write the counts for the table."""
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
    """Rows of the table in order, each promise once: attacks that differ in a parameter are one."""
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
    """The file of a command: whole, it would leave the table's words no room."""
    return command.partition(" -k ")[0].rpartition("/")[2]


def main() -> int:
    """Write the table from what the last attacks counted."""
    # Not with the imports above: attacks need nothing of the site.
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
