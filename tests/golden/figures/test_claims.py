"""Verdicts of all claims are as listed, computed from data, and the same over seeds and settings."""

from __future__ import annotations

import ast
import re
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import problems.studies
from problems import studies
from problems.studies.start_without_contact.claims import open_loop
from problems.studies.start_without_contact.data import LAWS, PROBLEMS
from problems.studies.study import WITHIN_NOISE, Claim, claim, claim_verdict, largest_value, settings_text
from tests.golden.figures.verdicts import SLOW, SMALL, VERDICTS, small

FILES = sorted(Path(problems.studies.__path__[0]).rglob("*.py"))
CONDITIONS = {"holds", "below", "at_most", "above", "at_least", "between", "equals"}
BUILTINS = {"bool", "np", "abs", "all", "any", "min", "max", "float", "int"}
FLIPPED = [
    # Settings at which verdicts once changed.
    ("A1", {"sigma": 0.3}),
    ("P5", {"seed": 2}),
    ("A6", {"h": 0.005}),
]
VARIED = [
    *FLIPPED,
    *(
        pytest.param(*case, marks=pytest.mark.slow)
        for case in [
            ("A1", {"sigma": 0.01, "F": 100.0}),
            ("A2v", {"seed": 1}),
            ("A2v", {"seed": 2}),
            ("A6", {"seed": 1}),
            ("A6", {"seed": 2, "sigma": 0.1, "sigma_box": 0.2}),
            ("P1", {"seed": 1}),
            ("P1", {"seed": 2}),
            ("P2", {"seed": 1}),
            ("P2", {"seed": 2, "sigma": 0.5}),
            ("P3", {"seed": 1}),
            ("P3", {"seed": 2, "sigma": 0.01, "theta": 0.01, "nu": 0.0005}),
            ("P3", {"seed": 3, "sigma": 1.0}),
            ("P4", {"seed": 1}),
            ("P4", {"seed": 2}),
            ("P5", {"seed": 7, "c": 0.1}),
            ("P6", {"seed": 1, "m": 3.0, "h": 0.01}),
            ("P7", {"seed": 1}),
            ("P7", {"seed": 2}),
        ]
    ),
]


def marked(identifier: str) -> object:
    return pytest.param(identifier, marks=pytest.mark.slow) if identifier in SLOW else identifier


def verdicts(identifier: str, **changed: float) -> dict[str, bool]:
    """Return a mapping from claim to whether it holds, for a study's claims that are not within noise."""
    study = studies.get(identifier)
    data = study.data({**SMALL[identifier], **changed}) if changed else small(identifier)
    found = study.claims(data)
    assert all(isinstance(claim.holds, bool | np.bool_) for claim in found)
    assert all(claim.source and claim.expected and claim.measured for claim in found)
    assert [claim.claim for claim in found] == list(VERDICTS[identifier])
    return {
        claim.claim: bool(claim.holds) for claim in found if claim_verdict(claim.holds, claim.margin) != WITHIN_NOISE
    }


def assert_same(found: dict[str, bool], identifier: str) -> None:
    """Check that all verdicts beyond noise are as listed, and that most claims are beyond it."""
    assert found == {claim: VERDICTS[identifier][claim] for claim in found}
    assert len(found) >= len(VERDICTS[identifier]) / 2


def by_name(claims: list[Claim]) -> dict[str, Claim]:
    return {claim.claim: claim for claim in claims}


def test_every_study_is_listed() -> None:
    assert list(VERDICTS) == list(SMALL) == studies.ids()


@pytest.mark.one_case_in(8)
@pytest.mark.parametrize("identifier", [marked(name) for name in SMALL])
def test_which_claims_hold(identifier: str) -> None:
    assert_same(verdicts(identifier), identifier)


@pytest.mark.costly_cases("A1-changed0", "A6-changed2")
@pytest.mark.parametrize(("identifier", "changed"), VARIED)
def test_seeds_and_settings_flip_no_verdict(identifier: str, changed: dict[str, float]) -> None:
    assert_same(verdicts(identifier, **changed), identifier)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_seeds_flip_no_verdict_on_the_theory(seed: int) -> None:
    assert_same(verdicts("T1", seed=seed), "T1")


@pytest.mark.slow
@pytest.mark.parametrize("identifier", ["N0", "N1"])
def test_seeds_flip_no_verdict_on_noised_data(identifier: str) -> None:
    assert_same(verdicts(identifier, seed=1), identifier)


def statements() -> Iterator[tuple[str, dict[str, ast.Call]]]:
    """Yield the place of every claim in the code, and a mapping from name to call in its chain."""
    for file in FILES:
        seen: set[ast.Call] = set()
        for node in ast.walk(ast.parse(file.read_text())):
            call, chain = node, dict[str, ast.Call]()
            while isinstance(call, ast.Call) and call not in seen and isinstance(call.func, ast.Attribute):
                chain[call.func.attr] = call
                call = call.func.value
            if chain and isinstance(call, ast.Call) and getattr(call.func, "id", "") == "claim":
                seen |= {call, *chain.values()}
                yield f"{file.name}:{call.lineno}", chain


def computed(expression: ast.expr) -> bool:
    """Return whether an expression depends on anything that is not constant."""
    names = {node.id for node in ast.walk(expression) if isinstance(node, ast.Name)}
    return bool(names - BUILTINS)


def written(expression: ast.expr) -> str:
    """Return the literal text in an expression, without format specifications, indices and the unit 1/s."""
    typed: list[str] = []

    def visit(node: ast.AST) -> None:
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            typed.append(node.value.replace(" 1/s", ""))
        called = isinstance(node, ast.Call) and getattr(node.func, "attr", "") != "join"
        if not called and not isinstance(node, ast.FormattedValue | ast.Subscript):
            for child in ast.iter_child_nodes(node):
                visit(child)

    visit(expression)
    return "".join(typed)


