"""``ocp mpc``: a closed loop is simulated, printed, stored, reported and animated."""

from __future__ import annotations

import json
import re
import signal
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from dynamics.contact import ContactLaw
from ocp import store
from ocp.mpc.controller import Controller
from ocp.mpc.simulate import simulate
from ocp.problem.problem import Problem
from problems import get
from reports.cli import mpc_command
from reports.cli.app import main
from reports.tables.closed_loop import count_table, counted_times, labelled_arrays, loop_summary
from tests.cli.conftest import Ocp
from tests.cli.test_interruption import read_until, start

SMALL = ("mpc", "soft-walls", "-p", "N=5")


@pytest.fixture(scope="module", autouse=True)
def _without_compiler(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Hide the compiler, since loops of a few samples do not pay for the text of generated code."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PATH", str(tmp_path_factory.mktemp("no-compiler")))
        yield


@pytest.fixture(scope="module", autouse=True)
def _one_controller() -> Iterator[None]:
    """Build one controller for all loops of equal settings, as it serves all seeds of a loop."""
    built = dict[str, Controller]()

    def built_once(problem: Problem, law: ContactLaw, **settings: object) -> Controller:
        key = repr((problem.name, problem.N, problem.parameters.defaults, law, settings))
        if key not in built:
            built[key] = Controller(problem, law, **settings)  # pyright: ignore[reportArgumentType]
        return built[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mpc_command, "Controller", built_once)
        yield


