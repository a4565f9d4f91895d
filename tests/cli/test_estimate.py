"""``ocp estimate``: output, stored runs, rejected input, and resuming after kill -9."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from dynamics.batch import BatchFunction
from ocp import store
from reports.cli.app import main
from reports.documents.sweep import estimate_page


def estimate(capsys, *arguments):
    code = main(["estimate", *map(str, arguments), "--json", "--quiet"])
    out, err = capsys.readouterr()
    return code, json.loads(out) if code == 0 else None, err


def test_json_tells_mean_variance_error_reference_and_verdict(capsys, tmp_path):
    code, told, _ = estimate(capsys, "heaviside", "--samples", "1e4", "--out", tmp_path)
    assert code == 0
    rows = {row["estimator"]: row for row in told["estimates"]}
    assert list(rows) == ["zobg", "fobg", "alpha"]
    for row in rows.values():
        assert row["n_samples"] == 10_000
        np.testing.assert_allclose(row["standard_error"], (row["variance"] / 1e4) ** 0.5)
        np.testing.assert_allclose(row["reference"], 1 / (0.2 * (2 * np.pi) ** 0.5))
    assert rows["fobg"]["verdict"] == "biased"
    assert rows["zobg"]["verdict"] == "unbiased within the interval"
    stored = store.load(told["run"])
    assert stored.kind == "estimate"
    assert float(stored.data["mean"].sel(estimator="zobg")[0, 0]) == rows["zobg"]["mean"]
    assert stored.data["mean"].attrs["units"] == "1"


def test_a_sweep_over_a_law_gives_every_point(capsys, tmp_path):
    code, told, _ = estimate(
        capsys,
        "wall-1d",
        "-p",
        "N=4",
        "--sweep",
        "contact.mu=1e-3:1e-1:3:log",
        "--samples",
        500,
        "--estimators",
        "fobg",
        "--out",
        tmp_path,
    )
    assert code == 0
    np.testing.assert_allclose([row["value"] for row in told["estimates"]], [1e-3, 1e-2, 1e-1])
    assert all(len(row["mean"]) == 4 for row in told["estimates"])
    data = store.load(told["run"]).data
    assert data["value"].attrs["units"] == "N s m"
    assert list(data["component"].values) == [f"u[{t}]" for t in range(4)]


def test_a_horizon_can_be_swept(capsys, tmp_path):
    code, told, _ = estimate(
        capsys,
        "wall-1d",
        "--sweep",
        "N=2:4:3",
        "--samples",
        100,
        "--estimators",
        "fobg",
        "--out",
        tmp_path,
    )
    assert code == 0
    assert [len(row["mean"]) for row in told["estimates"]] == [2, 3, 4]
    mean = store.load(told["run"]).data["mean"].values
    assert np.isnan(mean[0, 0, 2:]).all()
    assert np.isfinite(mean[2]).all()


@pytest.mark.costly
def test_a_stored_plan_is_the_decision(capsys, tmp_path):
    assert (
        main(
            [
                "solve",
                "wall-1d",
                "--contact",
                "barrier",
                "-p",
                "N=5",
                "--out",
                str(tmp_path),
                "--quiet",
                "--json",
            ]
        )
        == 0
    )
    run = json.loads(capsys.readouterr().out)["run"]
    sizes = []
    for more in ((), ("--at", run)):
        _, told, _ = estimate(
            capsys,
            "wall-1d",
            "-p",
            "N=5",
            "--samples",
            2000,
            "--estimators",
            "fobg",
            "--sigma",
            0.001,
            "--out",
            tmp_path,
            *more,
        )
        sizes.append(np.linalg.norm(told["estimates"][0]["mean"]))
    # Where inputs are optimal and inside their bounds the gradient is small.
    assert sizes[1] < sizes[0]


@pytest.mark.costly
def test_a_page_shows_parameters_that_are_words(capsys, tmp_path):
    code, told, _ = estimate(
        capsys,
        "planar-hand",
        "-p",
        "N=1",
        "--samples",
        10,
        "--estimators",
        "zobg",
        "--reference",
        "none",
        "--out",
        tmp_path,
    )
    assert code == 0
    content, _ = estimate_page(store.load(told["run"]))
    shown = {row[0]: row[1:3] for row in content["parameters"]}
    assert shown["links"] == ["capsules", ""]
    assert shown["inertia"] == ["0.025", "kg m²"]


@pytest.mark.costly
def test_a_pdf_is_written(capsys, tmp_path):
    pdf = tmp_path / "report.pdf"
    code, _, _ = estimate(
        capsys,
        "coulomb",
        "--sweep",
        "nu=0.01:0.1:2",
        "--samples",
        100,
        "--out",
        tmp_path,
        "--pdf",
        pdf,
    )
    assert code == 0
    assert pdf.read_bytes().startswith(b"%PDF")


@pytest.mark.cheap_cases(
    "arguments0-did you mean 'heaviside'",
    "arguments8-ends above zero",
    "arguments9-expected NAME=A:B:n",
    "arguments12-one sample has no variance",
    "arguments17-unknown backend 'jax'",
    "arguments18-alpha.gamma",
    "arguments19--s alpha.gamma must be a number > 0, got -1",
    "arguments20--s alpha.gamma must be a number",
    "arguments21-has no effect",
    "arguments23---contact has no effect",
    "arguments24--c has no effect",
    "arguments25---at has no effect",
    "arguments26-set the same value",
    "arguments27-is not sampled",
    "arguments30-from 1 to 100000",
    "arguments31-drop --sigma",
)
@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["heavyside"], "did you mean 'heaviside'"),
        (["heaviside", "--samples", "1"], "one sample has no variance"),
        (["heaviside", "--samples", "many"], "whole number"),
        (["heaviside", "--sigma", "0"], "number >= 1e-150"),
        (["heaviside", "--sigma=-1"], "number >= 1e-150"),
        (["heaviside", "--estimators", "fogb"], "did you mean 'fobg'"),
        (["coulomb", "--sweep", "nu"], "expected NAME=A:B:n"),
        (["coulomb", "--sweep", "nu=1:2:0"], "from 1 to 100000"),
        (["coulomb", "--sweep", "nu=0:1:3:log"], "ends above zero"),
        (["coulomb", "--sweep", "nu=1:2:3:cubic"], "expected NAME=A:B:n"),
        (["coulomb", "--sweep", "mu=1:2:3"], "did you mean 'nu'"),
        (["coulomb", "--sweep", "nu=-1:1:3"], "a number > 0 [m/s]"),
        (["coulomb", "--sweep", "samples=1:9:3"], "one sample has no variance"),
        (["wall-1d", "--sweep", "contact.mu=0:1:3"], "mu must be a number > 0 [N s m], got 0"),
        (["wall-1d", "--reference", "quadrature"], "--reference zobg"),
        (["wall-1d", "--reference", "closed-form"], "no closed form"),
        (["wall-1d", "--contact", "barier"], "did you mean 'barrier'"),
        (["wall-1d", "--backend", "jax"], "unknown backend 'jax'"),
        (["wall-1d", "-s", "alpha.gama=1"], "alpha.gamma"),
        (["wall-1d", "-s", "alpha.gamma=-1"], "-s alpha.gamma must be a number > 0, got -1"),
        (["wall-1d", "-s", "alpha.gamma=x"], "-s alpha.gamma must be a number"),
        (["wall-1d", "-s", "alpha.gamma=1", "--estimators", "fobg"], "has no effect"),
        (["wall-1d", "--policy", "feedback", "-s", "policy.bound=1"], "has no effect"),
        (["heaviside", "--contact", "exact"], "--contact has no effect"),
        (["heaviside", "-c", "mu=1/0"], "-c has no effect"),
        (["heaviside", "--at", "nope"], "--at has no effect"),
        (["heaviside", "--sigma", "0.1", "-p", "sigma=0.2"], "set the same value"),
        (["heaviside", "--reference-samples", "9"], "is not sampled"),
        (["heaviside", "--sigma", "1e308"], "number >= 1e-150 and <= 1e+150"),
        (["heaviside", "--sigma", "1e-320"], "number >= 1e-150 and <= 1e+150"),
        (["heaviside", "--sweep", "samples=2:3:1e30"], "from 1 to 100000"),
        (["heaviside", "--sweep", "sigma=1:2:3", "--sigma", "1"], "drop --sigma"),
        (["heaviside", "-n", "1e300"], "of at most 9.2e+18"),
        (["wall-1d", "-n", "1e18"], "years; take fewer"),
        (["wall-1d", "-p", "N=1000000000"], "of memory"),
    ],
)
def test_bad_input_is_one_sentence_and_exit_code_two(capsys, tmp_path, arguments, sentence):
    code, _, err = estimate(capsys, *arguments, "--out", tmp_path)
    assert code == 2
    assert sentence in err
    assert len(err.strip().splitlines()) <= 2
    assert not list(tmp_path.glob("*/*"))


def test_help_names_every_backend(capsys):
    """The help names the backends that the engine lists if it gets an unknown one."""
    x = ca.SX.sym("x")
    with pytest.raises(ValueError, match="unknown backend") as refused:
        BatchFunction(ca.Function("f", [x], [x]), backend="jax")
    backends = str(refused.value).rpartition("choose one of ")[2].split(", ")
    assert len(backends) == 4
    main(["estimate", "--help"])
    told = re.sub(r"\s+", " ", capsys.readouterr().out)
    line = re.search(r"--backend <str> (.*?)\.", told)
    assert line is not None
    assert sorted(re.split(", | or ", line[1])) == sorted(backends)


SWEEP = [
    "estimate",
    "coulomb",
    "--sweep",
    "nu=1e-3:1e-1:3:log",
    "--samples",
    "6e5",
    "--estimators",
    "zobg-mean,fobg,alpha",
    "--seed",
    "3",
    "--json",
    "--quiet",
]


def program(out: Path) -> list[str]:
    code = "import sys; from reports.cli.app import main; sys.exit(main(sys.argv[1:]))"
    return [sys.executable, "-c", code, *SWEEP, "--out", str(out)]


def wait_for(found, seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not found() and time.monotonic() < end:
        time.sleep(0.05)
    assert found()


def kept(out: Path) -> list[Path]:
    return list(out.glob("*/.unfinished-*/[!.]*"))


def final(out: Path) -> tuple[list, dict]:
    (run,) = store.list_runs(out)
    stored = store.load(run.path)
    arrays = {str(k): np.asarray(v.values).tolist() for k, v in stored.data.variables.items()}
    return stored.meta["estimates"], {**arrays, "hash": stored.meta["hash"]}


@pytest.mark.costly
@pytest.mark.parametrize("signal_number", [signal.SIGINT, pytest.param(signal.SIGKILL, marks=pytest.mark.slow)])
def test_a_stopped_sweep_goes_on_to_the_same_bits(tmp_path, signal_number):
    broken, whole = tmp_path / "broken", tmp_path / "whole"
    with subprocess.Popen(program(broken), stdout=subprocess.DEVNULL) as process:
        # The study is unfinished: something is stored, and there are no drafts.
        wait_for(lambda: kept(broken))
        os.kill(process.pid, signal_number)
        assert process.wait() != 0
    stopped = [run.path for run in store.list_runs(broken)]
    assert kept(broken)
    for path in stopped:
        assert store.load(path).meta["status"] == "stopped"
        for file in path.iterdir():
            file.unlink()
        path.rmdir()
    for out in (broken, whole):
        subprocess.run(program(out), stdout=subprocess.DEVNULL, check=True)
    assert not list(broken.glob("*/.unfinished-*"))
    rows, arrays = final(broken)
    expected_rows, expected = final(whole)
    assert json.dumps(rows) == json.dumps(expected_rows)
    assert json.dumps(arrays) == json.dumps(expected)
