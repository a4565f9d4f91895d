"""The page of an estimate: its headline is the weakest verdict, and its axis includes every interval."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

from ocp.gradients.sweep import summarise_verdicts
from ocp.gradients.verdict import TOO_WIDE, WORST_FIRST
from ocp.labelled import LabelledArrays
from ocp.store.stored_run import StoredRun
from reports.documents.sweep import estimate_page, weakest_sentence
from reports.figures import sweep

GOOD = "unbiased within the interval"
NAMES = (
    "zobg",
    "fobg",
    "alpha",
    "es",
    "zobg-zero-noise",
    "zobg-mean",
    "zobg-antithetic",
    "alpha-variance",
    "alpha-fixed",
)


def row(name: str, word: str = GOOD, wide: bool = False, **more: Any) -> dict[str, Any]:
    return {
        "estimator": name,
        "verdict": word,
        "wide": wide,
        "mean": 1.0,
        "standard_error": 0.1,
        "variance_trace": 1.0,
        "reference": 1.0,
        "alpha": None,
        "value": None,
        "reference_source": "closed form",
        "explanation": "off by 0.",
        **more,
    }


def stored(rows: list[dict[str, Any]], mean: np.ndarray, error: np.ndarray) -> StoredRun:
    """Return a stored estimate over nu, with means and errors (points, estimators)."""
    points, count = mean.shape
    one = ("point", "estimator", "component")
    data = xr.Dataset(
        {
            "mean": (one, mean[..., None]),
            "standard_error": (one, error[..., None]),
            "variance": (one, np.ones((points, count, 1))),
            "reference": (one, np.ones((points, count, 1))),
        },
        coords={
            "value": ("point", np.geomspace(1e-3, 1e-1, points)),
            "estimator": [r["estimator"] for r in rows[:count]],
        },
    )
    record = {
        "problem": "coulomb",
        "estimators": [r["estimator"] for r in rows[:count]],
        "params": {"nu": 0.01, "sigma": 0.1, "theta": 0.0},
        "sigma": 0.1,
        "samples": 1000,
        "reference": "auto",
        "reference_samples": 10000,
        "seed": 0,
    }
    swept = {"name": "nu", "values": [1e-3, 1e-1], "unit": "m/s", "log": True}
    return StoredRun(
        Path("runs/x"),
        LabelledArrays.of(data),
        {
            "kind": "estimate",
            "problem": "coulomb",
            "hash": "0",
            "record": record,
            "sweep": swept,
            "estimates": rows,
            "verdict": "what each came to.",
        },
    )


def test_the_headline_is_the_weakest_verdict() -> None:
    assert weakest_sentence([row("zobg"), row("fobg")]) == f"Every estimate: {GOOD}."
    rows = [row("zobg"), row("fobg", wide=True), row("es"), row("fobg")]
    assert weakest_sentence(rows) == f"Weakest verdict: {TOO_WIDE}, 1 of 4 estimates (fobg)."
    rows.append(row("es", "biased"))
    assert weakest_sentence(rows) == "Weakest verdict: biased, 1 of 5 estimates (es)."


def test_a_wide_interval_is_not_called_unbiased() -> None:
    """Neither the page nor the stored and printed sentence calls such an estimate unbiased."""
    rows = [[row("zobg"), row("fobg", wide=True)], [row("zobg"), row("fobg")]]
    assert summarise_verdicts(rows) == f"zobg: {GOOD}; fobg: {TOO_WIDE} at 1 of 2, {GOOD} at 1 of 2."


@pytest.mark.parametrize(
    ("word", "wide", "grade"),
    [
        (GOOD, False, "survives"),
        (GOOD, True, "certified"),
        ("no reference", False, "certified"),
        ("empirically biased at this sample size", False, "failed"),
        ("biased", False, "failed"),
    ],
)
def test_the_bar_has_the_colour_of_the_weakest(word: str, wide: bool, grade: str) -> None:
    run = stored([row("zobg"), row("fobg", word, wide)], np.ones((1, 2)), np.ones((1, 2)))
    content, _ = estimate_page(run)
    assert content["grade"] == grade
    assert WORST_FIRST.index(GOOD) == len(WORST_FIRST) - 1


def test_reference_and_law_are_named_and_the_swept_parameter_is_no_constant() -> None:
    run = stored([row("zobg"), row("fobg")], np.ones((1, 2)), np.ones((1, 2)))
    content, _ = estimate_page(run)
    how = dict(content["request"])
    assert how["reference"] == "closed form" and how["law"] == "none (static objective)"
    assert how["ν"] == "0.001 to 0.1" and content["swept"] == "ν [m/s]"
    assert "nu" not in {row[0] for row in content["parameters"]}
    run.meta["record"] |= {"contact": "barrier", "law_settings": ["mu=1e-2"], "policy": "feedback"}
    how = dict(estimate_page(run)[0]["request"])
    assert how["law"] == "barrier (μ = 1e-2)" and how["policy"] == "feedback"
    assert content["settings"] == [["seed", "0"]], "the rest stands in that line"


def test_the_axis_covers_the_interval_of_every_estimator() -> None:
    mean = np.array([[1.0, 40.0], [1.0, -7.0]])
    error = np.array([[0.1, 30.0], [0.1, 2.0]])
    rows = [row(name) for _ in range(2) for name in ("zobg", "fobg")]
    low, high = sweep.estimate_figure(stored(rows, mean, error)).axes[0].get_ylim()
    assert low <= (mean - 1.96 * error).min() and high >= (mean + 1.96 * error).max()


@pytest.mark.cheap_cases("0.04")
@pytest.mark.parametrize("scale", [0.04, 0.3, 2.0])
def test_numbers_beside_zero_are_not_printed_over_each_other(scale: float) -> None:
    """Numbers do not overlap on an axis of positive and negative powers of ten, whatever the reference."""
    mean, error = np.array([[scale, 90.0]]), np.array([[0.1, 60.0]])
    run = stored([row("zobg"), row("fobg")], mean, error)
    run.data["reference"] *= scale
    figure = sweep.estimate_figure(run)
    figure.draw_without_rendering()
    axis = figure.axes[0]
    low, high = axis.get_ylim()
    ticks = [tick for tick in axis.get_yticks() if low <= tick <= high]
    places = axis.transData.transform([(0.0, tick) for tick in ticks])[:, 1]
    assert axis.get_yscale() == "symlog" and 0 in ticks
    assert np.diff(places).min() > 9 * figure.dpi / 72, "a line of 8 points each"


def test_each_estimator_has_its_own_colour_wherever_it_stands() -> None:
    looks = [sweep.estimator_style(name) for name in NAMES]
    assert len({color for color, _ in looks}) == len(NAMES)

    def drawn(*names: str) -> dict[str, str]:
        run = stored([row(name) for name in names], np.ones((1, len(names))), np.ones((1, len(names))))
        top = sweep.estimate_figure(run).axes[0]
        return {str(line.get_label()): str(line.get_color()) for line in top.lines}

    assert drawn("fobg", "zobg")["fobg"] == drawn("zobg", "es", "fobg")["fobg"]
