"""Every named problem under every law by every method: the README's table of 45 solves."""

import pytest

from dynamics.contact import Adaptive, Barrier, Exact
from ocp import Direct, MultipleShooting, SingleShooting, Solution, solve
from problems import get, names

LAWS = (Exact(), Barrier(mu=1e-3), Adaptive(sigma=0.02))
METHODS = (Direct(), MultipleShooting(), SingleShooting())


def cell(found: Solution) -> str:
    mark = "" if found.success else f" ({found.status.label})"
    return f"{found.cost:.6g} / {found.audit.exact_cost:.6g} / {found.iterations}{mark}"


@pytest.mark.bench
def test_all_combinations() -> None:
    """Exact law in shooting follows the barrier path (homotopy=true); all 45 must be solved."""
    print("\ncost under the law / cost replayed under the exact law / iterations\n")
    print("| problem | method | exact | barrier, mu = 1e-3 | adaptive, sigma = 0.02 |")
    print("|---|---|---|---|---|")
    unsolved = []
    for name in names():
        for method in METHODS:
            row = []
            for law in LAWS:
                settings = {"homotopy": "true"} if method.name != "direct" else {}
                found = solve(get(name), contact=law, transcription=method, settings=settings)
                row.append(cell(found))
                if not found.success:
                    unsolved.append((name, method.name, law.name))
            print(f"| `{name}` | {method.name} | {' | '.join(row)} |", flush=True)
    assert not unsolved
