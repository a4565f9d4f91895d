"""Reports of ``ocp`` on a solution: exit codes, requirements, ranks, colours, points of continuations."""

from __future__ import annotations

import io
import json
import math
import re
from pathlib import Path
from types import SimpleNamespace

import pytest

from ocp import store
from reports.cli.streams import Output
from reports.documents.solve import solve_page
from reports.drawing.style import house_style
from reports.drawing.view import RunView

QUIET = ("--json", "--quiet")
EXACT = ("--contact", "exact")
KINKED = (
    "solve",
    "push-disc",
    *EXACT,
    "--method",
    "single-shooting",
    "-s",
    "homotopy=true",
)
"""Command line of a solve that ends without multipliers, so that the certificate needs a linear program."""


# --- exit codes --------------------------------------------------------------------------------


@pytest.mark.costly
def test_what_is_certified_is_done_whether_or_not_it_survives(ocp) -> None:
    done = ocp("solve", "planar-push", *EXACT, *QUIET)
    found = done.json
    assert done.code == 0
    assert (found["success"], found["survives"], found["grade"]) == (True, False, "certified")
    assert (found["stationarity"], found["status"]) == ("B", "solved")
    assert found["referee_cost"] > 1.1 * found["cost"]
    assert found["referee"]["reasons"] and found["referee_gap"] > 0
    assert found["verdict"].partition("\n")[0].endswith("; does not survive.")


@pytest.mark.costly
def test_survival_can_be_required(ocp) -> None:
    assert ocp("solve", "planar-push", *EXACT, *QUIET, "--require", "survives").code == 3
    done = ocp("solve", "push-1d", *EXACT, *QUIET, "--require", "survives")
    assert done.code == 0
    assert (done.json["survives"], done.json["grade"]) == (True, "survives")


@pytest.mark.costly
def test_a_plan_that_survives_at_its_step_only_is_not_what_is_required(ocp) -> None:
    done = ocp("solve", "cart-walls", *EXACT, *QUIET, "--require", "survives")
    found = done.json
    assert done.code == 3 and found["success"]
    assert (found["survives"], found["survives_at_h"]) == (False, True)
    assert f"at h/4 it costs {found['refined_cost']:.6g}." in found["verdict"]


@pytest.mark.costly
def test_refine_tells_every_step_and_refuses_what_has_none(ocp) -> None:
    coarse = ("-p", "h=0.2", "-p", "N=10")
    found = ocp("solve", "ball-bounce", *EXACT, *coarse, "--refine", *QUIET).json
    levels = found["refined"]["levels"]
    assert len(levels) > 1 and levels[-1]["cost"] == found["cost"]
    assert found["params"]["N"] == levels[-1]["N"] == 10 * 2 ** (len(levels) - 1)
    refused = ocp("solve", "push-1d", "--contact", "barrier", "--refine")
    assert refused.code == 2 and "the step size is part of the model" in refused.err


def test_what_is_not_certified_is_not_done(ocp) -> None:
    shooting = ("--method", "single-shooting", "-s", "homotopy=false")
    done = ocp("solve", "push-disc", *EXACT, *shooting, *QUIET)
    found = done.json
    assert done.code == 3
    assert (found["success"], found["grade"]) == (False, "failed")
    assert found["status"] in ("no-progress", "not-optimal")
    assert found["dynamics_residual"] < 1e-8, "it is feasible, and that is not enough"
    assert found["cost"] > 1.02 * 0.1006, "the optimum costs less"


def test_what_obeys_no_dynamics_is_not_called_unstable(ocp) -> None:
    found = ocp("solve", "wall-1d", *EXACT, "-s", "max_iter=2", "--effort", "quick", *QUIET).json
    assert found["dynamics_residual"] > 1e-3 and not found["success"]
    assert "unstable-motion" not in {finding["code"] for finding in found["findings"]}


@pytest.mark.parametrize(
    ("option", "word", "meant"),
    [("--require", "survive", "survives"), ("--rank", "refree", "referee")],
)
def test_unknown_words_say_what_was_meant(ocp, option: str, word: str, meant: str) -> None:
    done = ocp("solve", "push-1d", "--contact", "barrier", option, word)
    assert done.code == 2
    assert f"{word!r} (did you mean {meant!r}?)" in done.err
    assert done.err.count("\n") == 1 and not Path("runs").exists()


# --- trouble of the certificate ----------------------------------------------------------------


@pytest.fixture
def without_proof(monkeypatch: pytest.MonkeyPatch) -> None:
    """Disable proofs by multipliers, so that certificates need linear programs."""
    monkeypatch.setattr("ocp.judge.lpec.LinearModel.dual_bound", lambda *_: math.inf)