@pytest.mark.costly
def test_no_verdict_and_no_measured_number_is_typed() -> None:
    chains = list(statements())
    assert len(chains) > 200
    for place, chain in chains:
        condition, *words = chain
        assert condition in CONDITIONS and words == ["measured", "expected"], place
        assert any(computed(value) for value in chain[condition].args), f"{place}: the verdict is typed in"
        observation = chain["measured"].args[0]
        assert computed(observation), f"{place}: what was measured is typed in"
        assert not re.search("[0-9]", written(observation)), f"{place}: a typed number"


def test_the_static_check_sees_typed_verdicts() -> None:
    def parsed(text: str) -> ast.expr:
        return ast.parse(text, mode="eval").body

    for text in ("False", "not True", "bool(1)", "bool(np.all([1, 2]))"):
        assert not computed(parsed(text))
    assert computed(parsed("bool(np.all(x < 1))"))
    assert written(parsed('f"{x:.2f} of {y[0]}: twice that"')) == " of : twice that"
    assert "2" in written(parsed('"off by 2 " + f"{x}"'))


@pytest.mark.cheap_cases("P5")
@pytest.mark.parametrize("identifier", [name for name in SMALL if name not in {*SLOW, "T1"}])
def test_nothing_holds_where_nothing_was_measured(identifier: str) -> None:
    study = studies.get(identifier)
    data = small(identifier)
    blank = data.map(lambda v: v * np.nan if v.dtype.kind in "fiu" else v, keep_attrs=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = study.claims(blank.assign_attrs(data.attrs))
    assert not [claim.claim for claim in found if claim.holds]


@pytest.mark.costly
def test_once_typed_verdicts_follow_the_data() -> None:
    heaviside = studies.get("P2")
    data = small("P2")
    broken = data.assign(fobg_mean=data["fobg_mean"] + 1, delta=0 * data["delta"])
    found = by_name(heaviside.claims(broken))
    assert found["The law of large numbers does not hold for the first order"].holds
    assert found["E delta(theta + w) = 0"].holds

    coulomb = studies.get("P3")
    data = small("P3")
    c = 1 / (np.sqrt(2 * np.pi) * data.attrs["sigma"])
    found = by_name(coulomb.claims(data.assign(half_gradient=0 * data["half_gradient"] + c)))
    assert found["At theta = nu/2 the gradient is c = 1/(sqrt(2 pi) sigma)"].holds
    often = {"half_chance": 0 * data["half_chance"] + 0.9, "half_share": 0.9}
    found = by_name(coulomb.claims(data.assign(often)))
    for sentence in (
        "There the sample gradient is zero with probability at least c nu",
        "It is zero with probability at least 1 - c nu",
        "The FoBG has (c nu, c, 0)-empirical bias",
    ):
        assert not found[sentence].holds


def planned(dearer: float) -> xr.Dataset:
    """Return data of study N2 in which every replay keeps half of the gain and costs ``dearer`` more in total."""
    shape = (len(PROBLEMS), len(LAWS))
    both = ("problem", "law")
    cost = np.broadcast_to([100.0, 10.0, 55.0], (*shape, 3)).copy()
    cost[:, 0] = 100.0
    status = np.full(shape, "solved", dtype="<U16")
    status[:, 0] = "no-progress"
    total = np.broadcast_to([50.0, 50.0 * (1 + dearer)], (*shape, 2))
    return xr.Dataset(
        {"cost": ((*both, "of"), cost), "total": ((*both, "motion"), total), "status": (both, status)},
        {"problem": list(PROBLEMS), "law": list(LAWS), "of": ["at rest", "plan", "exact replay"]},
    )


@pytest.mark.parametrize(("dearer", "survives"), [(0.05, True), (0.2, False), (-0.3, True), (np.nan, False)])
def test_a_plan_survives_by_its_whole_cost(dearer: float, survives: bool) -> None:
    data = planned(dearer)
    found = [claim for name in PROBLEMS for claim in open_loop(name, data.sel(problem=name))]
    told = [claim for claim in found if claim.claim.endswith("the plan keeps its cost under the exact law")]
    assert [bool(claim.holds) for claim in told] == [survives] * len(PROBLEMS)
    assert all(claim.holds for claim in found if claim not in told)


def test_conditions_hold_for_every_entry_and_not_of_nothing() -> None:
    statement = claim("so", "there").expected("1").measured("2")
    holding = [
        statement.below([1, 2], 3),
        statement.at_most(3, 3),
        statement.above([4, 5], [3, 4]),
        statement.at_least(3, 3),
        statement.between([1, 2], 0, 3),
        statement.equals("a", "a"),
        statement.equals([1.05, 0.95], 1, within=0.06),
        statement.holds([True, True], True, margin=4.0),
    ]
    failing = [
        statement.below([1, 3], 3),
        statement.above(np.nan, 0),
        statement.at_least([], 0),
        statement.between([0, 1], 0, 3),
        statement.equals([1, 2], 1),
        statement.equals([1.0, np.nan], 1, within=0.1),
        statement.holds([True, False]),
    ]
    assert all(made.holds is True for made in holding) and all(made.holds is False for made in failing)
    assert holding[-1] == Claim("so", "there", "1", "2", True, 4.0)


def test_words_for_a_range() -> None:
    assert settings_text([1, 0.5], [True, True]) == "for all of 1, 0.5"
    assert settings_text([1, 0.5], [False, False]) == "for none of 1, 0.5"
    assert settings_text(["a", "b", "c"], [True, False, True]) == "for a, c, not for b"
    assert largest_value([1.0, 3.0]) == 3
    assert np.isnan(largest_value([]))
