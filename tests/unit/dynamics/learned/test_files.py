"""Files of data and models are complete, the same to the last bit, or refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from dynamics.learned.ewda import EwdaModel
from dynamics.learned.mlp import MlpModel
from dynamics.learned.transitions import Normalisation, Transitions
from dynamics.systems import signals
from ocp.errors import InputError
from ocp.store import models


def transitions() -> Transitions:
    x, u = np.random.default_rng(0).standard_normal((2, 40, 1))
    return Transitions.from_arrays(x, u, x + u, signals("x [m]"), signals("u [N]"), {"problem": "own"})


def ewda() -> EwdaModel:
    data = transitions()
    return EwdaModel(data.z, data.x_next, data.normalisation, 0.2, data.origin, 3)


def mlp() -> MlpModel:
    rng = np.random.default_rng(1)
    scales = Normalisation(np.zeros(1), np.ones(1))
    weights = rng.standard_normal((4, 2)), rng.standard_normal((1, 4))
    biases = rng.standard_normal(4), rng.standard_normal(1)
    data = transitions()
    return MlpModel(weights, biases, data.normalisation, scales, 0.2, data.origin, 3)


MAKERS = {"transitions": transitions, "ewda": ewda, "mlp": mlp}


@pytest.fixture(params=MAKERS)
def file(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    path = tmp_path / f"{request.param}.nc"
    models.save(MAKERS[request.param]().dataset(), path)
    return path


def test_what_is_written_is_read_back(file: Path) -> None:
    made = MAKERS[file.stem]()
    if isinstance(made, Transitions):
        assert models.load_transitions(file).hash == made.hash
        return
    again = models.load_model(file)
    assert type(again) is type(made) and again.origin == made.origin
    z = transitions().z[:7]
    for one, other in zip(again.jacobians(z), made.jacobians(z), strict=True):
        assert np.array_equal(one, other)
    assert again.kind == file.stem
    assert (again.origin.y, again.origin.inputs) == (signals("x [m]"), signals("u [N]"))
    assert again.origin.data_hash == transitions().hash


def test_the_same_is_the_same_file_to_the_last_bit(file: Path, tmp_path: Path) -> None:
    """Only the time at which HDF5 created the root group, and the checksum of that header, may differ."""
    again = tmp_path / "again.nc"
    models.save(MAKERS[file.stem]().dataset(), again)
    first, second = (np.frombuffer(path.read_bytes(), np.uint8) for path in (file, again))
    assert len(first) == len(second)
    (differing,) = np.nonzero(first != second)
    header = file.read_bytes().index(b"OHDR")
    times = range(header + 6, header + 22)
    assert set(differing) - set(times) <= set(range(header, header + 1024)) and len(differing) <= 20


def test_a_file_cut_short_or_changed_is_told(file: Path) -> None:
    content = file.read_bytes()
    # Zeros follow the numbers; a file without them is complete.
    size = len(content.rstrip(b"\0"))
    for share in (0.5, 0.9, 0.99):
        file.write_bytes(content[: int(share * size)])
        with pytest.raises(InputError, match="truncated or"):
            models.load_any(file)
    # One bit of the numbers changes, which netCDF itself does not detect.
    place = (
        content.index(np.float64(transitions().x[0, 0]).tobytes())
        if file.stem != "mlp"
        else (content.index(np.float64(mlp().weights[0][0, 0]).tobytes()))
    )
    file.write_bytes(content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :])
    with pytest.raises(InputError, match="does not match its checksum: truncated or changed"):
        models.load_any(file)


def test_files_of_something_else_are_told(file: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.nc"
    with pytest.raises(InputError, match="file not found; ocp collect writes data"):
        models.load_any(other)
    with pytest.raises(InputError, match="is a directory"):
        models.load_any(tmp_path)
    other.write_text("x,u\n1,2\n")
    with pytest.raises(InputError, match="is not a netCDF file"):
        models.load_any(other)
    xr.Dataset({"a": 1.0}).to_netcdf(other)
    with pytest.raises(InputError, match="this program: its kind is None, expected"):
        models.load_any(other)
    if file.stem == "transitions":
        with pytest.raises(InputError, match="holds transitions, not a model; learn one"):
            models.load_model(file)
    else:
        with pytest.raises(InputError, match=f"a model of kind {file.stem}, not transitions"):
            models.load_transitions(file)


def test_another_schema_is_told(file: Path) -> None:
    dataset = MAKERS[file.stem]().dataset().assign_attrs(schema=99)
    models.save(dataset, file)
    read = models.load_transitions if file.stem == "transitions" else models.load_model
    with pytest.raises(InputError, match=r"schema .*99, this .*reads 1"):
        read(file)


def test_a_model_that_lacks_a_part_is_told(file: Path) -> None:
    dataset = MAKERS[file.stem]().dataset().drop_vars("z_scale")
    models.save(dataset, file)
    read = models.load_transitions if file.stem == "transitions" else models.load_model
    with pytest.raises(InputError, match=r"lacks? z_scale"):
        read(file)


def test_a_place_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot write the file"):
        models.save(transitions().dataset(), tmp_path / "file" / "data.nc")
