"""Study C1: loops agree with closed forms; claims, table and drawing follow synthetic data."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from functools import cache

import numpy as np
import pytest
import xarray as xr
from matplotlib.text import Text

from docs.generator.law_tables import loop_rows
from problems import studies
from problems.studies.laws_in_the_loop.data import (
    CONTROLLERS,
    FEEDBACK,
    INPUTS,
    LAWS,
    TASKS,
    Params,
    TaskLoops,
    initial_states,
    relative_cost,
    run,
    run_settings,
    survival,
)
from problems.studies.study import FinishedParts
from reports.drawing.style import house_style, to_svg
from reports.figures.studies import DRAWINGS

SETTINGS = Params(seeds=3)


class Made(FinishedParts):
    """Finished parts with synthetic costs, which depend on the key and by a hundredth on the seed."""

    def __init__(self, **costs: float) -> None:
        super().__init__()
        self.costs, self.keys = {name.replace("_", "-"): c for name, c in costs.items()}, []

    def get(self, key: str, compute: object) -> dict[str, np.ndarray]:
        self.keys.append(key)
        cost = next((c for part, c in self.costs.items() if part in key), usual(key))
        seeds = cost * np.array([1.0, 1.01, 1.02])
        return {"cost": np.stack([seeds, 2 * seeds], axis=1), "ended": ~np.isfinite(seeds), "ms": np.array(3.0)}


def usual(key: str) -> float:
    """Return a cost by key: sharper laws are better, gains near planning again, inputs far from it."""
    known = {"inputs": 3.0, "gains": 1.05, "barrier-0.1": 1.9, "barrier-0.01": 1.5}
    return next((cost for part, cost in known.items() if part in key), 1.0)


def made(**costs: float) -> xr.Dataset:
    return run(SETTINGS, Made(**costs)).assign_attrs({"study": "C1", **SETTINGS.model_dump()})


def verdicts(data: xr.Dataset) -> dict[str, bool]:
    return {claim.claim: bool(claim.holds) for claim in studies.get("C1").claims(data)}


@pytest.fixture(scope="module", autouse=True)
def _built_once() -> Iterator[None]:
    """Build each task's problem once, since synthetic costs do not depend on it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("problems.studies.laws_in_the_loop.data.TaskLoops", cache(TaskLoops))
        yield


@pytest.fixture(scope="module")
def pushing() -> TaskLoops:
    return TaskLoops("push-disc", Params(seeds=2))


def test_starts_are_around_the_given_one_and_touch_nothing_deeply() -> None:
    source = TaskLoops("finger-disc", Params(seeds=12))
    assert source.starts.shape == (12, 6)
    p = source.problem.parameters.defaults
    tips = np.array([_tip(x, p["length"]) for x in source.starts])
    assert np.all(np.linalg.norm(tips - [p["x"], p["z"]], axis=1) >= p["R"] + p["r"] - 1e-9)
    assert np.array_equal(source.starts, initial_states(source.problem, Params(seeds=12)))


def _tip(x: np.ndarray, length: float) -> np.ndarray:
    turned = np.array([x[0], x[0] + x[1]])
    return length * np.array([np.sin(turned).sum(), -np.cos(turned).sum()])


def test_which_plants_are_another(pushing: TaskLoops) -> None:
    """The model of pushing linearises true gaps, and its step size is part of the model."""
    assert pushing.plants == ["model", "referee", "mismatch", "noise"]
    assert TaskLoops("soft-walls", SETTINGS).plants == ["model", "h/4", "mismatch", "noise"]


def test_planning_again_on_the_model_costs_the_optimum(pushing: TaskLoops) -> None:
    """From the problem's own start the plan is the optimum, and its remainder stays optimal."""
    found = pushing.loop("exact", "model")
    assert found["cost"][0, 0] == pytest.approx(0.100678, rel=1e-4)
    inputs = pushing.loop("inputs, exact", "model")
    assert inputs["cost"][0, 0] == pytest.approx(0.100678, rel=1e-4)
    gains = pushing.loop("gains, exact", "model")
    assert gains["cost"][0, 0] == pytest.approx(0.100678, rel=1e-4)
    assert gains["cost"][1, 0] < inputs["cost"][1, 0]
    assert not found["ended"].any()
    heavier = pushing.loop("exact", "mismatch")
    assert heavier["cost"][0, 0] > found["cost"][0, 0]


