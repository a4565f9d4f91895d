"""``ocp collect``, ``ocp learn``, ``ocp show FILE``: from a problem or a table to a model."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from dynamics.learned import collecting
from dynamics.learned.ewda import EwdaModel
from dynamics.learned.transitions import split_rows
from ocp.store import models
from reports.cli import interrupt
from tests.cli.conftest import Ocp

COLLECT = ("collect", "push-1d", "--samples", "600", "-o", "data.nc")
SMALL = ("--hidden", "8,8", "--epochs", "6")
OWN = """
name, title = "own", "A mass before a wall"
import casadi as ca
from dynamics.systems import signals, time_stepping
from ocp.problem.problem import Problem
from problems.parameters import Parameters, quantity, table

class Params(Parameters):
    h: float = quantity(0.1, "s", "step size", above=0)

def build(params):
    p = table(params)
    system = time_stepping(
        name, states=signals("place [m]; speed [m/s]"), inputs=signals("kick [N s]"),
        contacts=signals("wall [N s]"), h=p["h"], mass=ca.SX(1), impulse=lambda q, v, u: u,
        distance=lambda q: q, parameters=p)
    cost = ca.sumsqr(system.x - ca.vertcat(1, 0))
    return Problem(name=name, system=system, N=6, stage_cost=cost + 0.1 * ca.sumsqr(system.u),
                   terminal_cost=cost, x0=ca.SX([0.5, 0]), parameters=p, u_lower=-1, u_upper=1)
