"""``ocp arena compare``: results of a file beside those of the workbench and of the sources."""

from __future__ import annotations

from pathlib import Path

import pytest

from problems.arena.published import published_results, workbench_results
from tests.cli.test_commands import strict

HEAD = "task,instance,cost,solved,iterations,seconds\n"


def ours(task: str) -> dict[int, float]:
    """Return the costs of certified answers of ocp solve by instance."""
    return {result.instance: result.cost for result in workbench_results(task) if result.solved}


def test_costs_are_counted_by_their_distance_from_those_of_ocp_solve(ocp) -> None:
    costs = ours("cartpole-friction")
    factors = dict(zip(costs, (1 - 2e-4, 1 + 0.5e-4, 1 + 2e-4), strict=False))
    lines = [f"cartpole-friction,{k},{costs[k] * factor!r},,,1.5" for k, factor in factors.items()]
    Path("results.csv").write_text(HEAD + "\n".join(lines))
    done = ocp("arena", "compare", "results.csv")
    assert done.code == 0
    assert done.out.splitlines()[1].split()[:4] == ["cartpole-friction", "3", "of", "3"]
    assert done.out.splitlines()[1].split()[-4:-1] == ["1", "1", "1"]
    found = strict(ocp("arena", "compare", "results.csv", "--json").out)["results"]
    for entry in found:
        known = [r for r in published_results("cartpole-friction") if r.instance == entry["instance"] and r.solved]
        assert entry["published_cost"] == min(result.cost for result in known)
        assert entry["workbench_cost"] == costs[entry["instance"]]
        assert entry["seconds"] == 1.5 and entry["iterations"] is None


def test_an_unsolved_result_counts_in_no_comparison(ocp) -> None:
    (instance, cost), *_ = ours("acrobot-stops").items()
    Path("results.csv").write_text(f"{HEAD}acrobot-stops,{instance},{cost / 2},false,,\n")
    shown = ocp("arena", "compare", "results.csv").out.splitlines()[1].split()
    assert shown[1:4] == ["0", "of", "1"] and shown[-4:-1] == ["0", "0", "0"]


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("", ["has no results", "task, instance, cost"]),
        ("task,instance,cost\nacrobot,1,2\n", ["unknown arena task 'acrobot'", "acrobot-stops"]),
        ("task,instance,cost\nacrobot-stops,0,2\n", ["line 2", "from 1 to 100, got 0"]),
        ("task,instance,cost\nwaiter,1,2\n", ["line 2", "from 0 to 0, got 1"]),
        ("task,cost\nwaiter,nan\n", ["line 2", "cost", "finite"]),
        ("task,price\nwaiter,1\n", ["line 2", "cost", "required"]),
        ("task,cost\nwaiter,1\nwaiter,2\n", ["instance 0 of waiter twice"]),
        ("task,cost\nwaiter,1,3\n", ["line 2", "more or fewer cells"]),
    ],
)
def test_a_wrong_file_is_refused_in_a_sentence(ocp, content: str, expected: list[str]) -> None:
    Path("results.csv").write_text(content)
    done = ocp("arena", "compare", "results.csv")
    assert done.code == 2 and done.out == ""
    for words in expected:
        assert words.lower() in done.err.lower()


def test_a_missing_file_is_named(ocp) -> None:
    done = ocp("arena", "compare", "none.csv")
    assert done.code == 2 and "none.csv cannot be read" in done.err
