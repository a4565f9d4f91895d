"""Exact complementarity: speed of the default strategy against Scholtes' loop as users write it."""

from __future__ import annotations

import math

import pytest

from dynamics.contact import Exact
from ocp.routes.homotopy import RouteResult
from ocp.routes.relaxations import DEFAULT_STRATEGY, STRATEGIES
from tests.benchmarks.ocp.cases import FIVE, LCS, same_guess, session
from tests.benchmarks.ocp.models import MODELS
from tests.benchmarks.ocp.opti_peer import scholtes
from tests.benchmarks.ocp.race import alternate, ms, tell

SET = (*FIVE, LCS)
FASTER, SLACK = 4.0, 5e-3


def ours(name: str, strategy: str) -> RouteResult:
    """Do everything from the problem's parameters to the polished solution."""
    return session(name, Exact(), strategy=strategy).solve()


@pytest.mark.bench
def test_default_strategy_against_scholtes_with_cold_starts() -> None:
    """The total time over the set is compared: set-up, all stages, polish.

    The script reduces t from 1 to 1e-8 by factors of 0.1 and solves every stage tightly from cold
    multipliers; ``cold`` is the workbench's strategy of the same kind, on its own NLP.
    """
    rows, worse = [], []
    total = {"default": 0.0, "script": 0.0, "cold": 0.0}
    logs = {"script": 0.0, "cold": 0.0}
    for name in SET:
        model, guess = MODELS[name](), same_guess(session(name, Exact()))
        runs = {
            "default": lambda n=name: ours(n, DEFAULT_STRATEGY),
            "script": lambda m=model, g=guess: scholtes(m, g),
            "cold": lambda n=name: ours(n, "scholtes-cold"),
        }
        seconds, found = alternate(runs, 3)
        default, script, cold = (found[key] for key in ("default", "script", "cold"))
        assert default.finished and default.result.ok
        best = min([script.cost] if script.ok else [], default=math.inf)
        best = min(best, cold.result.f if cold.result.ok else math.inf)
        costs = (default.result.f, script.cost, cold.result.f)
        steps = (default.trace.iterations, script.iterations, cold.trace.iterations)
        rows.append(
            [
                name,
                " / ".join(f"{cost:.6g}" for cost in costs),
                " / ".join(map(str, steps)),
                " / ".join(ms(seconds[key]) for key in total),
                *(f"{seconds[key] / seconds['default']:.1f}" for key in logs),
            ]
        )
        for key in total:
            total[key] += seconds[key]
        for key in logs:
            logs[key] += math.log(seconds[key] / seconds["default"]) / len(SET)
        worse += [name] if default.result.f > best + SLACK * abs(best) else []
    ratio = {key: total[key] / total["default"] for key in logs}
    sums = " / ".join(ms(total[key]) for key in total)
    rows.append(["sum", "", "", sums, *(f"{ratio[key]:.1f}" for key in logs)])
    means = (f"{math.exp(logs[key]):.1f}" for key in logs)
    rows.append(["geometric mean", "", "", "", *means])
    columns = ["default / script / cold", "cost", "iterations", "ms", "script", "cold"]
    tell(f"Exact law: {DEFAULT_STRATEGY} against Scholtes' loop", columns, rows)
    assert not worse
    assert ratio["script"] >= FASTER


@pytest.mark.bench
def test_all_strategies() -> None:
    """The table shows objective, iterations and milliseconds of every strategy on every problem."""
    costs: dict[str, dict[str, float]] = {}
    tables: dict[str, list[list[object]]] = {"Cost": [], "Iterations": [], "Milliseconds": []}
    for strategy in STRATEGIES:
        runs = {name: lambda n=name, s=strategy: ours(n, s) for name in SET}
        seconds, found = alternate(runs, 1)
        good = {name: found[name].finished and found[name].result.ok for name in SET}
        costs[strategy] = {n: found[n].result.f if good[n] else math.nan for n in SET}
        steps = [found[name].trace.iterations for name in SET]
        tables["Cost"].append([strategy, *(f"{costs[strategy][n]:.6g}" for n in SET), ""])
        tables["Iterations"].append([strategy, *steps, sum(steps)])
        tables["Milliseconds"].append([strategy, *(ms(seconds[name]) for name in SET), ms(sum(seconds.values()))])
    for title, rows in tables.items():
        tell(f"{title} of every strategy, exact law", ["strategy", *SET, "sum"], rows)
    for name in SET:
        lowest = min(cost[name] for cost in costs.values() if math.isfinite(cost[name]))
        assert costs[DEFAULT_STRATEGY][name] <= lowest + SLACK * abs(lowest), name
