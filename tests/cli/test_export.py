"""``ocp export``: the written C file repeats the run."""

from __future__ import annotations

import ctypes
import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from dynamics.contact import Barrier, Exact
from ocp import store
from problems.plugin import problem_of

CC = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
NUMBERS = ctypes.POINTER(ctypes.c_double)
needs_compiler = pytest.mark.skipif(CC is None, reason="no C compiler")
# 20 lines: roll out NAME's policy from a start over some steps, and print the states.
DRIVER = """\
#include <stdio.h>
int main(void) {
  double x[NAME_nx], u[NAME_nu];
  int steps;
  if (scanf("%d", &steps) != 1) return 1;
  for (int i = 0; i < NAME_nx; i++)
    if (scanf("%lf", x + i) != 1) return 1;
  for (int t = 0; t <= steps; t++) {
    for (int i = 0; i < NAME_nx; i++) printf("%.17g ", x[i]);
    printf("\\n");
    NAME_policy(t, x, u);
    if (NAME_step(x, u, 0, x, 0)) return 1;
  }
  return 0;
}
"""


def rolled(text: str, name: str, start: np.ndarray, steps: int) -> np.ndarray:
    """Return the states (steps + 1, nx) of a rollout by the file's policy and step."""
    source = Path("driven.c")
    source.write_text(text + DRIVER.replace("NAME", name))
    flags = ["-std=c11", "-Wall", "-Wextra", "-Werror"]
    subprocess.run([str(CC), *flags, source, "-o", "driven", "-lm"], check=True)
    given = " ".join(map(repr, [steps, *start.tolist()]))
    done = subprocess.run(["./driven"], input=given, capture_output=True, text=True, check=True)
    return np.array([line.split() for line in done.stdout.splitlines()], dtype=float)


@pytest.mark.costly
@needs_compiler
@pytest.mark.parametrize("policy", ["open-loop", "feedback"])
@pytest.mark.parametrize("law", [None, "exact"])
def test_a_runs_file_repeats_its_rollout(ocp, policy, law) -> None:
    """The file repeats the run under its own law, and its replay under another, state by state."""
    solved = ocp("solve", "push-1d", "--contact", "barrier", "-c", "mu=1e-3", "--policy", policy, "--json")
    run = json.loads(solved.out)["run"]
    asked = [] if law is None else ["--contact", law]
    done = ocp("export", run, "-o", "rollout.c", *asked, "--json")
    assert done.code == 0, done.err
    told = json.loads(done.out)
    assert told["policy"] == policy
    assert told["functions"] == ["push_1d_step", "push_1d_derivatives", "push_1d_policy"]
    stored = store.load(run)
    solution = stored.solution(problem_of(stored)[2])
    wanted = solution.replay(Barrier(mu=1e-3) if law is None else Exact()).data["x"].values[0]
    text = Path("rollout.c").read_text()
    assert Path(run).name in text
    assert Path(told["header"]).read_text() in text
    states = rolled(f'#include "{told["header"]}"\n{text}', "push_1d", wanted[0], len(wanted) - 1)
    np.testing.assert_allclose(states, wanted, rtol=1e-9, atol=1e-11)


def test_a_problem_at_other_parameters_has_no_policy(ocp) -> None:
    done = ocp(
        "export",
        "push-disc",
        "-o",
        "a/disc.c",
        "-p",
        "M=2.5",
        "--contact",
        "barrier",
        "-c",
        "mu=0.02",
    )
    assert done.code == 0
    assert done.out.splitlines() == [
        "C file: a/disc.c (push_disc_step, push_disc_derivatives)",
        "header: a/disc.h",
        "Makefile: disc.o: disc.c ; cc -std=c11 -O2 -ffp-contract=off -c $<",
    ]
    text = Path("a/disc.c").read_text()
    assert "M = 2.5 [kg]" in text
    assert "contact.mu = 0.02 [N s m]" in text
    assert "barrier (mu = 0.02)" in text
    assert "_policy" not in text


@pytest.mark.costly_cases("name", "objective", "no file")
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["push-disk", "-o", "x.c"], ["no run 'push-disk'", "did you mean 'push-disc'?"]),
        (["heaviside", "-o", "x.c"], ["objective without dynamics"]),
        (["push-disc"], ["--output"]),
        (["push-disc", "-o", "x.c", "--out", "runs"], ["--out", "is a problem"]),
        (["push-disc", "-o", "."], ["is a directory", "rollout.c"]),
        (["push-disc", "-o", "x.c", "-p", "mass=1"], ["mass", "M"]),
        (["push-disc", "-o", "x.c", "--contact", "hard"], ["'hard'", "exact, barrier"]),
        (["push-disc", "-o", "x.c", "-c", "sigma=1"], ["sigma belongs to adaptive"]),
        (["push-1d/", "-o", "x.c"], ["names", "give more of it"]),
    ],
    ids=[
        "name",
        "objective",
        "no file",
        "store",
        "directory",
        "parameter",
        "law",
        "setting",
        "two",
    ],
)
def test_what_it_cannot_do_is_said(ocp, store_of_runs: Path, arguments, said) -> None:
    where = ["--out", str(store_of_runs)] if "/" in arguments[0] else []
    done = ocp("export", *arguments, *where)
    assert done.code == 2
    assert "Traceback" not in done.err
    assert done.out == ""
    assert all(part in done.err for part in said), done.err
    assert not [path for path in Path().iterdir() if path.is_file()]


