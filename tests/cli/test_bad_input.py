"""Bad input gives a sentence that names the error, exit code 2, no traceback, and no stored run."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.resealed import having, lacking, reseal

SOLVE = ("solve", "wall-1d")
SMOOTH = (*SOLVE, "--contact", "barrier")
CONTINUE = ("continue", "wall-1d", "--contact", "barrier", "--over", "contact.mu")

CASES = {
    "problem": (["solve", "wal-1d"], ["'wal-1d'", "did you mean 'wall-1d'", "push-disc"]),
    "robot": (["solve", "go1.urdf"], ["not what to do", "ocp new NAME --robot"]),
    "problem in show": (["show", "ball-bonce"], ["did you mean 'ball-bounce'"]),
    "command": (["sole"], ["sole", "solve"]),
    "option": ([*SOLVE, "--bogus"], ["--bogus"]),
    "no problem": (["solve"], ["PROBLEM"]),
    "law": ([*SOLVE, "--contact", "barier"], ["did you mean 'barrier'", "randomized"]),
    "law's setting": ([*SOLVE, "-c", "nu=1"], ["'nu'", "did you mean 'mu'", "kappa"]),
    "setting's type": ([*SMOOTH, "-c", "mu=abc"], ["mu must be a number", "'abc'"]),
    "mu = 0": ([*SMOOTH, "-c", "mu=0"], ["mu", "exact law"]),
    "mu not finite": ([*SMOOTH, "-c", "mu=nan"], ["mu", "finite"]),
    "mu and kappa": ([*SMOOTH, "-c", "mu=1", "-c", "kappa=1"], ["mu or kappa"]),
    "negative sigma": (
        [*SOLVE, "--contact", "adaptive", "-c", "sigma=-0.1"],
        ["sigma must be a number > 0", "-0.1"],
    ),
    "sigma in quartic": (
        [*SOLVE, "--contact", "adaptive", "-c", "law=quartic", "-c", "sigma=1"],
        ["sigma does not belong"],
    ),
    "no assignment": ([*SOLVE, "-c", "mu"], ["name=value", "'mu'"]),
    "given twice": ([*SMOOTH, "-c", "mu=1", "-c", "mu=2"], ["twice"]),
    "base without name": (
        [*SOLVE, "--contact", "randomized", "-c", "base.mu=1"],
        ["base=barrier"],
    ),
    "base of a plain law": ([*SMOOTH, "-c", "base.mu=1"], ["no base law"]),
    "base law": (
        [*SOLVE, "--contact", "randomized", "-c", "base=barier"],
        ["did you mean 'barrier'"],
    ),
    "whole number": (
        [*SOLVE, "--contact", "randomized", "-c", "samples=2.5"],
        ["samples must be a whole number"],
    ),
    "kappa without energy": (
        ["solve", "cart-walls", "--contact", "barrier", "-c", "kappa=10"],
        ["kappa", "give mu instead"],
    ),
    "an objective": (["solve", "heaviside"], ["no", "ocp estimate heaviside"]),
    "method": ([*SOLVE, "--method", "driect"], ["did you mean 'direct'", "single-shooting"]),
    "policy": ([*SOLVE, "--policy", "feedbak"], ["did you mean 'feedback'"]),
    "policy's setting": (
        [*SOLVE, "--policy", "feedback", "-s", "policy.bounf=1"],
        ["did you mean 'bound'"],
    ),
    "solver": ([*SOLVE, "--solver", "ipop"], ["did you mean 'ipopt'", "fatrop"]),
    "strategy": (
        [*SOLVE, "--contact", "exact", "-s", "strategy=scholte"],
        ["did you mean 'scholtes'"],
    ),
    "setting": ([*SOLVE, "-s", "homotpy=true"], ["did you mean 'homotopy'"]),
    "solver's option": ([*SOLVE, "-s", "no_such_option=1"], ["no_such_option"]),
    "law that a method cannot take": (
        [*SOLVE, "--contact", "adaptive", "-c", "gradient=frozen"],
        ["frozen gradient", "single-shooting"],
    ),
    "parameter": ([*SOLVE, "-p", "mass=1"], ["unknown parameter 'mass'", "goal_x"]),
    "parameter's type": ([*SOLVE, "-p", "m=heavy"], ["m (mass)", "[kg]", "'heavy'"]),
    "parameter's range": ([*SOLVE, "-p", "m=-1"], ["number > 0 [kg]"]),
    "parameter not finite": ([*SOLVE, "-p", "h=inf"], ["step size", "'inf'"]),
    "zero horizon": ([*SOLVE, "-p", "N=0"], ["number of steps", ">= 1"]),
    "starts": ([*SOLVE, "--starts", "0"], ["--starts"]),
    "seed": ([*SOLVE, "--seed", "x"], ["--seed"]),
    "file": (["solve", "no_such_file.py"], ["no_such_file.py", "no such file"]),
    "run": (["replay", "nothing"], ["no run 'nothing'", "ocp runs"]),
    "run to report": (["report", "nothing", "-o", "x.pdf"], ["no run 'nothing'"]),
    "report without a file": (["report", "nothing"], ["--output"]),
    "PDF in a directory's place": ([*SOLVE, "--pdf", "."], ["is a directory"]),
    "parameter of a law": (
        [
            "continue",
            "wall-1d",
            "--contact",
            "barrier",
            "--over",
            "contact.nu",
            "--from",
            "1",
            "--to",
            "2",
        ],
        ["did you mean 'contact.mu'", "goal_x"],
    ),
    "scale": ([*CONTINUE, "--from", "1", "--to", "2", "--scale", "lgo"], ["did you mean 'log'"]),
    "log through zero": (
        [
            "continue",
            "push-disc",
            "--over",
            "goal_x",
            "--from",
            "1",
            "--to",
            "-1",
            "--scale",
            "log",
        ],
        ["log scale", "positive"],
    ),
    "option's type": ([*SOLVE, "-s", "max_iter=abc"], ["max_iter must be a whole number >= 0"]),
    "option's whole number": ([*SOLVE, "-s", "max_iter=1.5"], ["max_iter must be a whole number"]),
    "option's range": ([*SOLVE, "-s", "eta_phi=0.7"], ["eta_phi", "> 0 and < 0.5"]),
    "option's word": ([*SOLVE, "-s", "mu_strategy=fast"], ["mu_strategy must be 'monotone' or 'adaptive'"]),
    "option not a number": ([*SOLVE, "-s", "tol=nan"], ["tol must be a finite number > 0"]),
    "option beyond numbers": ([*SOLVE, "-s", "tol=1e400"], ["tol must be a finite number"]),
    "worthless tolerance": ([*SOLVE, "-s", "dual_inf_tol=1e10"], ["at most 0.0001", "1e+10"]),
    "option of another solver": (
        [*SOLVE, "--solver", "uno", "-s", "max_iter=9"],
        ["did you mean 'max_iterations'"],
    ),
    "option given twice": ([*SOLVE, "--solver", "snopt", "--solver", "ipopt"], ["given 2 times"]),
    "no text": ([*SOLVE, "--pdf", "\udcff.pdf"], ["--pdf is not valid UTF-8", "UTF-8"]),
    "no text for a command": (["\udcff"], ["No such command"]),
    "empty option": ([*SOLVE, "--out", ""], ["--out is empty"]),
    "long name": (["solve", "a" * 9000], ["unknown problem", "aaa...aaa"]),
    "long run": (["replay", "a" * 9000], ["aaa...aaa"]),
    "long file": ([*SOLVE, "--pdf", "a" * 9000 + ".pdf"], ["aaa...aaa"]),
    "horizon beyond memory": ([*SOLVE, "-p", "N=100000000"], ["2.72e+03 GB of memory"]),
    "strategy without pairs": ([*SOLVE, "-s", "strategy=l1"], ["strategy would have no effect"]),
    "factor without a path": (
        [*SOLVE, "-s", "homotopy=false", "-s", "factor=0.5"],
        ["factor would have no effect"],
    ),
    "figure beyond memory": (["figure", "P1", "-p", "n_samples=1000000000000"], ["GB of memory"]),
    "guess without a file": ([*SOLVE, "--guess", "no.json"], ["no.json", "No such file"]),
    "guess without a run": ([*SOLVE, "--guess", "nothing"], ["no run 'nothing'"]),
    "guess and starts": ([*SOLVE, "--guess", "a.json", "--starts", "2"], ["drop --starts and --from"]),
    "rank of one": ([*SOLVE, "--rank", "referee"], ["--starts 2"]),
    "animation without a name": (["animate", "x", "-o", ""], ["--output is empty"]),
    "what is followed": ([*CONTINUE, "--from", "1", "--to", "2", "-c", "mu=3"], ["drop -c mu"]),
    "end not finite": ([*CONTINUE, "--from", "nan", "--to", "2"], ["--from", "finite"]),
    "no way to go": ([*CONTINUE, "--from", "1", "--to", "1"], ["differ"]),
}


@pytest.mark.one_case_in(6)
@pytest.mark.parametrize(("arguments", "words"), CASES.values(), ids=CASES)
def test_wrong_usage(ocp, tmp_path: Path, arguments: list[str], words: list[str]) -> None:
    done = ocp(*arguments)
    assert done.code == 2
    assert done.out == ""
    assert done.err.startswith("error: ")
    assert len(done.err.strip().splitlines()) <= 2
    assert "Traceback" not in done.err
    for word in words:
        assert word in done.err
    assert not list(tmp_path.rglob("meta.json"))


GUESSES = {
    "no JSON": ("guess.json", "{", ["cannot be read as JSON"]),
    "no TOML": ("guess.toml", "a =", ["cannot be read as TOML"]),
    "deep JSON": ("guess.json", "[" * 100_000, ["cannot be read as JSON"]),
    "no text": ("guess.json", "\udcff", ["cannot be read as JSON"]),
    "no table": ("guess.json", "[1]", ["guess.json must be a dictionary"]),
    "table": ("guess.json", '{"keyframe": {}}', ["did you mean 'keyframes'"]),
    "table's kind": ("guess.json", '{"contacts": 3}', ["guess.json['contacts'] must be a dictionary, got 3"]),
    "nothing": ("guess.json", "{}", ["is empty"]),
    "state": ("guess.toml", "[keyframes.3]\ny = 1", ["unknown state 'y'", "there are x, v"]),
    "step": ("guess.toml", "[keyframes.99]\nx = 1", ["steps 0 to 30, got 99"]),
    "step's name": ("guess.toml", "[keyframes.-1]\nx = 1", ["is its step, a whole number; got '-1'"]),
    "two keyframes": ("guess.json", '{"keyframes": {"3": {"x": 1}, "3": {"x": 2}}}', ["'3' twice"]),
    "two names": ("guess.json", '{"keyframes": {"3": {"x": 1}, "03": {"x": 2}}}', ["3 twice"]),
    "shape": ("guess.json", '{"keyframes": {"3": [1]}}', ["must have 2 states, x, v; got (1,)"]),
    "value": ("guess.json", '{"keyframes": {"3": {"x": [1, 2]}}}', ["x must be a number"]),
    "not finite": ("guess.json", '{"keyframes": {"3": {"x": NaN}}}', ["x must be a finite number"]),
    "path": ("guess.json", '{"paths": {"x": 1}}', ["two or more numbers"]),
    "contact": ("guess.json", '{"contacts": {"floor": [[1, 2]]}}', ["unknown contact 'floor'"]),
    "range": ("guess.json", '{"contacts": {"wall": [1, 2]}}', ["contacts['wall'][0]"]),
    "range's step": ("guess.json", '{"contacts": {"wall": [[1, 31]]}}', ["steps 0 to 30, got 31"]),
}


@pytest.mark.one_case_in(6)
@pytest.mark.parametrize(("file", "text", "words"), GUESSES.values(), ids=GUESSES)
def test_a_guess_that_does_not_fit(ocp, tmp_path: Path, file: str, text: str, words: list[str]) -> None:
    (tmp_path / file).write_text(text, errors="surrogateescape")
    test_wrong_usage(ocp, tmp_path, [*SOLVE, "--contact", "exact", "--guess", file], words)


def test_debug_shows_where(ocp) -> None:
    done = ocp("solve", "wall-1d", "--contact", "barrier", "-c", "mu=0", "--debug")
    assert done.code == 2
    assert "Traceback" in done.err
    assert "error: barrier: mu" in done.err


USER_FILE = """
import casadi as ca
from dynamics.systems import signals, time_stepping
from ocp.problem.problem import Problem
from problems.parameters import Parameters, quantity, structure, table

