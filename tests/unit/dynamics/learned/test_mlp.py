"""Networks: NumPy agrees with Equinox and with differences; training and its errors."""

from __future__ import annotations

import sys
from dataclasses import replace
from itertools import islice, pairwise
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
from dynamics.learned.training import Network, Recipe, Training, evaluate_network, train_network
from dynamics.learned.transitions import DataOrigin, Normalisation, Samples, Transitions, split_rows
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


TINY = Recipe(hidden=(8, 8), epochs=6, batch=64)


def run(training: Training, epochs: int | None = None) -> MlpModel:
    list(islice(training.epochs(), epochs))
    return training.model()


@pytest.mark.costly
def test_a_seed_fixes_every_bit() -> None:
    data = pushed(500)
    one, again = (run(Training(data, 0.2, TINY, seed=3)) for _ in range(2))
    other = run(Training(data, 0.2, TINY, seed=4))
    assert same_weights(one, again) and not same_weights(one, other)
    assert one.origin.data_hash == "0123" and (one.sigma, one.seed) == (0.2, 3)


@pytest.mark.costly
def test_what_is_resumed_ends_in_the_same_bits(tmp_path: Path) -> None:
    data = pushed(500)
    whole = Training(data, 0.2, TINY)
    told = list(whole.epochs())
    part = Training(data, 0.2, TINY)
    list(islice(part.epochs(), 2))
    np.savez(tmp_path / "state.npz", **part.state)
    with np.load(tmp_path / "state.npz", allow_pickle=False) as file:
        resumed = Training(data, 0.2, TINY, state=dict(file))
    assert resumed.epoch == 2
    assert list(resumed.epochs()) == told[2:]
    assert same_weights(whole.model(), resumed.model()) and resumed.done
    longer = Training(data, 0.2, replace(TINY, epochs=7), state=whole.state)
    assert [epoch.number for epoch in longer.epochs()] == [7]
    with pytest.raises(ValueError, match="checkpoint has other data, recipe"):
        Training(data, 0.3, TINY, state=part.state)
    with pytest.raises(ValueError, match="checkpoint has other data, recipe"):
        Training(pushed(500, seed=1), 0.2, TINY, state=part.state)


