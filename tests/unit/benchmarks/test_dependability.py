"""The table of ``make bench-solve``: its statistics, and the rows that it keeps."""

from __future__ import annotations

from dataclasses import replace

import pytest

from docs.generator.measured import read
from tests.benchmarks.ocp.dependability import (
    COLUMNS,
    TABLE,
    Start,
    audited,
    certified,
    from_guess,
    merged,
    row,
)


def starts() -> list[Start]:
    """Return a default start that fails, ten starts with costs of 1.00 to 1.09, and ten more that fail."""
    costs = [9.0, *(1 + k / 100 for k in range(10)), *[0.5] * 10]
    return [
        Start(
            "hopper",
            k,
            60,
            16,
            1 <= k <= 10,
            1 <= k <= 4,
            "infeasible",
            cost,
            10 * k,
            k / 4,
            k / 8,
            2 * cost,
            k % 2 == 1,
            "",
        )
        for k, cost in enumerate(costs)
    ]


def test_row_counts_audited_and_certified_answers_apart() -> None:
    cells = row(starts())
    assert cells[0] == "`hopper`" and cells[1:3] == ["60", "16"]
    assert (audited(starts()), certified(starts())) == (10, 4) and cells[3:5] == ["10", "4"]
    assert cells[5] == "infeasible", "the default guess"
    assert cells[6:9] == ["100", "2.5", "1.2"], "medians of all 21, failures too"
    assert cells[9:11] == ["1", "1.09"], "the cheap failures are no answers"
    assert cells[11] == "2 of 21"
    assert cells[12:] == ["2", "yes", "16"], "the referee's word on the best one"


def test_a_problem_never_solved_has_no_cost() -> None:
    cells = row([replace(start, audited=False, success=False) for start in starts()])
    assert cells[3] == "0" and cells[9] == cells[10] == "nan" and cells[11] == "0 of 21"


def test_fresh_rows_replace_their_own_and_leave_the_rest() -> None:
    filled = merged([], [["`hopper`", "1"], ["`wall-1d`", "2"]])
    assert filled == [["`wall-1d`", "2"], ["`hopper`", "1"]], "in the registry's order"
    assert merged(filled, [["`hopper`", "3"]]) == [["`wall-1d`", "2"], ["`hopper`", "3"]]


def test_the_stored_table_has_these_columns() -> None:
    stored = read(TABLE)
    assert tuple(stored["columns"]) == COLUMNS
    assert {len(cells) for cells in stored["rows"]} == {len(COLUMNS)}


@pytest.mark.costly
def test_a_start_is_its_own() -> None:
    """Guess 2 gives the same solve whatever was solved before; another guess gives another."""
    alone = from_guess("wall-1d", 2)
    other = from_guess("wall-1d", 0)
    again = from_guess("wall-1d", 2)
    assert alone.success and other.success
    timeless = {"seconds": 0.0, "certificate_s": 0.0}
    assert replace(alone, **timeless) == replace(again, **timeless)
    assert (other.iterations, other.where) != (alone.iterations, alone.where)
