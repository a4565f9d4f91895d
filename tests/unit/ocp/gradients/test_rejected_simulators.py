"""Simulators that fail, drift or stop: one sentence for each, and no lost reports."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ocp import gradient_report
from ocp.errors import InputError
from ocp.gradients.worlds import Question, ReportSettings, World, check_world
from ocp.jobs.gradients import measure_worlds
from ocp.store.checkpoint import SavedWork
from tests.unit.ocp.gradients.test_worlds import NOMINAL, SINE, judged, saw


class _Drifting:
    def __init__(self) -> None:
        self.calls = 0

    def __call__(self, theta: np.ndarray) -> np.ndarray:
        self.calls += 1
        return theta + self.calls


def _mutating(theta: np.ndarray) -> np.ndarray:
    theta += 1
    return theta


BAD = {
    "the shape": (lambda theta: theta[:, 0], None, "expected (4, m)"),
    "changes its argument": (_mutating, None, "theta.copy()"),
    "other values in a second call": (_Drifting(), None, "seed its random numbers"),
    "depend on the other rows": (lambda theta: theta + theta.mean(), None, "every row by itself"),
    "did not return an array": (lambda theta: "sin", None, "numbers"),
    "returned nan at the nominal parameters": (lambda theta: theta * np.nan, None, "a finite number"),
    "gradient(theta) returned the shape": (np.sin, np.cos, "expected (1, m, 1)"),
    "gradient(theta) has 2": (np.sin, lambda theta: np.ones((len(theta), 2, 1)), "1 outputs"),
}


@pytest.mark.parametrize("message", BAD)
def test_a_bad_simulator_gets_one_sentence(message: str) -> None:
    simulate, differentiate, remedy = BAD[message]
    with pytest.raises(InputError) as error:
        check_world(World("bad", simulate, differentiate), NOMINAL)
    assert message in str(error.value) and remedy in str(error.value) and "\n" not in str(error.value)


def test_a_world_that_fails_does_not_lose_the_others_and_all_failing_raise() -> None:
    bad = World("bad", lambda theta: theta[:, 0])
    report = measure_worlds([bad, SINE], Question(NOMINAL, 1.0, SINE), ReportSettings(samples=100))
    assert [row["verdict"] for row in report.rows] == ["failed", "right"]
    assert report.dataset().sizes["world"] == 1
    with pytest.raises(InputError, match="returned the shape"):
        measure_worlds([bad], Question(NOMINAL, 1.0, SINE))


def test_non_finite_rollouts_are_counted() -> None:
    world = World("half", lambda theta: np.where(theta > 1.0008, np.nan, np.sin(theta)))
    assert check_world(world, NOMINAL) == (1, 2)
    row = judged(world, SINE)
    assert row["nonfinite"] == 2 and all(each["nonfinite"] > 0 for each in row["smoothed"])
    # Half of the samples are missing, so that the others' mean is no gradient of the sine.
    assert all(each["mean"] is None for each in row["smoothed"])
    assert row["verdict"] == judged(world, None)["verdict"] == "not-finite"
    farther = World("farther", lambda theta: np.where(theta > 1.05, np.nan, np.sin(theta)))
    alone = judged(farther, None)
    assert alone["verdict"] == "consistent" and alone["truth"] == pytest.approx(np.cos(NOMINAL[0]), abs=1e-3)
    for findings in (row["findings"], alone["findings"], judged(farther, SINE)["findings"]):
        assert [each["code"] for each in findings].count("use-finite-outputs") == 1


def test_a_function_is_reported_from_python_and_needs_its_parameters() -> None:
    report = gradient_report(np.sin, theta=1.0, truth=np.sin, samples=100)
    assert report.rows[0]["verdict"] == "right" and report.sentences[0].startswith("sin: right")
    with pytest.raises(InputError, match="needs theta"):
        gradient_report(np.sin)
    for settings, message in (({"sigmas": ()}, "positive numbers"), ({"tolerance": 0.0}, "tolerance")):
        with pytest.raises(InputError, match=message):
            gradient_report(np.sin, theta=1.0, **settings)
    with pytest.raises(InputError, match="are for a function"):
        gradient_report("two-balls", theta=1.0)


def test_the_same_seed_gives_the_same_report() -> None:
    first, second = (judged(saw(3.0), SINE, samples=300, seed=7) for _ in range(2))
    assert first == second != judged(saw(3.0), SINE, samples=300, seed=8)


def test_an_interrupted_report_resumes_after_the_finished_world(tmp_path: Path) -> None:
    counted = _Counted()
    worlds, question = [World("counted", counted), SINE], Question(NOMINAL, 1.0, SINE)
    settings, files = ReportSettings(samples=100), SavedWork(tmp_path)

    def stop(index: int, name: str) -> None:
        if index == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        measure_worlds(worlds, question, settings, files, stop)
    calls = counted.calls
    resumed = measure_worlds(worlds, question, settings, files)
    assert counted.calls == calls > 0
    assert resumed.rows == measure_worlds(worlds, question, settings).rows


class _Counted:
    def __init__(self) -> None:
        self.calls = 0

    def __call__(self, theta: np.ndarray) -> np.ndarray:
        self.calls += 1
        return np.sin(theta)


def test_a_truth_without_the_output_that_is_asked_for_is_refused() -> None:
    two = World("two", lambda theta: np.concatenate([theta, theta**2], axis=1))
    with pytest.raises(InputError, match="sine has 1 outputs, got 1 as the index"):
        measure_worlds([two], Question(NOMINAL, 1.0, SINE, output=1))
