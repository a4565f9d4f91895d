"""The arena: ``python -m tests.benchmarks.arena [TASK ...] [--count N] [--jobs N]``.

Every task, and the first N instances of those that have some, is solved by the default command, with quick effort, and
by the published formulation, each in a process of its own. One judge holds all to the same tolerance and certificate.
Answers are stored as they come, so that the same command continues where it was stopped; a file of another commit or
computer begins anew. Answers of all tasks and instances make the site's table and figure.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from docs.generator.measured import DATA, origin, write_data
from problems.arena.published import INSTANCE_COUNT, published_results
from problems.registry import arena_names
from tests.benchmarks.arena.pool import Key, rows_of
from tests.benchmarks.arena.report import PEERS, WORDS, short_rows, write_answers, write_report

ANSWERS = DATA / "arena" / "answers.json"
"""File of the stored answers that make the site's table."""


def keys_of(tasks: list[str], count: int, ways: list[str]) -> list[Key]:
    """Return task, instance (0 where a task has none) and way of each answer; tasks without instances come first."""
    instances = {task: range(1, count + 1) if published_results(task) else [0] for task in tasks}
    order = sorted(tasks, key=lambda task: len(instances[task]))
    return [(task, instance, way) for task in order for instance in instances[task] for way in ways]


def stored_answers(file: Path, now: dict[str, str]) -> dict[Key, dict[str, Any]]:
    """Return the answers of a file by their keys; none if it is of another commit or computer."""
    content = json.loads(file.read_text()) if file.exists() else {}
    same = all(content.get(name) == now[name] for name in ("commit", "machine"))
    return {(row["task"], row["instance"], row["way"]): row for row in content["answers"]} if same else {}


def main() -> None:
    """Measure the chosen answers that the file does not have, and write table and figure if it then has all."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.arena", description=__doc__)
    parser.add_argument("tasks", nargs="*", metavar="TASK", help="tasks of ocp list arena; all if none is named")
    parser.add_argument("--count", type=int, default=INSTANCE_COUNT, help="instances of each task that has some")
    parser.add_argument("--ways", nargs="+", default=list(WORDS), choices=[*WORDS, *PEERS], help="ways of solving")
    parser.add_argument("--jobs", type=int, default=1, help="processes at a time")
    parser.add_argument("--limit", type=int, default=120, help="largest processor time of an answer [s]")
    parser.add_argument("--wall", type=float, default=1e6, help="wall-clock time after which all stops [s]")
    parser.add_argument("--out", type=Path, default=ANSWERS, help="file of the answers")
    parser.add_argument("--commit", help="revision of the source where git does not know it")
    parser.add_argument("--report", type=Path, metavar="FILE", help="write table and figure of the answers of a file")
    parser.add_argument("--peers", type=Path, metavar="FILE", help="write the table of peers of the answers of a file")
    options = parser.parse_args()
    if options.peers:
        write_answers("arena-peers", json.loads(options.peers.read_text()))
    if options.report:
        content = json.loads(options.report.read_text())
        write_report(content)
        print(*short_rows(content["answers"]), sep="\n")
    if options.peers or options.report:
        return
    now = origin("make arena") | ({"commit": options.commit[:10]} if options.commit else {})
    answers = stored_answers(options.out, now)
    keys = [key for key in keys_of(options.tasks or arena_names(), options.count, options.ways) if key not in answers]
    print(f"{len(answers)} answers stand, {len(keys)} are missing", flush=True)
    for number, row in enumerate(rows_of(keys, options.jobs, options.limit, options.wall), 1):
        answers[row["task"], row["instance"], row["way"]] = row
        print(f"{number}/{len(keys)}", *row.values(), flush=True)
        write_data(str(options.out.resolve().with_suffix("")), {**now, "answers": sorted_rows(answers)})
    if set(keys_of(arena_names(), INSTANCE_COUNT, list(WORDS))) <= answers.keys():
        write_report({**now, "answers": sorted_rows(answers)})


def sorted_rows(answers: dict[Key, dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the rows in the order of tasks, instances and ways."""
    order = arena_names()
    return [answers[key] for key in sorted(answers, key=lambda key: (order.index(key[0]), *key[1:]))]


if __name__ == "__main__":
    main()
