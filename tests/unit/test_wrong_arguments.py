"""Every public constructor rejects plausible wrong arguments with a message of one sentence."""

from __future__ import annotations

import pytest

from tests.unit.wrong_arguments import TABLES, Call

CASES = {f"{table}: {said}": call for table, calls in TABLES.items() for said, call in calls.items()}


def test_the_table_has_a_hundred_calls() -> None:
    assert len(CASES) >= 100


@pytest.mark.parametrize(("case", "call"), CASES.items(), ids=list(CASES))
def test_a_wrong_argument_is_refused(case: str, call: Call) -> None:
    said = case.partition(": ")[2].strip()
    with pytest.raises((ValueError, KeyError)) as caught:
        call()
    message = str(caught.value)
    assert said in message
    assert "\n" not in message and len(message) < 400
