"""Every study at small settings: data, drawing, and rules of the framework."""

from __future__ import annotations

import subprocess
import sys
import warnings

import numpy as np
import pytest
import xarray as xr
from matplotlib.text import Text

from ocp.errors import InputError
from problems import studies
from problems.studies.study import CHOICE, CODE, PAPER, claims_sentence
from reports.drawing.style import house_style, to_svg
from reports.figures.paper import BOTH_COLUMNS_IN, COLUMN_IN, render_figure
from reports.figures.studies import DRAWINGS
from tests.golden.figures.verdicts import SLOW, SMALL, small

PAPERS = ("suh2023noising", "suh2022pathologies", "zhang2023adaptive", "shirai2024linear")


@pytest.mark.cheap_cases("P2")
@pytest.mark.parametrize("identifier", [name for name in SMALL if name not in SLOW])
def test_data_carry_units_and_are_drawn(identifier: str) -> None:
    found = small(identifier)
    for name, variable in found.variables.items():
        assert variable.dtype.kind not in "fiu" or variable.attrs["units"], name
    with house_style(), warnings.catch_warnings():
        warnings.simplefilter("error")
        figure = DRAWINGS[identifier].draw(found)
        assert len(to_svg(figure)) > 10_000
        assert len(render_figure(figure, "pdf")) > 10_000
    assert figure.get_figwidth() in (COLUMN_IN, BOTH_COLUMNS_IN)
    sizes = [one.get_fontsize() for one in figure.findobj(Text) if one.get_text()]
    assert min(sizes) >= 7, "journals set no smaller type"
    assert all(axis.get_xlabel() for axis in figure.axes[-2:])
    units = {variable.attrs.get("units", "1") for variable in found.variables.values()}
    labels = "".join(axis.get_ylabel() + axis.get_xlabel() for axis in figure.axes)
    assert "[" in labels or units == {"1"}


def test_every_study_says_where_its_values_come_from() -> None:
    for identifier in studies.ids():
        study = studies.get(identifier)
        assert study.id == identifier
        assert study.citation.key in PAPERS
        for name, about in study.Params.model_fields.items():
            extra = about.json_schema_extra
            assert isinstance(extra, dict) and extra["origin"] in (PAPER, CODE, CHOICE), name


def test_every_study_has_its_drawing() -> None:
    assert list(DRAWINGS) == studies.ids()
    assert all(drawing.caption for drawing in DRAWINGS.values())


@pytest.mark.costly
def test_naming_the_studies_loads_none_of_them() -> None:
    code = (
        "import sys\nfrom problems import studies\n"
        "assert all(studies.get(name).title for name in studies.ids())\n"
        "print(*(m for m in sys.modules if m.startswith(('problems.studies.', 'matplotlib'))))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["problems.studies.study"]


@pytest.mark.costly
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
        claims_sentence([])


def test_a_variable_without_units_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    bare = xr.Dataset({"x": ("i", np.ones(3))})
    monkeypatch.setattr("problems.studies.barrier_relaxation.run", lambda _: bare)
    with pytest.raises(ValueError, match="x has no units"):
        studies.get("P6").data()