"""


def own_table(file: Path, heads: str, n: int = 400) -> Path:
    """Write a table of measured steps of a mass before a wall: position, speed, impulse, and next values."""
    rng = np.random.default_rng(0)
    place, speed, kick = rng.uniform([0, -1, -1], [2, 1, 1], (n, 3)).T
    free = speed + kick
    after = np.where(place + 0.1 * free < 0, -place / 0.1, free)
    rows = np.stack([place, speed, kick, place + 0.1 * after, after], axis=1)
    lines = (",".join(map(repr, map(float, row))) for row in rows)
    file.write_text("\n".join([heads, *lines]) + "\n")
    return file


HEADS = "place [m],speed [m/s],kick [N s],place_next,speed_next"


def test_data_are_collected_and_shown(ocp: Ocp) -> None:
    done = ocp(*COLLECT, "--seed", "3", "-p", "width=0.3", "--json")
    told = done.json
    assert done.code == 0
    assert {key: told[key] for key in ("file", "kind", "problem", "rows", "seed", "in_tube")} == {
        **{"file": "data.nc", "kind": "transitions", "problem": "push-1d", "rows": 600},
        **{"seed": 3, "in_tube": 300},
    }
    assert told["params"]["width"] == 0.3 and told["unsolved"] == 0 and told["seconds"] > 0
    assert told["region"]["around"] == {"u": "qa"}
    names = [(row["name"], row["unit"], row["role"]) for row in told["coordinates"]]
    assert names == [("qu", "m", "state"), ("qa", "m", "state"), ("u", "m", "input")]
    data = models.load_transitions(Path("data.nc"))
    assert data.hash == told["hash"] and (data.x[:, 0] - data.x[:, 1]).min() >= 0.3
    np.testing.assert_allclose([row["scale"] for row in told["coordinates"]], data.z.std(axis=0))
    shown = ocp("show", "data.nc", "--json").json
    assert shown == {key: value for key, value in told.items() if key != "seconds"}
    text = ocp("show", "data.nc").out
    assert "600 transitions of push-1d, collected" in text and "300 near the line from start to goal" in text
    assert max(map(len, text.splitlines())) <= 80


def test_the_seed_decides(ocp: Ocp) -> None:
    hashes = [ocp(*COLLECT, "--seed", seed, "--json").json["hash"] for seed in ("1", "1", "2")]
    assert hashes[0] == hashes[1] != hashes[2]


@pytest.mark.costly
@pytest.mark.parametrize("model", ["ewda", "mlp"])
def test_a_model_is_learned_shown_and_planned_with(ocp: Ocp, model: str) -> None:
    assert ocp(*COLLECT, "--quiet").code == 0
    words = ["learn", "data.nc", "--model", model, "--noise", "0.1", "-o", "model.nc"]
    words += SMALL if model == "mlp" else ()
    done = ocp(*words, "--json", "--quiet")
    told = done.json
    assert done.code == 0 and "error" not in done.err
    assert (told["kind"], told["sigma"], told["problem"]) == (model, 0.1, "push-1d")
    assert (told["data"]["rows"], told["data"]["held_out"]) == (600, 60)
    assert told["hidden"] == ([8, 8] if model == "mlp" else None)
    assert told["epochs"] == (6 if model == "mlp" else None) and told["resumed"] == 0
    for row in told["coordinates"]:
        assert row["noise"] == pytest.approx(0.1 * row["scale"])
    assert [row["name"] for row in told["fit"]["states"]] == ["qu", "qa"]
    beside = {"seconds", "epochs", "resumed", "seeds"}
    shown = ocp("show", "model.nc", "--json").json
    assert shown == {key: value for key, value in told.items() if key not in beside}
    text = ocp("show", "model.nc").out
    assert f"{model} of push-1d" in text and "sigma 0.1, normalised" in text
    assert "540 transitions, 60 held out" in text
    assert max(map(len, text.splitlines())) <= 80
    first = Path("model.nc").read_bytes()
    assert ocp(*words, "--quiet").code == 0 and Path("model.nc").read_bytes() == first
    assert not list(Path().glob(".unfinished-*"))
    words = ["--contact", model, "-c", "model=model.nc"]
    solved = ocp("solve", "push-1d", *words, "--pdf", "plan.pdf", "--json", "-q")
    assert solved.code in (0, 3) and solved.json["contact"] == model
    assert solved.json["complementarity"] is None and solved.json["exact_cost"] > 0
    assert "learned from data and has no contact forces" in solved.json["verdict"]
    assert Path("plan.pdf").read_bytes().startswith(b"%PDF")
    run = solved.json["run"]
    assert ocp("replay", run, "--quiet").code == 0
    assert ocp("report", run, "-o", "again.pdf", "--quiet").code == 0
    assert ocp("animate", run, "-o", "plan.gif", "--quiet").code == 0
    again = ocp("solve", "push-1d", "--contact", "barrier", *words, "--from", run, "--json", "-q")
    assert again.json["cost"] == pytest.approx(solved.json["cost"], rel=1e-6)
    over = ["--over", "M", "--from", "1", "--to", "1.2", "--steps", "2", "--json", "-q"]
    assert len(ocp("continue", "push-1d", "--contact", "barrier", *words, *over).json["points"]) == 3
    if model == "ewda":
        # The cost may fall as trust grows, since the path has a fold at every datum that it passes.
        over = ["--over", "contact.trust", "--from", "0", "--to", "1e-3", "--steps", "2"]
        points = ocp("continue", "push-1d", "--contact", "barrier", *words, *over, "--json", "-q").json["points"]
        assert (points[0]["value"], points[-1]["value"]) == (0, 1e-3)
    judged = ocp("estimate", "push-1d", *words, "-n", "200", "--json", "-q")
    assert judged.code == 0 and judged.json["estimates"]
    refused = ocp("export", "push-1d", *words, "-o", "step.c")
    assert refused.code == 2 and "cannot be exported to C" in refused.err


@pytest.mark.costly
def test_the_fit_is_that_of_rows_that_the_model_has_not_seen(ocp: Ocp) -> None:
    ocp(*COLLECT, "--quiet")
    told = ocp("learn", "data.nc", "--model", "ewda", "-o", "model.nc", "--json").json
    data, model = models.load_transitions(Path("data.nc")), models.load_model(Path("model.nc"))
    assert isinstance(model, EwdaModel) and len(model.z) == 540
    kept, held = split_rows(600, 0.1, 0)
    assert np.array_equal(model.z, data.z[kept])
    off = model.values(data.z[held])[:, :2] - data.x_next[held]
    clean = [row["clean"] for row in told["fit"]["states"]]
    np.testing.assert_allclose(clean, np.sqrt(np.mean(off**2, axis=0)), rtol=1e-12)
    np.testing.assert_allclose(model.scales.scale, data.z.std(axis=0), rtol=1e-12)


@pytest.mark.costly
def test_a_user_s_table_becomes_a_plan(ocp: Ocp) -> None:
    Path("own.py").write_text(OWN)
    own_table(Path("own.csv"), HEADS)
    done = ocp("learn", "own.csv", "--model", "ewda", "-o", "own.nc", "--problem", "own.py", "-q", "--json")
    assert done.code == 0, done.err
    assert (done.json["problem"], done.json["data"]["how"]) == ("own", "read from own.csv")
    solved = ocp("solve", "own.py", "--contact", "ewda", "-c", "model=own.nc", "--json", "-q")
    assert solved.code == 0, solved.err
    # The average is that of data near a plan that starts at 0.5 m and goes to 1 m.
    assert solved.json["success"] and np.isfinite(solved.json["exact_cost"])
    collected = ocp("collect", "own.py", "-n", "300", "-o", "own-data.nc", "--json", "-q")
    assert collected.json["problem"] == "own" and collected.json["rows"] == 300


REGION = """
from dynamics.learned.region import Region

