"""Networks: NumPy agrees with Equinox and with differences; files of networks."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import casadi as ca
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr

from dynamics.contact.learned_step import CasadiMap
from dynamics.learned.mlp import QUERIES_PER_BLOCK, MlpModel
from dynamics.learned.training import evaluate_network
from dynamics.learned.transitions import DataOrigin, Normalisation, Samples
from dynamics.systems.parameters import Signal

LINE = DataOrigin((Signal("q", "m"),), (Signal("q", "m"),))
PUSH = DataOrigin(
    (Signal("q", "m"), Signal("turn", "rad"), Signal("u", "m")),
    (Signal("q", "m"), Signal("turn", "rad")),
    "planar-push",
    {"h": 0.1, "law": "exact"},
    "0123",
)


def a_model(hidden: tuple[int, ...] = (16, 24, 16), seed: int = 0) -> MlpModel:
    """Return a network with random weights and scales, whose sizes are all different."""
    rng = np.random.default_rng(seed)
    sizes = (3, *hidden, 2)
    weights = tuple(rng.normal(size=(m, n)) / np.sqrt(n) for n, m in pairwise(sizes))
    biases = tuple(0.3 * rng.normal(size=m) for m in sizes[1:])
    scales = [Normalisation(rng.normal(size=n), rng.uniform(0.5, 2.0, n)) for n in (3, 2)]
    return MlpModel(weights, biases, *scales, 0.2, PUSH, 7)


def in_equinox(model: MlpModel, dtype: type):
    """Return the network built from Equinox's layers, a function from physical z (n_in,) to physical y."""
    layers = []
    for W, b in zip(model.weights, model.biases, strict=True):
        blank = eqx.nn.Linear(*W.T.shape, key=jax.random.key(0))
        parts = jnp.asarray(W, dtype), jnp.asarray(b, dtype)
        layers.append(eqx.tree_at(lambda layer: (layer.weight, layer.bias), blank, parts))

    def physical(z):
        scaled = (z - model.z_scales.shift.astype(dtype)) / model.z_scales.scale.astype(dtype)
        y = evaluate_network(layers, scaled)
        return model.y_scales.shift.astype(dtype) + model.y_scales.scale.astype(dtype) * y

    return physical


def pushed(n: int, seed: int = 0) -> Samples:
    """Draw n samples without noise of a map with a kink."""
    z = np.random.default_rng(seed).uniform(-1.0, 1.0, (n, 3))
    y = np.stack([z[:, 0] + np.maximum(z[:, 2] - z[:, 0], 0.0), z[:, 1] * z[:, 2]], axis=1)
    return Samples(z, y, PUSH)


def same_weights(a: MlpModel, b: MlpModel) -> bool:
    pairs = zip((*a.weights, *a.biases), (*b.weights, *b.biases), strict=True)
    return all(np.array_equal(one, other) for one, other in pairs)


@pytest.mark.costly
def test_values_are_equinoxes() -> None:
    model, z = a_model(), np.random.default_rng(1).normal(size=(QUERIES_PER_BLOCK + 7, 3))
    in_float = jax.vmap(in_equinox(model, np.float32))(jnp.asarray(z, np.float32))
    assert np.abs(model.values(z) - in_float).max() < 1e-6 * np.abs(in_float).max()
    with jax.enable_x64(True):
        in_double = np.asarray(jax.vmap(in_equinox(model, np.float64))(jnp.asarray(z)))
    assert in_double.dtype == np.float64
    assert np.abs(model.values(z) - in_double).max() < 1e-13 * np.abs(in_double).max()


@pytest.mark.costly
def test_derivatives_are_jaxes_in_double() -> None:
    model, rng = a_model(), np.random.default_rng(2)
    z, weights = rng.normal(size=(QUERIES_PER_BLOCK + 7, 3)), rng.normal(size=(QUERIES_PER_BLOCK + 7, 2))
    with jax.enable_x64(True):
        network = in_equinox(model, np.float64)
        J = np.asarray(jax.vmap(jax.jacfwd(network))(jnp.asarray(z)))
        contracted = jax.vmap(jax.hessian(lambda z, w: w @ network(z)))
        H = np.asarray(contracted(jnp.asarray(z), jnp.asarray(weights)))
    values, jacobians = model.jacobians(z)
    np.testing.assert_allclose(values, model.values(z), rtol=0, atol=1e-13)
    np.testing.assert_allclose(jacobians, J, rtol=0, atol=1e-10)
    np.testing.assert_allclose(model.curvatures(z, weights), H, rtol=0, atol=1e-10)
    assert np.abs(H).max() > 0.1