name = "mine"
title = "My problem"

class Params(Parameters):
    m: float = quantity(1.0, "kg", "mass", above=0)
    N: int = structure(5, "number of steps", least=1)

def build(params):
    p = table(params)
    system = time_stepping(
        name, states=signals("q [m]; v [m/s]"), inputs=signals("u [N s]"),
        contacts=signals("wall [N s]"), h=0.1, mass=p["m"], impulse=lambda q, v, u: u,
        distance=lambda q: q, parameters=p)
    return Problem(name=name, system=system, N=params.N, stage_cost=ca.sumsqr(system.u),
                   terminal_cost=ca.sumsqr(system.x), x0=ca.SX([1, 0]), parameters=p)
"""


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("title =", "title ==", ["line 8", "NameError"]),
        ("def build(params):", "def build(params:", ["SyntaxError"]),
        ('name = "mine"', "1 / 0", ["ZeroDivisionError", "line 7"]),
        ("def build", "def construct", ["build is missing"]),
        ("x0=ca.SX([1, 0])", "x0=ca.SX([1, 0, 0])", ["x0 has 3 entries, expected 2"]),
        ("stage_cost=ca.sumsqr(system.u)", 'stage_cost=ca.SX.sym("w")', ["uses w"]),
        ("    return Problem", "    Problem", ["returned", "expected"]),
        ("h=0.1", 'h=p["hh"]', ["hh"]),
        ("h=0.1", "h=0", ["h must be positive, got 0"]),
        ('1.0, "kg", "mass", above=0', '-1.0, "kg", "mass"', ["positive definite", "is -1;"]),
        ('1.0, "kg", "mass", above=0', '0.0, "kg", "mass"', ["positive definite", "is 0;"]),
    ],
)
def test_a_users_file_that_does_not_work(ocp, tmp_path: Path, old: str, new: str, words: list[str]) -> None:
    assert old in USER_FILE
    (tmp_path / "mine.py").write_text(USER_FILE.replace(old, new))
    done = ocp("solve", "mine.py")
    assert done.code == 2
    assert len(done.err.strip().splitlines()) <= 2
    for word in ["mine", *words]:
        assert word in done.err


@pytest.mark.parametrize(
    "words",
    [
        ["continue", "mine.py", "--over", "m", "--from", "1", "--to", "-1"],
        ["estimate", "mine.py", "--sweep", "m=1:-1:3"],
        ["collect", "mine.py", "-p", "m=-1", "--samples", "10", "-o", "data.nc"],
        ["export", "mine.py", "-p", "m=-1", "-o", "mine.c"],
    ],
)
def test_a_mass_that_is_none_is_refused_at_every_door(ocp, tmp_path: Path, words) -> None:
    (tmp_path / "mine.py").write_text(USER_FILE.replace(', "mass", above=0', ', "mass"'))
    done = ocp(*words)
    assert done.code == 2 and "mass matrix must be positive definite" in done.err
    assert not (tmp_path / "data.nc").exists() and not (tmp_path / "mine.c").exists()


@pytest.mark.costly
def test_a_users_file_that_works_is_found_again_by_its_run(ocp, tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(USER_FILE)
    solved = ocp("solve", "mine.py", "-p", "m=2", "--json")
    assert solved.code == 0
    assert solved.json["params"] == {"m": 2.0, "N": 5}
    replayed = ocp("replay", solved.json["run"], "--source", "mine.py", "--json")
    assert replayed.json["cost"] == pytest.approx(solved.json["exact_cost"], rel=1e-9)
    (tmp_path / "mine.py").unlink()
    assert ocp("report", solved.json["run"], "-o", "mine.pdf").code == 0
    gone = ocp("replay", solved.json["run"], "--source", "mine.py")
    assert gone.code == 2
    assert "no such file" in gone.err


@pytest.mark.costly_cases("cut-replay", "cut-runs", "cut-report")
@pytest.mark.parametrize("command", ["replay", "runs", "report"])
@pytest.mark.parametrize("harm", ["cut", "missing", "not json", "schema", "part"])
def test_a_damaged_run(ocp, tmp_path: Path, store_of_runs: Path, command: str, harm: str) -> None:
    run = tmp_path / "damaged"
    shutil.copytree(next((store_of_runs / "push-1d").iterdir()), run)
    data, meta = run / "solution.nc", run / "meta.json"
    file = meta
    if harm == "cut":
        file = data
        data.write_bytes(data.read_bytes()[:-1])
    elif harm == "missing":
        file = data
        data.unlink()
    elif harm == "not json":
        meta.write_text("{")
    elif harm == "schema":
        reseal(run, having(schema=7))
    else:
        reseal(run, lacking("audit"))
    arguments = ["-o", "x.pdf"] if command == "report" else []
    done = ocp(command, str(run), *arguments)
    assert done.code == 4
    assert str(file) in done.err
    assert "Traceback" not in done.err
    assert not (tmp_path / "x.pdf").exists()
