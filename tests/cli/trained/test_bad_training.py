"""Invalid requests for training and evaluation are rejected in one sentence, before any work."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest

from ocp import store
from reports.cli.app import main
from tests.cli.conftest import Ocp
from tests.resealed import reseal

REFUSED = {
    "hoper": "unknown task 'hoper' (did you mean 'hopper'?)",
    "wall-1d": "unknown task 'wall-1d'",
    "ball-throw -a fpog": "unknown algorithm 'fpog' (did you mean 'fopg'?)",
    "ball-throw -a ars,ars": "has a name twice",
    "ball-throw -a ,": "expected names with commas",
    "ball-throw -s sampels=3": "no setting 'sampels' of fopg (did you mean 'samples'?); available:",
    "ball-throw -s ars.rate=3": "no setting 'ars.rate' of fopg",
    "ball-throw -s samples=0": "samples must be",
    "ball-throw -s samples=many": "must be a whole number",
    "ball-throw -s unroll=0": "unroll must be",
    "ball-throw -s rate=nan": "rate must be",
    "ball-throw -s sigma=0": "sigma must be",
    "ball-throw -s optimiser=adm": "did you mean 'adam'?",
    "ball-throw -a ars -s top=20": "top is 20, more than the 16 directions",
    "ball-throw -s discount=1.1": "discount must be a number > 0 and <= 1, got 1.1",
    "ball-throw -s discount=0": "discount must be a number > 0 and <= 1, got 0; 1 counts all rewards alike",
    "ball-throw -s hidden=0": "hidden must be whole numbers >= 1",
    "ball-throw -s hidden=deep": "affine or open-loop",
    "ball-throw -s episodes=0": "episodes must be",
    "ball-throw -s evaluate_every=0": "evaluate_every must be",
    "ball-throw -s normalise=perhaps": "must be true or false",
    "ball-throw -a aobg -s samples=1": "a variance needs two",
    "ball-throw -a aobg -s clip=1": "no setting 'clip' of aobg",
    "ball-throw -s clip=0": "clip must be",
    "ball-throw -a mbpo": "mbpo learns a policy that observes",
    "ball-throw -s psi=mass": "the task has no parameter 'mass'; available: m,",
    "ball-throw -s psi=m,m": "has a name twice",
    "ball-throw -s psi.n_envs=2": "needs a learned physical parameter; add -s psi=m",
    "ball-throw -s psi=m -s psi.n_envs=0": "n_envs must be",
    "ball-throw -s psi=m -s psi.m=heavy": "psi.m must be a number",
    "ball-throw -s psi=m -s psi.n_env=2": "no setting 'psi.n_env' (did you mean 'n_envs'?)",
    "ball-throw -s psi=m -s psi.width=-1": "psi.width must be a number > 0, got -1",
    "ball-throw -s psi=m -s psi.m=-1": "m is learned by its logarithm, so it must start positive",
    "ball-throw --seeds 0": "--seeds must be a whole number >= 1 and <= 1000",
    "ball-throw --iterations 0": "--iterations must be a whole number >= 1",
    "ball-throw --jobs 0": "--jobs must be a whole number >= 1 and <= 1024",
    "ball-throw -p mass=2": "ball-throw: unknown parameter 'mass'",
    "ball-throw -p m=-1": "parameter m (mass) must be a number > 0 [kg]",
    "ball-throw --contact soft": "unknown contact law 'soft'",
    "ball-throw --contact barrier -c sigma=1": "has no setting 'sigma'",
    "ball-throw --scheduler tcp://127.0.0.1:9 --jobs 2": "drop one",
    "ball-throw --scheduler tcp://127.0.0.1:9": "no Dask scheduler answers",
}


@pytest.mark.one_case_in(3)
@pytest.mark.parametrize(
    "words",
    [
        # The program waits ten seconds for a scheduler.
        pytest.param(words, marks=pytest.mark.slow) if "--scheduler" in words else words
        for words in REFUSED
    ],
)
def test_a_training_is_refused(ocp: Ocp, words: str) -> None:
    done = ocp("train", *words.split(), "--json")
    assert done.code == 2 and done.out == ""
    (told,) = done.err.splitlines()
    assert told.startswith("error: ") and REFUSED[words] in told, done.err
    assert not list(Path().glob("runs/*/2*"))


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = tmp_path_factory.mktemp("root")
    small = ["-s", "unroll=2", "-s", "samples=2", "--iterations", "1", "--quiet"]
    assert main(["train", "ball-throw", *small, "--out", str(found)]) == 0
    assert (
        main(
            [
                "solve",
                "wall-1d",
                "--contact",
                "barrier",
                "-p",
                "N=4",
                "--quiet",
                "--out",
                str(found),
            ]
        )
        == 0
    )
    return found


@pytest.mark.costly
def test_only_a_policy_is_judged(ocp: Ocp, root: Path) -> None:
    solved = next(root.glob("wall-1d/2*"))
    done = ocp("evaluate", str(solved))
    assert done.code == 2 and "holds no policy; give one of ocp train" in done.err


@pytest.mark.cheap_cases("given2-has no setting 'mu'")
@pytest.mark.parametrize(
    ("given", "told"),
    [
        (["--episodes", "0"], "--episodes must be a whole number >= 1"),
        (["--contact", "soft"], "unknown contact law 'soft'"),
        (["-c", "mu=1"], "has no setting 'mu'"),
    ],
)
def test_an_evaluation_is_refused(ocp: Ocp, root: Path, given: list[str], told: str) -> None:
    done = ocp("evaluate", str(next(root.glob("ball-throw/2*"))), *given)
    assert done.code == 2 and told in done.err


def test_a_policy_of_another_task_is_named(ocp: Ocp, root: Path, tmp_path: Path) -> None:
    made = next(root.glob("ball-throw/2*"))
    moved = tmp_path / "runs" / "hopper" / made.name
    shutil.copytree(made, moved)

    def change(meta: dict[str, Any]) -> None:
        meta |= {"problem": "hopper", "record": {**meta["record"], "params": {}, "hidden": []}}

    reseal(moved, change)
    assert store.load(moved).meta["problem"] == "hopper"
    done = ocp("evaluate", str(moved))
    assert done.code == 2
    assert "train one for this task" in done.err and "a policy of hopper has" in done.err


def test_runs_of_several_kinds_are_not_reported_together(ocp: Ocp, root: Path) -> None:
    both = [str(next(root.glob(f"{name}/2*"))) for name in ("ball-throw", "wall-1d")]
    done = ocp("report", *both, "-o", "a.pdf")
    assert done.code == 2 and "needs runs of ocp solve, of ocp train or of ocp mpc" in done.err