@pytest.mark.costly
@pytest.mark.usefixtures("without_proof")
def test_a_program_that_fails_is_undecided(ocp, monkeypatch: pytest.MonkeyPatch) -> None:
    failure = SimpleNamespace(status=4, x=None, message="numerical difficulties")
    monkeypatch.setattr("scipy.optimize.milp", lambda *_, **__: failure)
    done = ocp(*KINKED, *QUIET)
    assert done.code == 3
    assert done.json["stationarity"] == "undecided"
    (undecided,) = (one["numbers"] for one in done.json["findings"] if one["code"] == "stationarity-undecided")
    assert "HiGHS reports 'numerical difficulties'" in undecided["reason"]
    assert "Traceback" not in done.err


NO_NUMBER = """
from __future__ import annotations
import casadi as ca
import numpy as np
from dynamics.systems import signals, time_stepping
from ocp.problem.problem import Problem
from problems.parameters import Parameters, structure, table

name = "no-number"
title = "The logarithm of a negative number"

def guess(problem, values):
    return np.full((problem.N + 1, 2), -1.0), np.zeros((problem.N, 1))

class Params(Parameters):
    N: int = structure(5, "number of steps", least=1)

def build(params):
    p = table(params)
    system = time_stepping(
        name, states=signals("q [m]; v [m/s]"), inputs=signals("u [N s]"),
        contacts=signals("wall [N s]"), h=0.1, mass=1.0, impulse=lambda q, v, u: u,
        distance=lambda q: q, parameters=p)
    return Problem(name=name, system=system, N=params.N,
                   stage_cost=ca.sumsqr(system.u) + ca.log(system.x[0]),
                   terminal_cost=ca.SX(0), x0=ca.SX([1, 0]), parameters=p, guess=guess)
"""


@pytest.mark.parametrize("law", ["exact", "barrier"])
def test_a_start_without_a_cost_is_told_in_a_sentence(ocp, tmp_path: Path, law: str) -> None:
    (tmp_path / "bad.py").write_text(NO_NUMBER)
    done = ocp("solve", "bad.py", "--contact", law, "--effort", "quick", "--quiet")
    assert done.code == 3
    assert done.out.splitlines()[0].startswith("Not converged: cost ")
    assert "The cost is NaN or infinite at the last iterate" in done.out
    assert done.err == ""
    run = re.findall(r"^run: (.*)$", done.out, re.M)[0]
    assert json.loads((Path(run) / "meta.json").read_text())["grade"] == "failed"
    (tmp_path / "bad.py").write_text(NO_NUMBER.replace("SX([1, 0])", "SX([0, 0])"))
    refused = ocp("solve", "bad.py", "--contact", law, "--effort", "quick", "--quiet")
    assert refused.code == 2, "without a cost at x0 nothing is tried"
    assert "the cost is not a finite number at x0" in refused.err and refused.err.count("\n") == 1


# --- several starts, and a start from a run ------------------------------------------------------


POST = """
from problems.parameters import Parameters, quantity
from tests.unit.ocp.user_problems import round_a_post

name = "round-a-post"
title = "A disc, pulled back to behind a post"

class Params(Parameters):
    h: float = quantity(0.1, "s", "step size", above=0)
    post: float = quantity(0.3, "m", "radius of the post", above=0)

def build(params):
    return round_a_post()
"""


@pytest.mark.costly
def test_starts_are_ranked_by_their_referee(ocp, tmp_path: Path) -> None:
    """The solution that is cheaper with linearised gaps costs more with true ones."""
    (tmp_path / "post.py").write_text(POST)
    arguments = ("solve", "post.py", *EXACT, *QUIET, "--starts", "3")
    planned, refereed = ocp(*arguments), ocp(*arguments, "--rank", "referee")
    for done, key, other in (
        (planned, "cost", "referee_cost"),
        (refereed, "referee_cost", "cost"),
    ):
        found = done.json
        assert done.code == 0 and all(start["status"] == "solved" for start in found["others"])
        assert found[key] == min(start[key] for start in found["others"])
        assert found[other] > 1.05 * min(start[other] for start in found["others"])
        (chosen,) = (start for start in found["others"] if start["chosen"])
        assert chosen["cost"] == found["cost"]


@pytest.mark.costly
def test_a_start_that_did_not_help_is_said(ocp) -> None:
    first = ocp("solve", "push-1d", "--contact", "barrier", *QUIET).json
    cold = ocp(
        "solve",
        "push-1d",
        *EXACT,
        *QUIET,
        "--from",
        first["run"],
        "-s",
        "max_iter=3",
    )
    assert "did not converge from the stored run" in cold.json["verdict"]
    warm = ocp("solve", "push-1d", *EXACT, *QUIET, "--from", first["run"])
    assert warm.code == 0 and "started at" not in warm.json["verdict"]


