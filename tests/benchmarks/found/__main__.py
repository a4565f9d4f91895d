"""Plans that the default command finds for strangers' problems: ``make bench-found``.

``python -m tests.benchmarks.found [NAME...] [--seeds N] [--effort WORD]`` solves each in a fresh process and compares
the exact replay with the best known plan; ``--reference NAME...`` looks for better ones (``--routes PATTERN...`` by
some of the ways), ``--before`` stores the answers as those that later ones are compared with, and ``--table`` only
writes the table of what is stored.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Mapping, Sequence
from statistics import median
from typing import Any

from docs.generator.measured import write_table
from tests.benchmarks.found.command import Answer, answer_of
from tests.benchmarks.found.problems import change_entry, keep_better, problem_names, stored
from tests.benchmarks.found.reference import find_best

TABLE = "found"
COLUMNS = ("problem", "best known", "before", "now", "above the best", "status", "certificate", "survives", "s")
NEAR = 0.05
"""Share of the best known cost by which a plan may exceed it and still counts as found."""
STORED_ANSWER = ("cost", "exact_cost", "status", "certificate", "survives", "survives_at_h", "seconds")
"""Fields of an answer that are stored."""


def excess(cost: float, best: float) -> float:
    """Return the excess of a cost over the best as a share of the best's size; infinite without a cost."""
    return (cost - best) / max(abs(best), 1e-12) if math.isfinite(cost) else math.inf


def written(cost: float | None) -> str:
    """Return a cost as text, a dash if there is none."""
    return "–" if cost is None or not math.isfinite(cost) else f"{cost:.5g}"


def cost_of(answer: Mapping[str, Any]) -> float:
    """Return the cost of an answer's exact replay, infinite if there is none."""
    cost = answer["exact_cost"]
    return math.inf if cost is None else cost


def row(name: str) -> list[str] | None:
    """Return the table's row of one problem, None before it is measured.

    Of several seeds it has the median of cost and time, and the words on the dearest answer.
    """
    entry = stored().get(name, {})
    if "known" not in entry or "now" not in entry:
        return None
    best, answers = entry["known"][-1]["cost"], entry["now"]
    dearest = max(answers, key=cost_of)
    cost = median(map(cost_of, answers))
    above, near = excess(cost, best), sum(is_near(answer, best) for answer in answers)
    share = "–" if math.isinf(above) else f"{above:+.1%}" if above < 10 else f"×{1 + above:.3g}"
    return [
        f"`{name}`",
        written(best),
        written(cost_of(entry["before"])) if "before" in entry else "–",
        written(cost),
        (f"**{share}**" if near == len(answers) else share) + (f" ({near}/{len(answers)})" if len(answers) > 1 else ""),
        dearest["status"],
        dearest["certificate"],
        "yes" if dearest["survives"] else "at this step" if dearest["survives_at_h"] else "no",
        f"{median(answer['seconds'] for answer in answers):.2g}",
    ]


def is_near(answer: Mapping[str, Any], best: float) -> bool:
    """Return whether the exact replay of an answer is within 5 % of the best known cost."""
    return excess(cost_of(answer), best) <= NEAR


def tell(arguments: str = "") -> None:
    """Write the table of the site from all that is stored, and print how many answers are near the best."""
    rows = [cells for name in problem_names() if (cells := row(name)) is not None]
    write_table(
        TABLE,
        title="What the default command finds",
        command=f"make bench-found{arguments}",
        columns=COLUMNS,
        rows=rows,
        note="Costs are those of exact replays; bold is within 5 % of the best known. Processor seconds.",
    )
    for cells in rows:
        print("  ".join(cells))
    entries = [entry for entry in stored().values() if "known" in entry]
    for word in ("before", "now"):
        answers = [(entry[word], entry["known"][-1]["cost"]) for entry in entries if word in entry]
        near = sum(all(is_near(answer, best) for answer in as_list(found)) for found, best in answers)
        print(f"{word}: {near} of {len(answers)} within {NEAR:.0%} of the best known")


def as_list(answers: Any) -> list[Any]:
    """Return the answers of all seeds, or the one before, as a list."""
    return answers if isinstance(answers, list) else [answers]


def measure(names: Sequence[str], seeds: int, effort: str | None, before: bool) -> None:
    """Solve the problems, store the answers and print a line of each."""
    options = ["--effort", effort] if effort else []
    for name in names:
        answers = [answer_of(name, [*options, "--seed", str(seed)]) for seed in range(seeds)]
        for answer in answers:
            keep_better(name, [answer.plan()] if math.isfinite(answer.exact_cost) else [])
        fields = [answer_fields(answer) for answer in answers]
        change_entry(name, now=fields, **({"before": fields[0]} if before else {}))
        print("  ".join(row(name) or [name, answers[0].status]), flush=True)


def answer_fields(answer: Answer) -> dict[str, object]:
    """Return the fields that are stored, with numbers to six digits and None for missing ones."""
    fields: dict[str, object] = {}
    for key in STORED_ANSWER:
        value = getattr(answer, key)
        is_float = isinstance(value, float)
        fields[key] = value if not is_float else float(f"{value:.6g}") if math.isfinite(value) else None
    return fields


def main() -> int:
    """Read the arguments, and measure or look for better plans."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.found")
    parser.add_argument("names", nargs="*", help="problems, all by default")
    parser.add_argument("--seeds", type=int, default=1, help="solve each with as many seeds")
    parser.add_argument("--effort", help="what --effort of ocp solve is given")
    parser.add_argument("--before", action="store_true", help="store the answers to compare later ones with")
    parser.add_argument("--reference", action="store_true", help="look for better plans by every way")
    parser.add_argument("--routes", nargs="*", default=(), help="patterns of the names of the ways to try")
    parser.add_argument("--table", action="store_true", help="only write the table of what is stored")
    options = parser.parse_args()
    known = problem_names()
    if unknown := [name for name in options.names if name not in known]:
        parser.error(f"unknown problem {unknown[0]!r}; there are {', '.join(known)}")
    names = options.names or known
    if not options.reference:
        if not options.table:
            measure(names, options.seeds, options.effort, options.before)
        tell((f" EFFORT={options.effort}" if options.effort else "") + f" SEEDS={options.seeds}")
        return 0
    for name in names:
        find_best(name, options.routes)
    return 0


if __name__ == "__main__":
    sys.exit(main())
