"""Files of models and transitions with a right checksum and wrong content are refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from dynamics.learned.files import read_model
from dynamics.learned.mlp import MlpModel
from dynamics.learned.transitions import Normalisation
from ocp.errors import InputError
from ocp.store.models import load_any, save
from reports.cli.app import main
from reports.tables.learned_models import model_dataset, model_document
from tests.unit.dynamics.learned.ewda_reference import model_of, origin

Forgery = Callable[[xr.Dataset], xr.Dataset]


def network() -> MlpModel:
    rng = np.random.default_rng(0)
    ones = Normalisation(np.zeros(2), np.ones(2))
    return MlpModel(
        (rng.normal(size=(4, 3)), rng.normal(size=(2, 4))),
        (np.zeros(4), np.zeros(2)),
        Normalisation(np.zeros(3), np.ones(3)),
        ones,
        0.1,
        origin(3, 2),
    )


def good(kind: str) -> xr.Dataset:
    if kind == "mlp":
        return network().dataset()
    rng = np.random.default_rng(1)
    return model_of(rng.normal(size=(40, 3)), rng.normal(size=(40, 2)), 0.2).dataset()


def put(name: str, value: float) -> Forgery:
    def forge(dataset: xr.Dataset) -> xr.Dataset:
        values = dataset[name].values.copy()
        values.flat[0] = value
        return dataset.assign({name: (dataset[name].dims, values)})

    return forge


def say(**attributes: object) -> Forgery:
    return lambda dataset: dataset.assign_attrs(attributes)


BOTH: list[Forgery] = [
    put("z_scale", np.nan),
    put("z_scale", 1e300),
    put("z_scale", 0.0),
    put("z_scale", -1.0),
    put("z_shift", np.inf),
    say(parameters="[" * 100_000),
    say(parameters='{"m": ' * 5000),
    say(parameters="{"),
    say(parameters='{"m": {"a": 1}}'),
    say(problem=3),
    say(sigma=np.nan),
    say(sigma="0.2"),
    say(sigma=np.array([0.1, 0.2])),
    say(seed=0.5),
    say(data_hash=1),
    say(data_rows=7),
    say(schema="new"),
    lambda d: d.drop_vars("z_unit"),
    lambda d: d.drop_vars("z_scale"),
    lambda d: d.assign_coords(z=np.arange(d.sizes["z"])),
    lambda d: d.assign(z_shift=("state", np.zeros(d.sizes["state"]))),
    lambda d: d.assign(z_scale=("z", ["a"] * d.sizes["z"])),
]
EWDA = [
    put("z_data", 1e300),
    put("y_data", np.nan),
    say(sigma=0.0),
    say(sigma=1e300),
    lambda d: d.assign(y_data=d["y_data"].transpose()),
]
MLP = [
    put("weight_0", np.nan),
    put("bias_1", 1e300),
    put("y_scale", -1.0),
    say(activation="tanh"),
    say(layers=0),
    say(layers=-3),
    say(layers=10**12),
    say(layers=1),
    say(layers="two"),
    lambda d: d.assign(weight_1=d["weight_1"].transpose()),
    lambda d: d.drop_vars("bias_0"),
]
CASES = [*(("ewda", f) for f in (*BOTH, *EWDA)), *(("mlp", f) for f in (*BOTH, *MLP))]


@pytest.mark.parametrize("kind", ["ewda", "mlp"])
def test_what_was_written_is_read(kind: str, tmp_path: Path) -> None:
    save(good(kind), tmp_path / "m.nc")
    assert read_model(tmp_path / "m.nc").kind == kind


@pytest.mark.one_case_in(10)
@pytest.mark.parametrize(("kind", "forge"), CASES)
def test_a_forged_model_is_refused(kind: str, forge: Forgery, tmp_path: Path) -> None:
    path = tmp_path / "m.nc"
    save(forge(good(kind)), path)
    with pytest.raises(InputError, match=r"m\.nc"):
        load_any(path)


@pytest.mark.one_case_in(2)
@pytest.mark.parametrize("name", ["fit_clean", "fit_noised", "fit_outside", "fit_sigma"])
def test_negative_errors_of_a_fit_are_refused(name: str, tmp_path: Path) -> None:
    from dynamics.learned.fit import measure_fit
    from dynamics.learned.transitions import Transitions

    rng = np.random.default_rng(2)
    one = origin(3, 2)
    data = Transitions.from_arrays(
        rng.normal(size=(60, 2)), rng.normal(size=(60, 1)), rng.normal(size=(60, 2)), one.y, one.inputs
    )
    model = network()
    fitted = measure_fit(model, data.samples(), np.arange(5), 0.1)
    whole = model_dataset(model.dataset(), fitted.dataset(), data, 5)
    save(whole, tmp_path / "m.nc")
    found = load_any(tmp_path / "m.nc")
    assert isinstance(found, xr.Dataset) and model_document(found)["fit"]["sigma"] == 0.1
    save(put(name, -1.0)(whole), tmp_path / "m.nc")
    with pytest.raises(InputError, match=f"{name} holds errors below 0"):
        load_any(tmp_path / "m.nc")


def test_the_program_says_so_in_a_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "m.nc"
    save(put("z_scale", np.nan)(good("ewda")), path)
    for line in (f"show {path}", f"solve push-1d --contact ewda -c model={path}"):
        assert main(line.split()) == 2
        told = capsys.readouterr().err
        assert "Traceback" not in told and "z_scale holds numbers that are not finite" in told
