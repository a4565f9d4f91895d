"""The tables that compare published algorithms with those here are complete, and their numbers are right."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from ocp.learning.mbpo import MBPO
from ocp.learning.protocol import MIN_OBSERVATION_SCALE
from ocp.learning.training import ALGORITHMS
from problems.tasks import registry

PAGE = Path(__file__).parents[2] / "docs" / "theory" / "policies.md"


def tables() -> dict[str, dict[str, tuple[str, str]]]:
    """Return a mapping from algorithm to its rows, from subject to (as published, here)."""
    found = {}
    for part in PAGE.read_text().split("\n### ")[1:]:
        name = re.match(r"`([\w-]+)`", part)
        rows = re.findall(r"^\| (.+?) \| (.+?) \| (.+?) \|$", part, re.M)
        assert name and "| | as published | here |" in part
        found[name[1]] = {subject: (there, here) for subject, there, here in rows if there != "---"}
    return found


def test_every_algorithm_has_a_table_of_what_is_not_as_published():
    found = tables()
    assert set(found) == set(ALGORITHMS)
    assert all(len(rows) >= 3 for rows in found.values())
    assert PAGE.read_text().index("## As published, and here") > 0


@pytest.mark.parametrize(
    ("name", "subject", "words"),
    [
        ("ars", "scale of an observation", f"at least {MIN_OBSERVATION_SCALE:g}"),
        ("ars", "size", f"{registry.spec('hopper').training['ars']['iterations']} iterations"),
        ("aobg", "gamma", f"{ALGORITHMS['aobg']().settings()['gamma']:g} by default"),
        ("aobg", "delta", f"{ALGORITHMS['aobg']().settings()['delta']:g}"),
        (
            "mbpo",
            "updates of the actor-critic",
            f"{MBPO().updates} for the {MBPO().n_envs * MBPO().steps} steps",
        ),
        (
            "mbpo",
            "rewards that the critics see",
            f"clipped to {registry.spec('hopper').training['mbpo']['reward_clip']:g} in size",
        ),
        ("mbpo", "fit of the ensemble", f"{MBPO().model_steps} steps"),
        (
            "mbpo",
            "branches",
            f"{MBPO().branches} an iteration, growing from {MBPO().min_branch} to {MBPO().max_branch}",
        ),
    ],
)
def test_a_number_of_a_table_is_the_code_s(name: str, subject: str, words: str):
    assert words in tables()[name][subject][1]
