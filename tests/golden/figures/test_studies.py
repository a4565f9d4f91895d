"""Every study at small settings: which of its papers' claims hold, and the framework's rules."""

from __future__ import annotations

import importlib
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

from ocp.errors import InputError
from problems import studies
from problems.studies.study import CHOICE, CODE, PAPER, did_hold
from reports.style import styled, to_svg

SMALL: dict[str, dict[str, float]] = {
    "P1": {"points": 81, "n_samples": 500},
    "P4": {"points": 31, "n_samples": 500},
    "P5": {"points": 12, "n_samples": 200},
    "P6": {},
    "A1": {},
    "A2": {},
    "A2v": {"n_samples": 300},
    "A6": {},
    "T1": {"draws": 60, "sweep": 8, "pairs": 20, "n_samples": 5000},
}
FALSE: dict[str, set[str]] = {
    "P4": {
        "The stiffness still results in high variance",
        "The dome results in high empirical bias",
    },
    "A1": {
        "The noise has density rho = S_mu''(w)",
        "The noise of constant mu has a variance",
        "BS is RS for any mu(z)",
        "kappa as printed is the Gaussian-smoothed solution",
        "K*, W* of the least absolute residual are S_mu and its gradient",
    },
    "A2": {"Solving (C.1) gives the behaviour of the LCS, which does not bounce"},
    "A2v": {"That variance grows without bound as mu falls"},
    "A6": {"So does the adaptive law's"},
    "T1": {
        "The Lipschitz constant is at least inversely proportional to mu",
        "The slope is within the bound with l(mu) as printed",
        "The same with the sign of (A.32) right",
        "The same with l = |diag(lam)|²/mu at the point",
        "The slope away from contact is within the bound",
        "There lam_i <= mu/z_i",
        "dlam/dz couples no contacts",
        "The density of that noise is S_mu''",
        "kappa as printed is E S_0(z + w), w Gaussian",
        "With L_f = L_pi = 1 the variance grows as a polynomial of H",
    },
}
"""Claims that do not hold, each for a reason in the errata; all others do."""


@pytest.fixture(scope="module")
def data() -> dict[str, xr.Dataset]:
    return {}


@pytest.mark.parametrize("identifier", SMALL)
def test_which_claims_hold(identifier: str, data: dict[str, xr.Dataset]) -> None:
    study = studies.get(identifier)
    data[identifier] = study.data(SMALL[identifier])
    claims = study.claims(data[identifier])
    assert {claim.claim for claim in claims if not claim.holds} == FALSE.get(identifier, set())
    assert all(claim.source and claim.expected and claim.measured for claim in claims)
    assert len({claim.claim for claim in claims}) == len(claims)


@pytest.mark.parametrize("identifier", SMALL)
def test_data_carry_units_and_are_drawn(identifier: str, data: dict[str, xr.Dataset]) -> None:
    found = data.get(identifier)
    if found is None:
        found = studies.get(identifier).data(SMALL[identifier])
    for name, variable in found.variables.items():
        assert variable.dtype.kind not in "fiu" or variable.attrs["units"], name
    drawing = importlib.import_module(f"reports.figures.{identifier.lower()}")
    with styled():
        figure = drawing.draw(found)
        assert len(to_svg(figure)) > 10_000
    assert all(axis.get_xlabel() for axis in figure.axes[-2:])
    assert any("[" in axis.get_ylabel() + axis.get_xlabel() for axis in figure.axes)


def test_every_study_says_where_its_values_come_from() -> None:
    for identifier in studies.ids():
        study = studies.get(identifier)
        assert study.id == identifier
        assert study.citation.key in ("suh2023noising", "suh2022pathologies", "zhang2023adaptive")
        for name, about in study.Params.model_fields.items():
            extra = about.json_schema_extra
            assert isinstance(extra, dict) and extra["origin"] in (PAPER, CODE, CHOICE), name


def test_same_seed_same_data_another_seed_other_data() -> None:
    study = studies.get("P1")
    small = {"points": 20, "n_samples": 50}
    first, again, other = (study.data({**small, "seed": seed}) for seed in (3, 3, 4))
    assert first.identical(again)
    assert not np.array_equal(first["zeroth_throw"], other["zeroth_throw"])
    assert np.array_equal(first["slope_throw"], other["slope_throw"])


def test_bad_input_is_told() -> None:
    with pytest.raises(InputError, match=r"unknown figure 'A9'.*there are"):
        studies.get("A9")
    with pytest.raises(InputError, match=r"unknown parameter 'sigm' \(did you mean 'sigma'\?\)"):
        studies.get("A1").data({"sigm": 1})
    with pytest.raises(InputError, match=r"sigma .* must be a number > 0 \[m\], got -1"):
        studies.get("A1").data({"sigma": -1})
    with pytest.raises(InputError, match="without claims"):
        did_hold([])


def test_a_variable_without_units_is_refused() -> None:
    bare = replace(studies.get("P6"), run=lambda _: xr.Dataset({"x": ("i", np.ones(3))}))
    with pytest.raises(ValueError, match="x has no units"):
        bare.data()
