"""Table of IPOPT iterations of push-disc, cold and from a stored run with other parameters."""

import pytest

from docs.generator.measured import write_table
from ocp import solve

LAWS = {
    "barrier, mu = 1e-3": ("barrier", {"mu": 1e-3}),
    "exact": ("exact", {}),
    "adaptive, sigma = 0.03": ("adaptive", {"sigma": 0.03}),
}
CHANGES = {
    "N 20 to 40, h halved": ({}, {"N": 40, "h": 0.05}),
    "40 to 80": ({"N": 40, "h": 0.05}, {"N": 80, "h": 0.025}),
    "N 20 to 30": ({}, {"N": 30}),
    "M 1 to 1.2": ({}, {"M": 1.2}),
    "M 1.2 to 2": ({"M": 1.2}, {"M": 2.0}),
}
"""Parameters of the earlier run, and of the run whose iterations are counted."""


@pytest.mark.bench
def test_a_run_before_saves_iterations() -> None:
    """Each pair ends at the same cost, with fewer iterations from the earlier run."""
    rows = []
    for law, (contact, parameters) in LAWS.items():
        row = [law]
        for before, after in CHANGES.values():
            asked = {"contact": contact, "contact_settings": parameters}
            cold = solve("push-disc", params=after, **asked)
            start = solve("push-disc", params=before, **asked)
            warm = solve("push-disc", params=after, warm_start=start, **asked)
            assert warm.cost == pytest.approx(cold.cost, rel=1e-4)
            assert warm.iterations < cold.iterations
            row.append(f"{cold.iterations} / {warm.iterations}")
        print("  ".join(row), flush=True)
        rows.append(row)
    write_table(
        "warm-starts",
        title="IPOPT iterations on push-disc, cold / from the run before",
        command="pytest -m bench -s tests/benchmarks/ocp/test_warm_starts.py",
        columns=("law", *CHANGES),
        rows=rows,
    )
