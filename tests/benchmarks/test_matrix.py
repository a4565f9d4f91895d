"""Every named problem under every law by every method: the site's table of solves."""

import pytest

from docs.generator.measured import write_table
from dynamics.contact import Adaptive, Barrier, Exact
from ocp import Direct, MultipleShooting, SingleShooting, Solution, solve
from problems import get, names

LAWS = (Exact(), Barrier(mu=1e-3), Adaptive(sigma=0.02))
METHODS = (Direct(), MultipleShooting(), SingleShooting())
MACHINES = ("hopper", "half-cheetah")


def left_out(name: str, method: str, law: str) -> str:
    """Why a combination is not run, or nothing: a minute of processor time is what we wait."""
    if name == "half-cheetah" and method == "single-shooting":
        return "chooses its start"
    if name not in MACHINES:
        return ""
    quick = method == "direct" or (name, law) == ("half-cheetah", "exact")
    return "" if quick and law != "adaptive" else "over a minute"


def cell(found: Solution) -> str:
    mark = "" if found.success else f" ({found.status.label})"
    costs = (found.cost, found.audit.exact_cost, found.referee.cost)
    return " / ".join(f"{cost:.6g}" for cost in costs) + f" / {found.iterations}{mark}"


@pytest.mark.bench
def test_all_combinations() -> None:
    """All must be certified."""
    rows, unsolved = [], set()
    for name in names():
        for method in METHODS:
            row = [f"`{name}`", method.name]
            for law in LAWS:
                if why := left_out(name, method.name, law.name):
                    row.append(why)
                    continue
                found = solve(get(name), contact=law, method=method)
                row.append(cell(found))
                if not found.success:
                    unsolved.add((name, method.name, law.name))
            print("  ".join(row), flush=True)
            rows.append(row)
    write_table(
        "matrix",
        title="Every problem, law and method",
        command="pytest -m bench -s tests/benchmarks/test_matrix.py",
        columns=("problem", "method", "exact", "barrier, mu = 1e-3", "adaptive, sigma = 0.02"),
        rows=rows,
    )
    assert not unsolved
