"""``ocp settings`` lists everything that can be set, as declared."""

from __future__ import annotations

import inspect
import math
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np
import pytest

from dynamics.laws import LAWS
from dynamics.settings import Configured, setting, settings_of
from ocp.errors import InputError
from ocp.learning.psi_learning import PsiLearning
from ocp.learning.training import ALGORITHMS
from ocp.problem.policy import POLICIES
from ocp.programs.options import documented
from ocp.programs.solver import IPOPT_DEFAULTS
from ocp.routes.relaxations import STRATEGIES
from ocp.search.random_search import RandomSearch
from ocp.solve.request import SOLVE_SETTINGS, Settings
from ocp.transcription import METHODS
from reports.tables.settings import SettingRow, setting_rows, training_groups

if TYPE_CHECKING:
    from ocp.problem.problem import Problem


class Made:
    """Class with declared arguments, a plain one, and one whose type only checkers know."""

    def __init__(
        self,
        size: Annotated[float, "of it [m]"] = 0.5,
        names: Annotated[tuple[int, ...] | None, "numbers"] = None,
        plain: int = 3,
        other: Problem | None = None,
    ) -> None: ...


def test_an_argument_with_a_meaning_has_name_kind_default_range_and_meaning() -> None:
    assert setting_rows(Made) == [
        SettingRow("size", "number", 0.5, "of it [m]", range="number"),
        SettingRow("names", "whole numbers", None, "numbers", range="whole numbers"),
    ]


@dataclass(frozen=True)
class Declared(Configured):
    """Dataclass with declared settings."""

    name: ClassVar[str] = "made"
    width: float = setting(0.5, "width of it", "m", above=0, most=2, hint="it is narrow")
    count: int | None = setting(None, "how many", least=1)
    scheme: str = setting("fine", "how", words=("fine", "coarse"))


