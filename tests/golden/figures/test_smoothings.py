"""Study N3: parts agree with closed forms and known optima, and claims follow synthetic data."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import xarray as xr

from docs.generator.law_tables import smoothing_rows
from problems import studies
from problems.registry import spec
from problems.studies.smoothings_compared.data import (
    ANALYTIC,
    LAWS,
    LEARNED,
    PROBLEMS,
    SHARES,
    TRUSTED,
    Params,
    TaskData,
    excess_cost,
    replay_gap,
    rest_cost,
    run,
)
from reports.drawing.style import house_style, to_svg
from reports.figures.studies import DRAWINGS
from reports.tables.law_tables import excess_text
from tests.golden.figures.compared import SEEDS, SETTINGS, Made, compared


def usual(key: str) -> tuple[float, float]:
    """Return costs by key: sharp laws close except on planar-hand, gentle and learned ones expensive."""
    if "exact" in key:
        return 1.0, 1.0
    if "trust" in key:
        weight = float(key.split("-trust-")[1].split("-")[0])
        return 2.0 + weight, 5.0 - 2 * weight
    if "ewda" in key or "mlp" in key:
        return 2.0, 4.0 if "noised" in key else 5.0
    if "hand" in key or "gentle" in key:
        return 0.9, 1.5
    return 1.0, 1.02


def verdicts(data: xr.Dataset) -> dict[str, bool]:
    return {claim.claim: bool(claim.holds) for claim in studies.get("N3").claims(data)}


def test_standing_still_costs_what_the_sum_of_its_stages_does() -> None:
    p = spec("push-1d").params({})
    off = (p.goal_x - p.qu0) ** 2
    assert rest_cost("push-1d") == pytest.approx((p.N * p.w_x + p.w_end) * off, rel=1e-6)
    q = spec("planar-push").params({})
    away = q.w_x * ((q.ox0 - q.goal_x) ** 2 + (q.oy0 - q.goal_y) ** 2)
    away += q.w_angle * (q.angle0 - q.goal_angle) ** 2
    away += q.w_a * ((q.ax0 - q.rest_x) ** 2 + (q.ay0 - q.rest_y) ** 2)
    assert rest_cost("planar-push") == pytest.approx((q.N + q.w_end) * away, rel=1e-6)


@pytest.mark.costly
def test_plans_of_known_laws_have_known_costs() -> None:
    source, golden = TaskData("push-1d", 0, SETTINGS), spec("push-1d").golden
    plan, replay, survives, _, learning, _ = source.planned("exact")["told"]
    assert plan == pytest.approx(golden["exact"].cost, rel=1e-6)
    assert replay == pytest.approx(plan, rel=1e-6)
    assert survives == 1
    assert learning < 0.01
    plan, replay, *_ = source.planned("barrier")["told"]
    assert plan == pytest.approx(golden["barrier mu=1e-3"].cost, rel=1e-6)
    assert replay > golden["exact"].cost


@pytest.mark.costly
def test_a_trusting_plan_starts_at_the_other_and_pays_for_the_data() -> None:
    source = TaskData("push-1d", 0, Params(data=5000))
    bare = source.planned("ewda")["told"]
    same, trusting = (source.trusting(share)["told"] for share in (1e-9, 0.1))
    assert same[:2] == pytest.approx(bare[:2], rel=1e-3)
    assert trusting[0] > 1.01 * bare[0]
    assert bare[4] > 0
    assert trusting[4] == 0


@pytest.mark.costly
def test_rows_stand_where_their_names_say() -> None:
    finished = Made(lambda key: (float(len(key)), 10.0 * len(key)))
    data = run(SETTINGS, finished)
    assert len(set(finished.keys)) == len(PROBLEMS) * (5 + SEEDS * (5 + len(SHARES)))
    for law in LAWS:
        seeded = data["cost"].sel(law=law, motion="plan", problem="push-1d").values
        key = f"push-1d-{law}-0" if law != "trusting ewda" else f"push-1d-trust-{TRUSTED:g}-0"
        assert list(seeded) == [len(key)] * SEEDS
    trusted = data["trusting_cost"].sel(share=TRUSTED).values
    assert np.array_equal(trusted, data["cost"].sel(law="trusting ewda").values)
    # Its times include those of the plan from which it starts.
    assert np.all(data["seconds"].sel(law="trusting ewda", part="solving") == 6)
    assert np.array_equal(data["trusting_cost"].sel(share=0), data["cost"].sel(law="ewda"))
    assert float(replay_gap(data["cost"]).mean()) == pytest.approx(9)
    assert np.all(excess_cost(data).sel(law="exact") == 0)


@pytest.mark.costly
def test_claims_follow_the_data() -> None:
    found = verdicts(compared(usual))
    failing = {
        "gentle barrier: the plan is close to the exact optimum",
        "barrier: the plan is close to the exact optimum",
        "sharp barrier: the plan is close to the exact optimum",
        "adaptive: the plan is close to the exact optimum",
        "randomized: the plan is close to the exact optimum",
        "A surviving plan of a learned law is close to the exact optimum",
    }
    assert {claim for claim, holds in found.items() if not holds} == failing


@pytest.mark.costly
@pytest.mark.parametrize(
    ("where", "costs", "flipped"),
    [
        ("hand-barrier", (1.0, 1.05), "planar-hand: no smoothing comes close"),
        ("barrier", (1e6, 1e6), "planar-push: every analytic smoothing makes progress"),
        ("clean-mlp", (1e6, 1e6), "planar-hand: every learned law makes progress"),
        ("disc-adaptive", (0.9, 0.9), "No law's plan is cheaper"),
        ("1d-sharp-barrier", (1.0, 1.09), "The smaller mu"),
        ("1d-clean-mlp", (1.0, 1.01), "Every learned law's plan costs more"),
        ("1d-noised-mlp", (2.0, 6.0), "Noise on its data"),
        ("push-randomized-1", (1.0, 1.7), "Another seed of the randomized law"),
        ("push-clean-mlp-1", (2.0, 8.0), "Another seed of a learned law"),
        ("1d-randomized", (1.5, 1.5), "A surviving plan of an analytic law"),
        ("-trust-1-", (2.4, 24.0), "Trust brings the replay nearer"),
        ("push-trust-", (2.5, 4.9), "Trust makes the plan cheaper"),
        ("push-trust-1-", (2.1, 3.0), "Too much trust"),
    ],
)
def test_each_claim_can_fail(where: str, costs: tuple[float, float], flipped: str) -> None:
    before = verdicts(compared(usual))
    after = verdicts(compared(lambda key: costs if where in key else usual(key)))
    name = next(claim for claim in before if claim.startswith(flipped))
    assert before[name]
    assert not after[name]


@pytest.mark.costly
def test_a_law_that_is_close_everywhere_is_said_to_be() -> None:
    found = verdicts(compared(lambda key: (1.0, 1.05)))
    assert all(found[f"{law}: the plan is close to the exact optimum"] for law in ANALYTIC)
    assert not found["planar-hand: no smoothing comes close to the exact optimum"]


@pytest.mark.costly
def test_nothing_holds_where_nothing_was_measured() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = verdicts(compared(lambda key: (np.nan, np.nan)))
    assert not any(found.values())


@pytest.mark.costly
def test_the_table_has_a_row_a_law_and_marks_what_is_close() -> None:
    columns, *made = smoothing_rows(compared(usual))
    assert columns == ["law", *PROBLEMS, "seconds"]
    assert len(made) == 1 + len(ANALYTIC) + len(LEARNED)
    assert made[0][:2] == ["exact", "**0.0%** ✓"]
    sharp = next(row for row in made if row[0] == "barrier, mu = 0.0001")
    assert sharp[-3:] == ["**+2.0%** ✓", "+50%", "5 to 5"]
    assert made[-1][1:] == ["×4", "×4", "×4", "×4", "5 to 5"]
    assert {len(row) for row in made} == {len(columns)}


@pytest.mark.costly
def test_the_page_shows_every_number_of_the_table() -> None:
    data = compared(usual)
    with house_style():
        figure = DRAWINGS["N3"].draw(data)
        assert len(to_svg(figure)) > 10_000
    costs, seconds, left, right = figure.axes
    shown = [text.get_text() for text in costs.texts]
    assert len(shown) == 2 * len(LAWS) * len(PROBLEMS)
    assert shown[:2] == [r"0.0% $\checkmark$", "plan 0.0%"]
    assert shown[-2:] == ["×4", "plan +100%"]
    times = ["10" if law == "trusting ewda" else "5" for law in LAWS for _ in PROBLEMS]
    assert [text.get_text() for text in seconds.texts] == times
    assert all(axis.get_xlabel() and axis.get_ylabel() for axis in (left, right))
    assert all(len(axis.lines) == len(PROBLEMS) + 1 for axis in (left, right))


def test_words_for_an_excess() -> None:
    told = [excess_text(share) for share in (0.0, -0.0031, 0.0994, 0.0996, 0.5, 2.0, 126.4, np.nan)]
    assert told == ["0.0%", "-0.3%", "+9.9%", "+10%", "+50%", "×3", "×127", "–"]