def test_derivatives_are_differences() -> None:
    model, rng = a_model(), np.random.default_rng(3)
    z, weights, h = rng.normal(size=(20, 3)), rng.normal(size=(20, 2)), 1e-6
    ahead, behind = ([z + side * h * e for e in np.eye(3)] for side in (1, -1))
    slopes = [(model.values(a) - model.values(b)) / (2 * h) for a, b in zip(ahead, behind, strict=True)]
    _, jacobians = model.jacobians(z)
    np.testing.assert_allclose(jacobians, np.stack(slopes, axis=-1), rtol=0, atol=1e-5)
    bends = [
        np.einsum("ni,nij->nj", weights, model.jacobians(a)[1] - model.jacobians(b)[1]) / (2 * h)
        for a, b in zip(ahead, behind, strict=True)
    ]
    curvatures = model.curvatures(z, weights)
    np.testing.assert_allclose(curvatures, np.stack(bends, axis=-1), rtol=0, atol=1e-5)
    assert np.array_equal(curvatures, curvatures.swapaxes(1, 2))


@pytest.mark.costly
def test_in_a_graph_it_is_equinoxes_with_both_derivatives() -> None:
    """CasADi's function agrees with Equinox, and its first and second derivative with differences."""
    model, rng = a_model(), np.random.default_rng(5)
    points, weights, h = rng.normal(size=(4, 3)), rng.normal(size=2), 1e-5
    in_float = jax.vmap(in_equinox(model, np.float32))(jnp.asarray(points, np.float32))
    network, z = CasadiMap(model).values(), ca.MX.sym("z", 3)
    y = network(z)
    hessian, slope = ca.hessian(ca.dot(weights, y), z)
    derived = ca.Function("derived", [z], [y, ca.jacobian(y, z), slope, hessian])
    for at, wanted in zip(points, in_float, strict=True):
        value, J, _, H = (np.array(found) for found in derived(at))
        assert np.abs(value[:, 0] - wanted).max() < 1e-6 * np.abs(in_float).max()
        sides = [(derived(at + h * e), derived(at - h * e)) for e in np.eye(3)]
        for found, result in ((J, 0), (H, 2)):
            moved = [np.array(a[result] - b[result])[:, 0] / (2 * h) for a, b in sides]
            np.testing.assert_allclose(found, np.stack(moved, axis=1), rtol=0, atol=1e-5)


def test_a_single_layer_and_no_query() -> None:
    model = a_model((5,))
    for n in (0, 1):
        z = np.zeros((n, 3))
        assert model.values(z).shape == (n, 2)
        assert model.jacobians(z)[1].shape == (n, 2, 3)
        assert model.curvatures(z, np.ones((n, 2))).shape == (n, 3, 3)


@pytest.mark.filterwarnings("error")
def test_a_query_that_is_not_finite_spoils_no_other() -> None:
    model, rng = a_model(), np.random.default_rng(4)
    z, weights = rng.normal(size=(QUERIES_PER_BLOCK, 3)), rng.normal(size=(QUERIES_PER_BLOCK, 2))
    spoiled = z.copy()
    spoiled[5, 1], spoiled[6], spoiled[7, 0] = np.nan, 1e308, np.inf
    kept = np.setdiff1d(np.arange(QUERIES_PER_BLOCK), [5, 6, 7])
    y, J, H = model.values(spoiled), model.jacobians(spoiled)[1], model.curvatures(spoiled, weights)
    assert np.isnan(y[5]).all() and np.isnan(J[5]).all() and not np.isfinite(y[7]).any()
    assert np.array_equal(y[kept], model.values(z)[kept])
    assert np.array_equal(J[kept], model.jacobians(z)[1][kept])
    assert np.array_equal(H[kept], model.curvatures(z, weights)[kept])


def test_a_model_comes_back_from_its_file(tmp_path: Path) -> None:
    model = a_model()
    model.dataset().to_netcdf(tmp_path / "model.nc")
    with xr.open_dataset(tmp_path / "model.nc") as file:
        back = MlpModel.from_dataset(file.load())
        told = dict(file.attrs)
        assert list(file["state"].values) == ["q", "turn"]
        assert list(file["input"].values) == ["u"] and list(file["input_unit"].values) == ["m"]
    assert same_weights(model, back) and back.origin == model.origin
    assert (back.sigma, back.seed) == (0.2, 7)
    assert [s.name for s in back.origin.y] == ["q", "turn"]
    assert [s.name for s in back.origin.inputs] == ["u"]
    assert (told["kind"], told["schema"], told["data_hash"]) == ("mlp", 1, "0123")
    z = np.random.default_rng(0).normal(size=(4, 3))
    assert np.array_equal(back.values(z), model.values(z))


def test_what_is_no_network_is_said() -> None:
    dataset = a_model().dataset()
    with pytest.raises(ValueError, match="expected a file of kind 'mlp', found 'ewda'"):
        MlpModel.from_dataset(dataset.assign_attrs(kind="ewda"))
    with pytest.raises(ValueError, match="its schema is 2, this version reads 1"):
        MlpModel.from_dataset(dataset.assign_attrs(schema=2))
    with pytest.raises(ValueError, match="lacks weight_1, z_scale"):
        MlpModel.from_dataset(dataset.drop_vars(["weight_1", "z_scale"]))
    with pytest.raises(ValueError, match="bias_0 holds numbers that are not finite"):
        MlpModel.from_dataset(dataset.assign(bias_0=dataset["bias_0"] * np.nan))
