"""``ocp.estimate`` has the rules and the numbers of the command ``ocp estimate``."""

from __future__ import annotations

import json

import numpy as np
import pytest

import ocp
from ocp.errors import InputError
from reports.cli.app import main


@pytest.mark.parametrize(
    ("name", "params", "options"),
    [
        ("heaviside", {}, {}),
        ("push-1d", {"N": 5}, {"contact": "exact"}),
    ],
)
def test_python_and_the_command_line_estimate_the_same_numbers(
    name, params, options, tmp_path, capsys
):
    found = ocp.estimate(name, ["zobg"], 500, params=params, reference="none", **options)["zobg"]
    given = [word for key, value in params.items() for word in ("-p", f"{key}={value}")]
    given += [word for key, value in options.items() for word in (f"--{key}", value)]
    code = main(["estimate", name, *given, "--estimators", "zobg", "--samples", "500",
                 "--reference", "none", "--json", "--out", str(tmp_path)])  # fmt: skip
    row = json.loads(capsys.readouterr().out)["estimates"][0]
    assert not code
    np.testing.assert_array_equal(np.ravel(row["mean"]), found.mean)


def test_noise_that_rounding_hides_is_refused():
    with pytest.raises(InputError, match="rounding errors dominate"):
        ocp.estimate("heaviside", sigma=1e20)
