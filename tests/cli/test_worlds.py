"""Plans and closed loops in MuJoCo from the command line."""

from __future__ import annotations

import pytest

from tests.cli.conftest import Ocp

SMALL = ("finger-disc", "-p", "N=3", "--contact", "barrier")


@pytest.mark.costly
def test_a_solve_and_a_replay_tell_the_same_of_mujoco(ocp: Ocp) -> None:
    solved = ocp("solve", *SMALL, "--world", "mujoco", "--json").json
    told = solved["world"]
    assert told["sentence"] in solved["verdict"].splitlines()
    assert told["world"] == "mujoco" and told["planned_cost"] == solved["cost"]
    low, high = told["band"]
    assert low <= told["cost"] <= high
    off = abs(told["cost"] - solved["cost"])
    assert told["keeps"] == (off <= 0.2 * solved["cost"])
    again = ocp("replay", "@last", "--world", "mujoco", "--json").json
    assert {**again, "sentence": told["sentence"]} == {"run": solved["run"], "problem": "finger-disc", **told}
    said = ocp("replay", "@last", "--world", "mujoco")
    assert said.code == 0 and said.out == f"{told['sentence']}\n"
    for line, named in (
        (("--contact", "barrier"), "--world excludes a contact law; drop --contact and -c"),
        (("-c", "mu=1"), "--world excludes a contact law"),
    ):
        done = ocp("replay", "@last", "--world", "mujoco", *line)
        assert done.code == 2 and named in done.err and done.err.count("\n") == 1
    unknown = ocp("replay", "@last", "--world", "mujuco")
    assert unknown.code == 2 and "unknown world 'mujuco' (did you mean 'mujoco'?)" in unknown.err


@pytest.mark.parametrize("line", [("solve", "push-disc", "--world"), ("mpc", "push-disc", "--plant")])
def test_what_is_no_machine_is_refused_before_it_is_solved(ocp: Ocp, line: tuple[str]) -> None:
    done = ocp(*line, "mujoco")
    assert done.code == 2 and done.err.count("\n") == 1
    assert "push-disc cannot be tried in MuJoCo: it is not built by the system() of a" in done.err


@pytest.mark.costly
def test_a_closed_loop_in_mujoco(ocp: Ocp) -> None:
    line = ("mpc", "finger-disc", "-p", "N=3", "--steps", "4", "--json")
    there, here = (ocp(*line, "--plant", plant).json for plant in ("mujoco", "exact"))
    assert there["status"] == "done" and there["record"]["plant"] == "mujoco"
    assert there["cost"] > 0 and there["cost"] != pytest.approx(here["cost"], rel=1e-6)