def test_a_declared_setting_is_listed_parsed_and_checked_by_its_declaration() -> None:
    assert setting_rows(Declared) == [
        SettingRow("width", "number", 0.5, "width of it", "m", "number > 0 and <= 2 [m]"),
        SettingRow("count", "whole number", None, "how many", range="whole number >= 1"),
        SettingRow("scheme", "word", "fine", "how", range="'fine' or 'coarse'"),
    ]
    made = Declared(width=np.float64(1), count="2e1", scheme="coarse")  # pyright: ignore[reportArgumentType]
    assert (made.width, made.count, made.scheme) == (1.0, 20, "coarse")
    assert type(made.width) is float and type(made.count) is int


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"width": 0}, "made: width must be a number > 0 and <= 2 [m], got 0; it is narrow"),
        ({"width": math.nan}, "made: width must be a finite number > 0 and <= 2 [m], got nan; it is narrow"),
        ({"count": 1.5}, "made: count must be a whole number >= 1, got 1.5"),
        ({"count": True}, "made: count must be a whole number >= 1, got True"),
        ({"scheme": "corse"}, "made: scheme must be 'fine' or 'coarse', got 'corse' (did you mean 'coarse'?)"),
    ],
)
def test_a_value_out_of_range_is_refused_with_what_was_expected(values: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as raised:
        Declared(**values)
    assert str(raised.value) == message


@pytest.mark.parametrize("name", LAWS)
def test_every_setting_of_a_law_is_declared_and_told(ocp, name: str) -> None:
    takes = inspect.signature(LAWS[name]).parameters
    told = ocp("settings", name, "--json").json["settings"][0]
    assert [one["name"] for one in told["settings"]] == list(takes)
    for one in told["settings"]:
        default = takes[one["name"]].default
        assert one["default"] == default and one["meaning"] and one["kind"]
    text = ocp("settings", name).out
    assert all(f"\n  {key}" in text for key in takes)


def test_every_class_of_settings_declares_all_of_them() -> None:
    for cls in (*ALGORITHMS.values(), *POLICIES.values()):
        assert [*settings_of(cls)] == [each.name for each in fields(cls) if each.init]
    of_psi = {name for cls in (PsiLearning, RandomSearch) for name in settings_of(cls)}
    told = next(group for group in training_groups() if group.name == "psi").settings
    assert {one.name for one in told} == of_psi - {"algorithm", "names", "search"}
    assert set(SOLVE_SETTINGS) == {field.name for field in fields(Settings)} - {"options"}


def test_settings_tells_all_of_them(ocp) -> None:
    told = {group["name"]: group for group in ocp("settings", "--json").json["settings"]}
    assert {*LAWS, *POLICIES, *ALGORITHMS, "solve", "train", "alpha", "ipopt"} <= set(told)
    assert [one["name"] for one in told["solve"]["settings"]] == list(SOLVE_SETTINGS)
    of_ipopt = {one["name"]: one["default"] for one in told["ipopt"]["settings"]}
    assert of_ipopt.items() <= IPOPT_DEFAULTS.items()
    lines = ocp("settings").out.splitlines()
    assert max(map(len, lines)) <= 80
    assert "  jit=false (true or false): evaluate by compiled C, cached, where a compiler is" in lines


def test_a_solvers_options_are_those_it_documents(ocp) -> None:
    told = ocp("settings", "ipopt", "--json").json["settings"][0]["settings"]
    assert {one["name"] for one in told} == set(documented("ipopt"))
    tol, scale = (next(o for o in told if o["name"] == name) for name in ("tol", "s_max"))
    assert tol["default"] == IPOPT_DEFAULTS["tol"], "as it is set here"
    assert scale["default"] == "100" and scale["meaning"] == "Scaling threshold for the NLP error."


def test_a_setting_is_found_by_its_name(ocp) -> None:
    told = ocp("settings", "policy.penalty", "--json").json["settings"]
    assert [(group["name"], [one["name"] for one in group["settings"]]) for group in told] == [
        ("feedback", ["penalty"])
    ]
    several = ocp("settings", "sigma", "--json").json["settings"]
    assert {"adaptive", "randomized", "fopg", "total-propagation"} <= {group["name"] for group in several}


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["settings", "fobg"], ["did you mean 'fopg'", "randomized"]),
        (["settings", "barier"], ["did you mean 'barrier'", "exact"]),
        (
            ["solve", "wall-1d", "--contact", "barrier", "-s", "homotpy=true"],
            ["did you mean 'homotopy'", "ocp settings"],
        ),
        (
            ["solve", "wall-1d", "--contact", "barrier", "-s", "toll=1"],
            ["did you mean 'tol'", "strategy", "jit"],
        ),
        (
            ["solve", "wall-1d", "--contact", "barrier", "-c", "nu=1"],
            ["mu, kappa", "ocp settings barrier"],
        ),
    ],
)
def test_what_is_unknown_is_told_what_there_is(ocp, arguments: list[str], told: list[str]) -> None:
    done = ocp(*arguments)
    assert done.code == 2
    assert all(part in done.err for part in told), done.err


def test_a_kind_lists_all_its_groups(ocp) -> None:
    def names(kind: str) -> list[str]:
        return [group["name"] for group in ocp("settings", kind, "--json").json["settings"]]

    assert names("laws") == list(LAWS)
    assert names("methods") == ["methods", "solve", "strategies", *POLICIES]
    told = {group["name"]: group for group in ocp("settings", "methods", "--json").json["settings"]}
    assert [one["name"] for one in told["methods"]["settings"]] == list(METHODS)
    assert "feedback (-s policy.NAME=VALUE)" in ocp("settings", "methods").out


def test_every_strategy_says_what_it_is_for(ocp) -> None:
    told = ocp("settings", "strategies", "--json").json["settings"][0]["settings"]
    assert [one["name"] for one in told] == list(STRATEGIES)
    assert all(one["meaning"] for one in told)


@pytest.mark.costly
def test_a_setting_may_be_called_without_its_prefix(ocp) -> None:
    path = ["--from", "1e-2", "--to", "1e-3", "--steps", "1", "--json", "--quiet"]
    short = ocp("continue", "wall-1d", "--contact", "barrier", "--over", "mu", *path).json
    assert short["over"] == "contact.mu"
    assert [point["complementarity"] for point in short["points"]] == pytest.approx([1e-2, 1e-3])


@pytest.mark.parametrize(("problem", "name"), [("wall-1d", "N"), ("push-disc", "scenarios")])
def test_what_shapes_the_program_is_told_another_way(ocp, problem: str, name: str) -> None:
    done = ocp("continue", problem, "--over", name, "--from", "5", "--to", "9")
    assert done.code == 2
    assert f"-p {name}=" in done.err and "ocp sweep" in done.err