@pytest.mark.costly
def test_an_interrupted_epoch_is_done_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C comes after an epoch has computed its weights and before it ends."""
    data = pushed(500)
    whole, part = Training(data, 0.2, TINY), Training(data, 0.2, TINY)
    told = list(whole.epochs())
    list(islice(part.epochs(), 2))

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(Network, "errors", interrupted)
        with pytest.raises(KeyboardInterrupt):
            next(part.epochs())
    resumed = Training(data, 0.2, TINY, state=part.state)
    assert list(resumed.epochs()) == told[2:] and same_weights(whole.model(), resumed.model())


@pytest.mark.costly
def test_noise_is_on_the_inputs_alone() -> None:
    """For x ~ N(0, s²) and y = x the best map of noised inputs is s² x / (s² + sigma²), eq. 7.

    Normalised data have s = 1. If y had the same noise, the slope would be 1; with other noise on y
    the slope would be the same and the error larger by sigma². 8000 samples in 40 epochs of noise
    leave an error of the slope of about sigma/sqrt(8000) = 0.01.
    """
    sigma = 1.0
    x = 0.5 * np.random.default_rng(0).normal(size=(8000, 1))
    recipe = Recipe(hidden=(16,), epochs=40, batch=500, patience=40)
    training = Training(Samples(x, x.copy(), LINE), sigma, recipe)
    last = list(training.epochs())[-1]
    s = x.std()
    queries = np.linspace(-s, s, 21)[:, None]
    slope = np.polyfit(queries[:, 0], training.model().values(queries)[:, 0], 1)[0]
    assert slope == pytest.approx(1.0 / (1.0 + sigma**2), abs=0.03)
    # E[(E[y | noised x] - y)²] = sigma²/(1 + sigma²) of y's variance; the clean error of the same
    # map is (1 - slope)².
    assert last.train == pytest.approx(0.5, abs=0.03)
    assert last.noised == pytest.approx(0.5, abs=0.06)
    assert last.clean == pytest.approx(0.25, abs=0.05)


def g_sigma(x: np.ndarray, data: Samples, sigma: float) -> np.ndarray:
    """Return the weighted average of equation 11 in one dimension, written out."""
    exponents = -0.5 * ((x[:, None] - data.z[:, 0]) / (sigma * data.z.std())) ** 2
    weights = np.exp(exponents - exponents.max(axis=1, keepdims=True))
    return weights @ data.y[:, 0] / weights.sum(axis=1)


@pytest.mark.costly
def test_h_sigma_tends_to_g_sigma() -> None:
    """In training the distance of h_sigma from equation 11 falls where there are data; that of h does not."""
    x = np.random.default_rng(0).uniform(-1.0, 1.0, (2000, 1))
    data, sigma = Samples(x, np.maximum(x, 0.0), LINE), 0.3
    queries = np.linspace(-1.0, 1.0, 101)
    recipe = Recipe(hidden=(32, 32), epochs=60, batch=100, held_out=0)

    def distance(training: Training) -> float:
        found = training.model().values(queries[:, None])[:, 0]
        return float(np.sqrt(np.mean((found - g_sigma(queries, data, sigma)) ** 2)))

    noised, clean = Training(data, sigma, recipe), Training(data, 0.0, recipe)
    distances = [distance(noised) for _ in noised.epochs()]
    run(clean)
    assert distances[-1] < 0.2 * distances[0]
    assert distances[-1] < 0.015 < 0.03 < distance(clean)


@pytest.mark.costly
def test_training_stops_when_held_out_error_does_not_fall() -> None:
    """The targets do not depend on z, so that the held-out error does not fall."""
    rng = np.random.default_rng(0)
    data = Samples(rng.normal(size=(100, 1)), rng.normal(size=(100, 1)), LINE)
    training = Training(data, 0.0, Recipe(hidden=(64, 64), epochs=2000, rate=1e-2, patience=5))
    told = list(training.epochs())
    best = min(told, key=lambda epoch: epoch.noised)
    assert told[-1].number == best.number + 5 < 2000
    assert told[-1].best == best.noised < told[-1].noised
    held = training.held_out
    error = (training.model().values(data.z[held]) - data.y[held]) / data.y.std()
    assert np.mean(error**2) == pytest.approx(best.noised, rel=1e-5)


@pytest.mark.costly
def test_held_out_rows_are_never_trained_on() -> None:
    """Other targets of held-out rows give the same weights, if no scale and no stop depends on them."""
    data = pushed(200)
    recipe = replace(TINY, patience=6)
    first = Training(data, 0.1, recipe)
    assert len(first.held_out) == 20 and not set(first.held_out) & set(first.trained_on)
    swapped = data.y.copy()
    swapped[first.held_out] = swapped[np.roll(first.held_out, 1)]
    second = Training(replace(data, y=swapped), 0.1, recipe)
    seen = list(first.epochs()), list(second.epochs())
    assert [epoch.train for epoch in seen[0]] == pytest.approx([e.train for e in seen[1]])
    assert seen[0][-1].clean != pytest.approx(seen[1][-1].clean, rel=1e-2)


def test_training_holds_out_what_transitions_do() -> None:
    """A network and an average of the same data are compared on rows that neither has used."""
    drawn = pushed(100)
    data = Transitions.from_arrays(drawn.z[:, :2], drawn.z[:, 2:], drawn.y, PUSH.y, PUSH.inputs)
    training = Training(data.samples(), 0.1, TINY, seed=5)
    rest, held_out = split_rows(len(data), TINY.held_out, seed=5)
    assert np.array_equal(training.held_out, held_out)
    assert np.array_equal(training.trained_on, rest)
    assert training.model().origin.data_hash == data.hash


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"hidden": (8, 0)}, "hidden must be whole numbers >= 1"),
        ({"hidden": ()}, "hidden has no layers"),
        ({"epochs": 0}, "epochs must be a whole number >= 1"),
        ({"batch": 1.5}, "batch must be a whole number >= 1"),
        ({"rate": 0.0}, "rate must be a number > 0"),
        ({"held_out": 1.0}, "held_out must be a number >= 0 and < 1"),
        ({"sigma": -0.1}, "sigma must be a number >= 0, got -0.1"),
        ({"sigma": np.inf}, "sigma must be a finite number >= 0, got inf"),
    ],
)
def test_a_recipe_that_cannot_be_is_said(change: dict, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        train_network(pushed(50), **{"sigma": 0.1, **change})


def test_data_that_cannot_be_learned_from_are_said() -> None:
    data = pushed(50)
    broken = data.z.copy()
    broken[[4, 9], 1] = np.nan
    with pytest.raises(ValueError, match=r"data: 2 of \d+ rows hold .* turn\w* is \S+ in row 4"):
        replace(data, z=broken)
    with pytest.raises(ValueError, match=r"y \(49, 2\), expected \(50, 3\) and \(50, 2\)"):
        replace(data, y=data.y[1:])
    with pytest.raises(ValueError, match="4 rows are too few to train on with 10 % of them"):
        Training(pushed(4), 0.1)
    constant = data.z.copy()
    constant[:, 2] = 3.0
    with pytest.raises(ValueError, match="data: u never varies"):
        Training(replace(data, z=constant), 0.1)
    with pytest.raises(ValueError, match="data: the next q, the next turn never varies"):
        Training(replace(data, y=np.ones((50, 2))), 0.1)


@pytest.mark.costly
def test_training_that_diverges_is_said() -> None:
    with pytest.raises(ValueError, match=r"diverged in epoch \d+; lower rate"):
        train_network(pushed(200), 0.1, rate=1e30, epochs=20, hidden=(8,))


def test_without_the_extra_its_name_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "equinox", None)
    with pytest.raises(ValueError, match=r"the extra learn installs.*centralpath\[learn\]"):
        Network(1, 1, TINY, 0.0, 0)
    assert a_model().values(np.zeros((1, 3))).shape == (1, 2)