@pytest.fixture(scope="module")
def loops(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a store with three seeds under noise, one exact loop and one that diverges, which tests only read."""
    root = tmp_path_factory.mktemp("loops")
    calls = (
        ["--plant", "noise", "--seeds", "3", "--steps", "24", "--certify", "8"],
        ["--steps", "24"],
        ["--steps", "12", "--push", "5:dtheta=1e7"],
    )
    codes = [main([*SMALL, *options, "--out", str(root), "-q"]) for options in calls]
    assert codes == [0, 0, 3]
    return root


def test_the_document_is_what_the_run_stores(ocp: Ocp) -> None:
    options = (
        "--steps",
        "15",
        "--noise-state",
        "p=0.01",
        "--mismatch",
        "mp=0.5",
        "--delay",
        "--push",
        "3:dp=0.2",
        "--push",
        "3:p=0.01",
        "--certify",
        "5",
    )
    done = ocp(*SMALL, *options, "--json")
    assert done.code == 0, done.err
    told = done.json
    run = store.load(told["run"])
    assert run.kind == "closed-loop" and told["status"] == "done"
    for name in set(told) - {"run", "pdf", "findings"}:
        assert told[name] == run.meta[name], name
    assert told["record"]["push"] == "3:dp=0.2, 3:p=0.01" and told["record"]["delay"] is True
    data = run.data
    assert data["x"].shape == (1, 16, 4) and data["plan"].shape == (1, 15, 6, 4)
    paid = float(data["cost"].sum() + data["end_cost"].sum())
    assert told["cost"] == pytest.approx(paid, rel=1e-12)
    assert sum(told["statuses"].values()) == 15
    assert (data["certificate"].values != "").sum() == 3 and told["certified"] is not None


@pytest.mark.costly
def test_a_loop_is_read_back_as_it_was_simulated(tmp_path: Path) -> None:
    problem = get("soft-walls", N=5)
    loop = simulate(Controller(problem), 12, "noise", seeds=2)
    data = labelled_arrays(loop, {})
    meta = {"kind": "closed-loop", "argv": [], "record": {}, **loop_summary(loop, data, [])}
    run = store.load(store.write_run(tmp_path, "soft-walls", data, meta).path)
    for name, array in loop.data.data_vars.items():
        assert run.data[name].dims == array.dims
        np.testing.assert_array_equal(run.data[name].values, array.values)
    assert run.meta["costs"] == loop.costs.tolist()
    # Under the model's own law the plant's forces are those of the contact's pairs.
    assert float(abs(run.data["lam"] * run.data["gap"]).max()) < 1e-9
    assert np.allclose(np.diff(run.data["time"].values), 0.01)


@pytest.mark.costly
def test_same_seed_same_bits(ocp: Ocp) -> None:
    options = ("--steps", "12", "--plant", "noise", "--seeds", "2", "--json")
    one, again, other = (
        ocp(*SMALL, *options, "--seed", seed, "--out", place).json
        for seed, place in (("3", "a"), ("3", "b"), ("4", "c"))
    )
    assert one["hash"] == again["hash"] != other["hash"]
    first, second = (store.load(done["run"]).data for done in (one, again))
    for name in set(map(str, first.variables)) - {"seconds"}:
        assert first[name].values.tobytes() == second[name].values.tobytes(), name
    x = first["x"].values
    assert not np.array_equal(x[0], x[1]), "each seed has its own noise"


@pytest.mark.one_case_in(3)
@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (("--phase", "nope"), "unknown phase 'nope'"),
        (("--plant", "refere"), "unknown plant 'refere' (did you mean 'referee'?)"),
        (("--rate", "0"), "--rate must be above 0, got 0"),
        (("--rate", "150"), "a rate of 150 Hz is 1.5 samples per step of 0.01 s; give a multiple of 100 Hz"),
        (("--rate", "nan"), "--rate must be a finite number, got 'nan'"),
        (("--noise-state", "nan"), "--noise-state must be a finite number, got 'nan'"),
        (("--noise-state", "-1"), "--noise-state must be 0 or more and finite, got -1.0"),
        (("--noise-state", "1", "--noise-state", "p=1"), "drop one of the two"),
        (("--noise-input", "v=1"), "--noise-input: unknown signal 'v'"),
        (("--mismatch", "mpp=1"), "no physical parameter 'mpp' (did you mean 'mp'?)"),
        (("--mismatch", "mp=-1"), "parameter mp (mass of the pole) must be a number > 0 [kg]"),
        (("--push", "20"), "--push: expected K:name=value, got '20'"),
        (("--push", "100:p=1"), "the sample must be a whole number >= 0 and <= 99, got 100"),
        (("--push", "2:q=1"), "--push: unknown state 'q'"),
        (("--contact", "barrier"), "phase qpcc plans under the exact law, not under barrier"),
        (("-c", "mu=1"), "contact law exact has no setting 'mu'"),
        (("--steps", "1e6", "--seeds", "1e4"), "10000 seeds of 1000000 samples would take"),
    ],
)
def test_bad_input_is_one_sentence(ocp: Ocp, options: tuple[str, ...], sentence: str) -> None:
    done = ocp(*SMALL, *options)
    assert done.code == 2 and sentence in done.err, done.err
    assert len(done.err.splitlines()) == 1 and not Path("runs").exists()


@pytest.mark.costly
def test_a_rate_faster_than_a_solve_is_told_and_goes_on(ocp: Ocp) -> None:
    done = ocp(*SMALL, "--steps", "25", "--rate", "1e6", "--deadline", "1e-6")
    assert done.code == 0
    assert "15 of 15 samples took longer than the period of 0.001 ms." in done.out
    assert "24 of the answers came after the deadline" in done.out


@pytest.mark.costly
def test_a_plant_that_diverges_ends_its_seed_and_is_kept(ocp: Ocp, loops: Path) -> None:
    run = store.load(store.find_run("@last", loops))
    assert run.meta["status"] == "diverged" and run.meta["ended"] == [5]
    first, *_ = run.meta["verdict"].splitlines()
    assert first == "The plant diverged in 1 of 1 seed, seed 0 at sample 5."
    assert np.isfinite(run.data["x"].values[0, :6]).all()
    assert np.isnan(run.data["x"].values[0, 6:]).all() and run.meta["cost"] is None
    assert ocp("report", "@last", "-o", "a.pdf", "--out", str(loops)).code == 0
    assert ocp("animate", "@last", "-o", "a.html", "--out", str(loops)).code == 0


def test_a_budget_bounds_the_counts_that_are_printed_and_stored(ocp: Ocp, tmp_path: Path) -> None:
    done = ocp(*SMALL, "--steps", "8", "--budget", "4", "--json", "--out", str(tmp_path))
    assert done.code == 0, done.err
    counts, data = done.json["counts"], store.load(done.json["run"]).data
    for name in ("programs", "qp_iterations"):
        assert sum(counts[name].values()) == 8
        assert max(map(int, counts[name])) == data[name].values.max() <= 4
    assert "quadratic programs" in done.err and "their iterations" in done.err


def test_a_histogram_has_every_sample_in_one_bin() -> None:
    iterations = {str(count): 1 + count % 3 for count in range(3, 60)}
    table = count_table({"programs": {"1": 7}, "qp_iterations": iterations})
    samples = [int(text) for text in table.columns[2].cells]
    assert samples[0] == 7 and sum(samples[1:]) == sum(iterations.values())
    assert len(samples) <= 14


@pytest.mark.costly
def test_ctrl_c_keeps_what_ran(tmp_path: Path) -> None:
    process = start([*SMALL, "--steps", "100000", "--seeds", "2", "--json"], tmp_path)
    read_until(process, "sample")
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130 and "stopped by the user" in err
    told = json.loads(out)
    run = store.load(tmp_path / told["run"])
    (ended,) = told["ended"]
    assert told["status"] == "stopped" and 0 < ended < 100_000
    assert np.isfinite(run.data["x"].values[0, : ended + 1]).all()
    (stop,) = (finding["numbers"] for finding in told["findings"] if finding["code"] == "stopped-by-the-user")
    assert (stop["seed"], stop["sample"], stop["samples"]) == (0, ended, 100_000)


def test_report_of_one_and_of_several(ocp: Ocp, loops: Path) -> None:
    for runs in (("@3",), ("@1", "@2", "@3")):
        done = ocp("report", *runs, "-o", "loop.pdf", "--out", str(loops))
        assert done.code == 0, done.err
        assert Path("loop.pdf").read_bytes().startswith(b"%PDF")
    solved = ocp("solve", "wall-1d", "-p", "N=5", "--effort", "quick", "-q", "--json").json["run"]
    done = ocp("report", "@1", solved, "-o", "mixed.pdf", "--out", str(loops))
    assert done.code == 2 and "needs runs of ocp solve, of ocp train or of ocp mpc" in done.err


def test_a_film_has_the_plan_and_the_cost(ocp: Ocp, loops: Path) -> None:
    done = ocp("animate", "@3", "-o", "loop.html", "--out", str(loops), "--json")
    assert done.code == 0, done.err
    text = Path("loop.html").read_text()
    found = re.search(r'<script[^>]*id="film"[^>]*>(.*?)</script>', text, re.DOTALL)
    assert found is not None
    film = json.loads(found[1])
    roles = {role for _, role in film["kinds"]}
    assert "plan" in roles and "object" in roles
    assert [chart["curves"][0]["name"] for chart in film["charts"]][-1] == "closed loop"
    run = store.load(store.find_run("@3", loops))
    assert film["charts"][-1]["curves"][0]["end"] == pytest.approx(run.meta["costs"][0], rel=1e-6)


def test_listing_and_export_know_the_kind(ocp: Ocp, loops: Path) -> None:
    listed = ocp("runs", "--kind", "closed-loop", "--json", "--out", str(loops)).json["runs"]
    assert [run["status"] for run in listed] == ["done", "done", "diverged"]
    assert "phase" in ocp("runs", "@3", "--out", str(loops)).out
    assert ocp("runs", "export", "@3", "-o", "loop.csv", "--out", str(loops)).code == 0
    lines = Path("loop.csv").read_text().splitlines()
    assert len(lines) == 1 + 3 * 25 and "u.u [N]" in lines[0] and "plan" not in lines[0]
    done = ocp("replay", "@3", "--out", str(loops))
    assert done.code == 2 and "expected a run of ocp solve" in done.err


def test_times_leave_out_the_start_of_each_seed() -> None:
    seconds = np.full((2, 30), 1.0)
    seconds[:, :10], seconds[1, 12:] = 9.0, np.nan
    assert counted_times(seconds).tolist() == [1.0] * 20 + [9.0] * 9 + [1.0] * 2


def test_a_loop_of_a_file_of_ones_own_keeps_its_drawing(ocp: Ocp) -> None:
    assert ocp("new", "bumper").code == 0
    done = ocp("mpc", "bumper.py", "--steps", "8", "--plant", "referee", "-q", "--pdf", "a.pdf")
    assert done.code == 0, done.err
    assert ocp("animate", "@last", "-o", "a.html").code == 0
    assert '"plan"' not in Path("a.html").read_text(), "the file draws the plan, and is not loaded"
    assert ocp("animate", "@last", "-o", "a.html", "--source", "bumper.py").code == 0
    assert '"plan"' in Path("a.html").read_text()


def test_a_learned_model_has_no_forces_to_plan_with(ocp: Ocp) -> None:
    assert ocp("collect", "push-1d", "--samples", "200", "-o", "data.nc", "-q").code == 0
    assert ocp("learn", "data.nc", "--model", "ewda", "-o", "model.nc", "-q").code == 0
    done = ocp("mpc", "push-1d", "--contact", "ewda", "-c", "model=model.nc", "--phase", "relaxed")
    assert done.code == 2 and "ewda has no pairs of force and gap" in done.err


def test_a_bound_that_the_plant_violates_is_exit_code_3_and_in_the_document(ocp: Ocp) -> None:
    """The box is pushed to 0.9 m, although at most 0.5 m from its cart's middle is allowed."""
    small = ("mpc", "cart-transport", "-p", "N=5", "--steps", "6")
    done = ocp(*small, "--push", "3:r=1.1", "--json")
    assert done.code == 3, done.err
    told = done.json
    assert told["status"] == "failed" and told["planned"] == 1.0
    (broken,) = told["violated"]
    assert (broken["name"], broken["component"], broken["step"]) == ("bound on x", "r", 3)
    assert told["cost"] == pytest.approx(told["stage_cost"] + told["terminal_cost"])
    (violation,) = (finding["numbers"] for finding in told["findings"] if finding["code"] == "plant-violates")
    assert (violation["constraint"], violation["sample"]) == ("bound on r", 3)
    assert ocp("report", "@last", "-o", "a.pdf").code == 0


@pytest.mark.costly
def test_a_stored_plan_is_tracked_until_its_end(ocp: Ocp) -> None:
    """The loop has the parameters, the number of steps and the cost of the plan."""
    solved = ocp("solve", "wall-1d", "-p", "N=12", "--json").json
    done = ocp("mpc", "wall-1d", "--plan", solved["run"], "--json")
    assert done.code == 0, done.err
    told = done.json
    assert told["cost"] == pytest.approx(solved["cost"], rel=1e-9)
    assert told["record"]["plan"] == Path(solved["run"]).name and told["record"]["params"]["N"] == 12
    data = store.load(told["run"]).data
    assert data["u"].shape == (1, 12, 1) and np.isnan(data["plan"].values[0, 1, -1]).all()
    for command in (("report", "@1", "-o", "a.pdf"), ("animate", "@1", "-o", "a.html")):
        assert ocp(*command).code == 0
    for options, sentence in (
        (("wall-1d", "--plan", solved["run"], "-p", "N=12"), "-p: the parameters are those of the run of --plan"),
        (("push-1d", "--plan", solved["run"]), "the run solves wall-1d, not push-1d"),
        (("wall-1d", "--plan", told["run"]), "expected a run of ocp solve"),
        (("wall-1d", "--plan", solved["run"], "--steps", "13"), "the tracked plan ends after 12 samples"),
    ):
        done = ocp("mpc", *options)
        assert done.code == 2 and sentence in done.err, done.err


@pytest.mark.costly
def test_a_loop_at_twice_the_rate_has_half_the_time_between_samples(ocp: Ocp) -> None:
    done = ocp(*SMALL, "--rate", "200", "--steps", "6", "--push", "2:dp=0.1", "--json")
    assert done.code == 0, done.err
    data = store.load(done.json["run"]).data
    assert np.allclose(np.diff(data["time"].values), 0.005) and done.json["seconds"]["period"] == pytest.approx(0.005)
    assert ocp("mpc", *SMALL[1:], "--rate", "200", "--json").json["record"]["samples"] == 200
    assert float(abs(data["lam"] * data["gap"]).max()) < 1e-9
