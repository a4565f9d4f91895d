"""``ocp.estimate`` follows the same rules and returns the same numbers as the command ``ocp estimate``."""

from __future__ import annotations

import json

import numpy as np
import pytest

import ocp
from dynamics.batch import Gaussian
from ocp.errors import InputError
from ocp.gradients import sampling
from ocp.gradients.case import ObjectiveCase
from ocp.gradients.estimators import SAMPLED
from ocp.jobs import estimate_parts
from ocp.jobs.scheduling import Workers
from ocp.store.checkpoint import Checkpoint
from reports.cli.app import main


@pytest.mark.costly_cases("push-1d-params1-options1")
@pytest.mark.parametrize(
    ("name", "params", "options"),
    [
        ("heaviside", {}, {}),
        ("push-1d", {"N": 5}, {"contact": "exact"}),
    ],
)
def test_python_and_the_command_line_estimate_the_same_numbers(name, params, options, tmp_path, capsys):
    found = ocp.estimate(name, ["zobg"], 500, params=params, reference="none", **options)["zobg"]
    given = [word for key, value in params.items() for word in ("-p", f"{key}={value}")]
    given += [word for key, value in options.items() for word in (f"--{key}", value)]
    code = main(
        [
            "estimate",
            name,
            *given,
            "--estimators",
            "zobg",
            "--samples",
            "500",
            "--reference",
            "none",
            "--json",
            "--out",
            str(tmp_path),
        ]
    )
    row = json.loads(capsys.readouterr().out)["estimates"][0]
    assert not code
    np.testing.assert_array_equal(np.ravel(row["mean"]), found.mean)


def test_noise_that_rounding_hides_is_refused():
    with pytest.raises(InputError, match="rounding errors dominate"):
        ocp.estimate("heaviside", sigma=1e20)


@pytest.mark.costly
@pytest.mark.parametrize("name", ["heaviside", "push-1d"])
def test_processes_sample_the_same_bits(name, monkeypatch):
    """Other processes compute parts, which are summed in a fixed order."""
    monkeypatch.setattr(sampling, "_MAX_STORED_VALUES", 1)
    monkeypatch.setattr(estimate_parts, "PIECE", estimate_parts.BULK)
    params = {"N": 2} if name == "push-1d" else {}
    given = {
        "params": params,
        "reference": "none",
        "samples": estimate_parts.BULK + 100_000,
        "threads": 1,
    }
    alone = ocp.estimate(name, ["zobg-mean", "fobg"], **given)
    spread = ocp.estimate(name, ["zobg-mean", "fobg"], jobs=2, **given)
    for key, found in alone.items():
        np.testing.assert_array_equal(spread[key].mean, found.mean)
        np.testing.assert_array_equal(spread[key].variance, found.variance)
        np.testing.assert_array_equal(spread[key].moments.n, given["samples"])


def test_a_stopped_estimate_resumes_with_other_workers(monkeypatch, tmp_path):
    """Two processes continue the sums that one saved, and give the same bits."""
    monkeypatch.setattr(sampling, "_MAX_STORED_VALUES", 1)
    monkeypatch.setattr(estimate_parts, "PIECE", estimate_parts.BULK)
    case = ObjectiveCase("heaviside", {}, engine={"threads": 1})
    objective, noise, n = case.build().objective, Gaussian(0.1, 4), 3 * estimate_parts.BULK
    whole = sampling.run_estimator(objective, SAMPLED["zobg"], noise, n)
    with Checkpoint(tmp_path, "heaviside", {"seed": 4}) as kept:
        sampling.run_estimator(objective, SAMPLED["zobg"], noise, estimate_parts.BULK, checkpoint=(kept, "z"))
        workers = estimate_parts.JobWorkers(case, Workers(2))
        resumed = sampling.run_estimator(objective, SAMPLED["zobg"], noise, n, checkpoint=(kept, "z"), workers=workers)
    np.testing.assert_array_equal(resumed.moments.mean, whole.moments.mean)
    np.testing.assert_array_equal(resumed.moments.m2, whole.moments.m2)


def test_a_changed_file_is_not_mixed(tmp_path):
    case = ObjectiveCase("heaviside", {}, content="other")
    with pytest.raises(InputError, match="has changed since this was begun"):
        case.build()


def test_theta_is_the_decision_of_an_objective() -> None:
    """The gradient of the smoothed Heaviside step is the normal density, also at theta = 0.5."""
    found = ocp.estimate("heaviside", ["zobg"], 500, theta=np.array([0.5]))["zobg"]
    by_name = ocp.estimate("heaviside", ["zobg"], 500, params={"theta": 0.5})["zobg"]
    np.testing.assert_array_equal(found.mean, by_name.mean)
    assert found.reference is not None
    density = np.exp(-0.5 * (0.5 / 0.2) ** 2) / (0.2 * np.sqrt(2 * np.pi))
    assert found.reference.gradient[0] == pytest.approx(density, rel=1e-6)


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        ({"theta": np.zeros(2)}, "2 variables, heaviside needs 1"),
        ({"theta": [np.nan]}, "theta"),
        ({"theta": [0.1], "params": {"theta": 0.1}}, "give one of them"),
        ({"seed": -1}, "seed must be"),
    ],
)
def test_decisions_and_seeds_that_cannot_be_are_refused(given, reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        ocp.estimate("heaviside", ["zobg"], 10, **given)


def test_a_python_function_is_answered_by_a_sentence() -> None:
    with pytest.raises(InputError, match="takes the name of an objective"):
        ocp.estimate(lambda theta, w: theta @ w)  # pyright: ignore[reportArgumentType]