# --- colours -----------------------------------------------------------------------------------


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(("grade", "code"), [("survives", 32), ("certified", 33), ("failed", 31)])
def test_a_verdict_has_its_colour_on_a_terminal(grade, code, monkeypatch) -> None:
    shown = Terminal()
    monkeypatch.setattr("sys.stdout", shown)
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.delenv("NO_COLOR", raising=False)
    Output(as_json=False, quiet=True).verdict("Head: cost 1.\nA finding.", grade)
    first, second = shown.getvalue().splitlines()[:2]
    assert f"\x1b[1;{code}m" in first and "Head: cost 1." in first
    assert second == "A finding."


def test_a_verdict_in_a_pipe_is_plain(capsys) -> None:
    Output(as_json=False, quiet=True).verdict("Head.\nA finding.", "survives")
    assert capsys.readouterr().out == "Head.\nA finding.\n"


@pytest.mark.costly
def test_the_pages_bar_has_the_grade_of_the_run(ocp) -> None:
    grades = {}
    for arguments in (
        ("push-1d", *EXACT),
        ("planar-push", *EXACT),
        ("push-1d", *EXACT, "--method", "single-shooting", "-s", "homotopy=false"),
    ):
        found = ocp("solve", *arguments, *QUIET).json
        with house_style():
            content, _ = solve_page(RunView.of(store.load(Path(found["run"]))))
        assert content["grade"] == found["grade"]
        assert content["verdict"] == found["verdict"]
        grades[found["grade"]] = content["verdict"].partition("\n")[0]
    assert set(grades) == {"survives", "certified", "failed"}
    assert grades["survives"].endswith("; survives.")
    assert grades["certified"].endswith("; does not survive.")
    assert grades["failed"].startswith("No-progress")


# --- paths ---------------------------------------------------------------------------------------


@pytest.mark.costly
def test_points_of_a_path_carry_all_three_judges(ocp) -> None:
    found = ocp(
        "continue",
        "planar-push",
        "--contact",
        "barrier",
        "--over",
        "contact.mu",
        "--from",
        "1e-2",
        "--to",
        "1e-3",
        "--scale",
        "log",
        "--steps",
        "2",
        "--json",
        "--quiet",
    ).json
    assert len(found["points"]) >= 3
    for point in found["points"]:
        assert point["stationarity"] == "KKT" and point["success"]
        assert point["survives"] is False
        assert point["referee_cost"] > 1.1 * point["cost"]


@pytest.mark.costly
def test_a_sensitivity_is_printed_with_those_of_its_replays(ocp) -> None:
    found = ocp("solve", "push-1d", *EXACT, "--sensitivity", "M", *QUIET).json
    slopes = found["sensitivities"]["M"]
    assert slopes["cost_referee"] == pytest.approx(slopes["cost"], rel=1e-5)
    assert slopes["cost_refined"] is None, "the step size is part of the model"
    (finding,) = (one for one in found["findings"] if one["code"] == "sensitivity")
    assert finding["numbers"].items() <= slopes.items()
    assert finding["sentence"].startswith(f"the sensitivity dcost/dM is {slopes['cost']:.4g}, ")
    unknown = ocp("solve", "push-1d", "--sensitivity", "penalty")
    assert unknown.code == 2 and "unknown parameter 'penalty'" in unknown.err
    short = ("--contact", "barrier", "-s", "ipopt.max_iter=1", "--sensitivity", "M")
    failed = ocp("solve", "push-1d", *short, *QUIET)
    assert failed.code == 3 and "not solved" in failed.json["sensitivities"]["M"]["sentence"]


@pytest.mark.costly
def test_until_survives_tells_every_rung_and_exits_3_where_none_survives(ocp) -> None:
    hill = str(Path(__file__).parents[1] / "golden" / "cases" / "hill.py")
    quick = ("solve", hill, *EXACT, "--effort", "quick", "--until", "survives")
    done = ocp(*quick, "--pdf", "hill.pdf", *QUIET)
    ladder = done.json["ladder"]
    assert done.code == 0 and done.json["survives"] and Path("hill.pdf").read_bytes().startswith(b"%PDF")
    assert ladder["rungs"][ladder["chosen"]]["name"] == "gains"
    assert [row["draws"] for row in ladder["disturbed"]] == [1, 20, 20, 1]
    far = ("-c", "mu=0.3", "-p", "u_max=0.5", "--effort", "quick", "--until", "survives")
    dear = ocp("solve", "push-1d", "--contact", "barrier", *far, *QUIET)
    assert dear.code == 3 and dear.json["survives"] is False and dear.json["cost"] > dear.json["ladder"]["largest_cost"]
    shown = ocp(*quick, "-p", "scenarios=2")
    assert shown.code == 3 and "until it survives" in shown.err and "not tried" in shown.err
    assert "No rung survives; the best is" in shown.err + shown.out