def test_a_run_has_its_own_parameters_and_a_policy(ocp, store_of_runs: Path) -> None:
    """Exporting a solve rejects -p, and a continuation cannot be exported."""
    runs = {store.load(path).kind: path for path in (store_of_runs / "wall-1d").iterdir()}
    done = ocp("export", str(runs["solve"]), "-o", "x.c", "-p", "m=2")
    assert done.code == 2
    assert "a run has fixed parameters" in done.err
    done = ocp("export", str(runs["continue"]), "-o", "x.c")
    assert done.code == 2
    assert "is a run of ocp continue" in done.err


@pytest.mark.costly
@needs_compiler
def test_gains_that_made_a_plan_survive_are_exported_and_replayed_step_by_step(ocp) -> None:
    """The file's policy and steps are those of the closed loop, computed here from the stored gains."""
    file = str(Path(__file__).parents[1] / "golden/cases/hill.py")
    solved = ocp("solve", file, "--contact", "exact", "--effort", "quick", "--until", "survives", "--json")
    assert solved.code == 0 and solved.json["ladder"]["rungs"][solved.json["ladder"]["chosen"]]["name"] == "gains"
    done = ocp("export", "@last", "--source", file, "-o", "hill.c", "--json")
    assert done.code == 0 and done.json["policy"] == "feedback", done.err
    data = xr.load_dataset(Path(solved.json["run"]) / "solution.nc")
    K, k = data["K"].values[:, 0], data["k"].values[:, 0]
    # The mass on the hill, away from its wall: v+ = v + h (16 x + u), x+ = x + h v+.
    for start in ([0.5, 0.0], [0.46, 0.05]):
        x = np.array([start])
        for gain, offset in zip(K, k, strict=True):
            u = np.clip(gain @ x[-1] + offset, -20, 20)
            v = x[-1, 1] + 0.1 * (16 * x[-1, 0] + u)
            x = np.vstack([x, [x[-1, 0] + 0.1 * v, v]])
        assert x[:, 0].min() > -1 and np.abs(x[-1]).max() < 0.1
        states = rolled(Path("hill.c").read_text(), "hill", np.array(start), len(k))
        np.testing.assert_allclose(states, x, rtol=0, atol=1e-9)
    replayed = ocp("replay", "@last", "--source", file, "--json")
    assert replayed.code == 0 and replayed.json["inputs"] == "feedback"
    assert replayed.json["cost"] == pytest.approx(solved.json["cost"], rel=1e-9)


@pytest.mark.costly
def test_a_controller_is_replayed_and_not_written_as_c(ocp) -> None:
    file = str(Path(__file__).parents[1] / "golden/cases/hill.py")
    words = ("--contact", "exact", "--effort", "quick", "--policy", "feedback", "-p", "N=20")
    solved = ocp("solve", file, *words, "--until", "survives", "--json")
    assert solved.json["ladder"]["rungs"][solved.json["ladder"]["chosen"]]["name"] == "a controller"
    replayed = ocp("replay", "@last", "--source", file, "--json")
    assert replayed.json["inputs"] == "controller"
    assert replayed.json["cost"] == pytest.approx(solved.json["referee_cost"], rel=1e-9)
    done = ocp("export", "@last", "--source", file, "-o", "hill.c")
    assert done.code == 2 and "is a controller" in done.err and not Path("hill.c").exists()


@pytest.mark.costly
@needs_compiler
@pytest.mark.parametrize("rate", ["100", "200"])
def test_the_c_policy_of_a_closed_loop_repeats_its_inputs(ocp, rate: str) -> None:
    """Inputs at the loop's own states are the stored ones, and the C step is that of the plant."""
    loop = ("mpc", "soft-walls", "-p", "N=8", "--phase", "policy", "--steps", "20", "--rate", rate)
    run = ocp(*loop, "--noise-state", "0.01", "--json").json["run"]
    done = ocp("export", run, "-o", "loop.c", "--json")
    assert done.code == 0, done.err
    assert done.json["policy"] == "feedback" and done.json["functions"][-1] == "soft_walls_policy"
    flags = ["-std=c11", "-O2", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off", "-shared", "-fPIC"]
    subprocess.run([str(CC), *flags, "loop.c", "-o", "loop.so", "-lm"], check=True)
    # A relative name that was loaded before would give the library of another test.
    library, data = ctypes.CDLL(str(Path("loop.so").resolve())), store.load(run).data
    measured, x, u = (data[name].values[0] for name in ("measured", "x", "u"))
    for k in range(20):
        state, inputs, reached = measured[k].copy(), np.zeros(1), np.zeros(4)
        library.soft_walls_policy(k, *(v.ctypes.data_as(NUMBERS) for v in (state, inputs)))
        assert inputs == pytest.approx(u[k], rel=1e-9, abs=1e-9)
        library.soft_walls_step(
            *(v.ctypes.data_as(NUMBERS) for v in (x[k].copy(), u[k].copy())),
            None,
            reached.ctypes.data_as(NUMBERS),
            None,
        )
        assert reached == pytest.approx(x[k + 1], rel=1e-9, abs=1e-9)


@pytest.mark.costly
def test_a_receding_loop_exports_the_gains_along_its_last_plan(ocp) -> None:
    """The gains give the last plan's inputs at its states; u = K x + k of the stored arrays."""
    run = ocp("mpc", "soft-walls", "-p", "N=5", "--steps", "3", "--json").json["run"]
    assert ocp("export", run, "-o", "loop.c").code == 0
    data = store.load(run).data
    K, k, plan = (data[name].values for name in ("K", "k", "plan"))
    assert K.shape == (5, 1, 4) and "soft_walls_policy" in Path("loop.c").read_text()
    first = K[0] @ plan[0, -1, 0] + k[0]
    assert first == pytest.approx(data["u"].values[0, -1], abs=1e-9)
