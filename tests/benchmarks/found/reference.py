"""Best known plans by a large budget: every way to an exact plan that the command line offers, one after the other.

Limits count starts, seeds and iterations, and are never of time. Costs of the exact replay are compared.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from fnmatch import fnmatch

from tests.benchmarks.found.command import Answer, answer_of
from tests.benchmarks.found.problems import Plan, best_plan, keep_better
from tests.benchmarks.found.sampled import LongSampling, can_sample

EXACT = ("--contact", "exact")
STRATEGIES = (
    "scholtes",
    "scholtes-exact",
    "l1-scholtes",
    "scholtes-adaptive",
    "l1",
    "scholtes-quick",
    "scholtes-cold",
    "fischer-burmeister",
    "lin-fukushima",
)
SMOOTHINGS = (
    ("barrier", "mu=1e-3"),
    ("barrier", "mu=1e-2"),
    ("barrier", "mu=1e-4"),
    ("adaptive", "sigma=0.02"),
)
SEARCHES = 3
"""Seeds of the sampled search."""
STARTS = 8
"""Perturbed guesses of the default route, and of the one strategy that differs most from it."""
SAMPLED = "sampled"
"""Name of the way that samples for long, without the program's search."""
AROUND = "around"
"""Name of the way that moves every input of the best known plan."""
NEAR = "near"
"""Name of the way that solves near the best known plan."""
Route = list[tuple[str, ...]]
"""Arguments of commands, each of which, except the first, starts from the run before."""


def routes() -> dict[str, Route]:
    """Return every way by its name, the ones that found most first."""
    smoothed = {f"{law} {value}, then exact": [("--contact", law, "-c", value), EXACT] for law, value in SMOOTHINGS}
    return {
        "default": [()],
        "scholtes": [(*EXACT, "-s", "strategy=scholtes")],
        **dict(list(smoothed.items())[:1]),
        "search, seed 0": [(*EXACT, "--search", "--seed", "0")],
        **{name: [(*EXACT, "-s", f"strategy={name}")] for name in STRATEGIES[1:]},
        **dict(list(smoothed.items())[1:]),
        **{f"search, seed {k}": [(*EXACT, "--search", "--seed", str(k))] for k in range(1, SEARCHES)},
        f"{STARTS} starts": [(*EXACT, "--starts", str(STARTS), "--rank", "exact")],
        f"{STARTS} starts, l1": [(*EXACT, "-s", "strategy=l1", "--starts", str(STARTS), "--rank", "exact")],
    }


def followed(name: str, route: Route) -> Iterator[Answer]:
    """Yield the answers of a route's commands, until a command has none."""
    run = ""
    for arguments in route:
        answer = answer_of(name, (*arguments, *(("--from", run) if run else ())))
        yield answer
        run = answer.run
        if not run:
            return


def find_best(name: str, patterns: Sequence[str] = ()) -> None:
    """Try the routes whose names fit one of the ``patterns``, all by default, and keep better plans than before."""
    for route_name, route in routes().items():
        if not chosen(route_name, patterns):
            continue
        for answer in followed(name, route):
            cost = f"{answer.exact_cost:.6g}" if not math.isnan(answer.exact_cost) else answer.status
            better = keep_better(name, [answer.plan()] if answer.survives_at_h else [])
            told = " best so far" if better else ""
            print(f"{name:<20}{route_name:<28}{cost:>12} {answer.seconds:>7.1f} s{told}", flush=True)
    if not can_sample(name):
        return
    if chosen(SAMPLED, patterns):
        keep_all(name, LongSampling(name).best_plans())
    if chosen(AROUND, patterns) and (plan := best_plan(name)) is not None:
        keep_all(name, LongSampling(name).around(plan))
    if chosen(NEAR, patterns) and (plan := best_plan(name)) is not None:
        keep_all(name, LongSampling(name).near(plan))


def chosen(route_name: str, patterns: Sequence[str]) -> bool:
    """Return whether a way is to be tried: its name fits a pattern, or there are none."""
    return not patterns or any(fnmatch(route_name, pattern) for pattern in patterns)


def keep_all(name: str, plans: Iterable[Plan]) -> None:
    """Keep plans that are better than all before, and print a line for every plan."""
    for plan in plans:
        told = " best so far" if keep_better(name, [plan]) else ""
        print(f"{name:<20}{plan.command.partition(': ')[2]:<60}{plan.cost:>12.6g}{told}", flush=True)