def test_rows_stand_where_their_names_say() -> None:
    finished = Made(planar_push_adaptive_noise=7.0)
    data = run(SETTINGS, finished)
    assert len(set(finished.keys)) == len(finished.keys) == len(run_settings(data)) * len(CONTROLLERS)
    at = {"task": "planar-push", "plant": "noise", "controller": "adaptive"}
    assert np.allclose(data["cost"].sel(at, drop=True).isel(seed=0), [7, 14])
    assert float(relative_cost(data).sel({**at, "span": "run"}).mean()) == pytest.approx(7)
    assert not survival(data).sel(at).any()
    assert np.isnan(relative_cost(data).sel(task="push-disc", plant="h/4")).all()


def test_a_plant_that_diverged_counts_as_a_thousand_times_the_best() -> None:
    data = made(spinner_exact_noise=np.nan)
    at = {"task": "spinner", "plant": "noise", "controller": "exact", "span": "run"}
    assert np.all(relative_cost(data).sel(at) == 1000)
    assert not survival(data).sel(at).any()
    assert not verdicts(data)["noise: planning again under the exact law costs the least"]


def test_claims_follow_the_data() -> None:
    assert all(verdicts(made()).values())


@pytest.mark.one_case_in(16)
@pytest.mark.parametrize(
    ("costs", "flipped"),
    [
        ({"spinner_randomized_model": 0.9}, "model: planning again"),
        ({"push_adaptive_referee": 0.9}, "referee: planning again"),
        ({"cart_walls_adaptive_h4": 0.9}, "h/4: planning again"),
        ({"disc_randomized_mismatch": 0.9}, "mismatch: planning again"),
        ({"walls_randomized_noise": 0.9}, "noise: planning again"),
        ({"barrier-0.001": 1.55}, "The smaller mu"),
        ({"barrier-0.001": 1.2}, "At mu = 0.001"),
        ({"gains-exact": 3.1}, "Linear feedback along the exact plan costs less"),
        ({"gains-exact": 1.2}, "Linear feedback along the exact plan is sufficient"),
        ({"gains-barrier": 3.1}, "Linear feedback along the smoothed plan costs less"),
        ({"gains-barrier": 1.2}, "Linear feedback along the smoothed plan is sufficient"),
        ({"spinner_adaptive_model": 2.5}, "On the model every law's loop survives"),
        ({"spinner_exact_mismatch": 2.5}, "No smoothed law's loop survives more often"),
    ],
)
def test_each_claim_can_fail(costs: dict[str, float], flipped: str) -> None:
    found = verdicts(made(**costs))
    assert not found[next(claim for claim in found if claim.startswith(flipped))]


def test_nothing_holds_where_nothing_was_measured() -> None:
    data = made()
    blank = data.map(lambda v: v * np.nan if v.dtype.kind in "fiu" else v, keep_attrs=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert not any(verdicts(blank.assign_attrs(data.attrs)).values())


def test_the_table_has_a_row_a_controller_and_the_figure_every_number() -> None:
    data = made(spinner_barrier_0=2.5)
    columns, *rows = loop_rows(data)
    assert columns == ["planning again", *TASKS, "p99 [ms]"]
    assert [row[0] for row in rows] == [*LAWS, *FEEDBACK]
    assert rows[0][1:] == [*["**0.0%** ✓"] * len(TASKS), "3 to 3"]
    assert rows[2][1] == "+50% ✓" and rows[2][6] == "+150%"
    with house_style():
        figure = DRAWINGS["C1"].draw(data)
        assert len(to_svg(figure)) > 10_000
    left, right = figure.axes
    cells = len(run_settings(data))
    assert len(left.texts) == 2 * cells * len(LAWS) + len(TASKS)
    assert len(right.texts) == 2 * cells * len(FEEDBACK + INPUTS)
    sizes = [float(one.get_fontsize()) for one in figure.findobj(Text) if one.get_text()]
    assert min(sizes) >= 7, "journals set no smaller type"
