"""The arena: ``python -m tests.benchmarks.arena [TASK ...] [--count N]``.

Every task, and the first N instances of those that have some, is solved by the default command and by the published
formulation. One judge holds both to the same tolerance and certificate. Answers are kept in
``docs/generated/data/arena/answers.json``, so that a task can be run again alone; the table and the figure of the site
are made from all of them.
"""

from __future__ import annotations

import argparse

from docs.generator.measured import DATA, origin, read, write_data
from problems.arena.published import published_results
from problems.registry import arena_names
from tests.benchmarks.arena.race import limited
from tests.benchmarks.arena.report import WORDS, write_report

ANSWERS = "arena/answers"
"""Name of the stored answers."""


def main() -> None:
    """Measure the chosen tasks, store each answer at once, and write table and figure."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.arena", description=__doc__)
    parser.add_argument("tasks", nargs="*", metavar="TASK", help="tasks of ocp list arena; all if none is named")
    parser.add_argument("--count", type=int, default=10, help="instances of each task that has some")
    parser.add_argument("--limit", type=int, default=120, help="largest processor time of an answer [s]")
    options = parser.parse_args()
    stored = read(ANSWERS)["answers"] if (DATA / f"{ANSWERS}.json").exists() else []
    for task in options.tasks or arena_names():
        instances = range(1, options.count + 1) if published_results(task) else [0]
        for instance in instances:
            for way in WORDS:
                entry = limited(task, instance, way, options.limit)
                key = [entry[name] for name in ("task", "instance", "way")]
                stored = [other for other in stored if [other[name] for name in ("task", "instance", "way")] != key]
                stored.append(entry)
                print(*entry.values(), flush=True)
        order = arena_names()
        stored.sort(key=lambda entry: (order.index(entry["task"]), entry["instance"], entry["way"]))
        write_data(ANSWERS, {**origin("make arena"), "answers": stored})
    write_report(stored)


if __name__ == "__main__":
    main()