def region(params):
    return Region({"place": (0, 3), "speed": (-2, 2)}, {"kick": (-0.5, 0.5)}, (0.5, 0), (1, 0),
                  (0.1, 0.1))
"""


def test_a_user_s_file_may_say_where_data_are_drawn(ocp: Ocp) -> None:
    Path("own.py").write_text(OWN + REGION)
    words = ["collect", "own.py", "-n", "200", "-o", "own.nc"]
    assert ocp(*words, "--json").json["region"]["states"]["place"] == [0, 3]
    data = models.load_transitions(Path("own.nc"))
    assert np.abs(data.u).max() <= 0.5 and np.abs(data.x[:100, 1]).max() > 1.5
    for wrong, message in (
        ("def region(params): return 3", "region(params) returned int, expected a"),
        ("def region(params): return 1 / 0", "region(params) failed: line "),
        (REGION.replace("place", "plce"), "a range for states plce, speed, and own has place"),
    ):
        Path("own.py").write_text(f"{OWN}\n{wrong}")
        done = ocp(*words)
        assert done.code == 2 and message in done.err and done.err.count("\n") == 1


def test_columns_are_mapped(ocp: Ocp) -> None:
    own_table(Path("own.csv"), "p,v,k,p1,v1")
    names = "place=p,speed=v,kick=k,place_next=p1,speed_next=v1"
    done = ocp("learn", "own.csv", "--model", "ewda", "-o", "own.nc", "--columns", names, "--json")
    assert done.code == 0, done.err
    assert done.json["problem"] is None
    assert [row["name"] for row in done.json["coordinates"]] == ["place", "speed", "kick"]
    assert "an unnamed system" in ocp("show", "own.nc").out


@pytest.mark.costly
def test_a_training_that_was_interrupted_goes_on(ocp: Ocp, monkeypatch: pytest.MonkeyPatch) -> None:
    ocp(*COLLECT, "--quiet")
    words = ["learn", "data.nc", "--model", "mlp", *SMALL, "-o", "{}.nc", "--quiet"]
    assert ocp(*(word.format("whole") for word in words)).code == 0
    epochs = iter(range(1, 100))

    def ctrl_c() -> None:
        if next(epochs) == 4:
            raise KeyboardInterrupt

    monkeypatch.setattr(interrupt, "raise_if_interrupted", ctrl_c)
    stopped = ocp(*(word.format("parts") for word in words))
    assert stopped.code == interrupt.EXIT_CODE and not Path("parts.nc").exists()
    assert len(list(Path().glob(".unfinished-*"))) == 1
    done = ocp(*(word.format("parts") for word in words), "--json")
    assert (done.json["resumed"], done.json["epochs"]) == (4, 6)
    assert Path("parts.nc").read_bytes() == Path("whole.nc").read_bytes()
    assert not list(Path().glob(".unfinished-*"))


@pytest.mark.costly
def test_the_best_of_several_seeds_is_kept_whatever_the_processes(ocp) -> None:
    collected = ocp("collect", "push-1d", "-n", "400", "-o", "data.nc", "-q")
    assert collected.code == 0
    network = ("--model", "mlp", "--hidden", "4", "--epochs", "3", "-q")
    both = ocp("learn", "data.nc", *network, "--seeds", "2", "-j", "2", "-o", "best.nc", "--json")
    errors = both.json["seeds"]
    alone = {
        seed: ocp("learn", "data.nc", *network, "--seed", seed, "-o", f"{seed}.nc", "--json").json for seed in errors
    }
    assert errors == {seed: found["seeds"][seed] for seed, found in alone.items()}
    best = min(errors, key=errors.__getitem__)
    for key in ("fit", "outside"):
        assert both.json.get(key) == alone[best].get(key)


@pytest.mark.costly
def test_pieces_are_the_same_data_in_any_process(ocp, monkeypatch) -> None:
    monkeypatch.setattr(collecting, "PIECE_ROWS", 100)
    words = ("collect", "push-1d", "-n", "350", "--seed", "3", "-q")
    assert ocp(*words, "-o", "one.nc").code == 0
    assert ocp(*words, "-o", "two.nc", "-j", "2").code == 0
    one, two = (xr.load_dataset(file) for file in ("one.nc", "two.nc"))
    assert one.attrs["data_hash"] == two.attrs["data_hash"]
    xr.testing.assert_identical(one, two)
