"""The weighted average of data agrees with 60 digits, closed forms and differences."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm

from dynamics.learned.ewda import EwdaModel
from dynamics.learned.transitions import Normalisation
from tests.unit.dynamics.learned.ewda_reference import gap, model_of, origin, reference

ENGINES = ["c", "numpy"]
SIGMAS = [0.05, 0.2, 0.6, 2.0]
FAR = [0.0, 0.03, 0.3, 1.0, 5.0, 50.0]
"""Distances of the queries from a datum, in standard deviations of the data."""
NZ, NY = 11, 7


@pytest.fixture(params=ENGINES)
def engine(request) -> str:
    return request.param


def data(n: int, nz: int = NZ, ny: int = NY, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Draw points z with very different units, and targets y that are nonlinear in z."""
    rng = np.random.default_rng(seed)
    z = rng.standard_normal((n, nz)) * np.logspace(-2, 2, nz) + 5 * rng.standard_normal(nz)
    y = np.sin(rng.standard_normal((n, nz)) @ rng.standard_normal((nz, ny))) + 3.0
    return z, y


def queries(model: EwdaModel, n: int, far: float, seed: int = 1) -> np.ndarray:
    rng = np.random.default_rng(seed)
    home = model.z[rng.integers(len(model.z), size=n)]
    return home + far * model.scales.scale * rng.standard_normal((n, model.n_in))


def assert_exact(model: EwdaModel, z: np.ndarray, weights: np.ndarray) -> None:
    """Check that values and derivatives at the queries are within 1e-11 of 60 digits, relative to their size.

    In normalised units of z, the size of y is its maximum, that of dy/dz~ at least 1 / sigma times
    it, and that of curvatures at least 1 / sigma² times it, since y changes over one width. If one
    datum has all the weight, the derivatives of y are zero, and these sizes still apply.
    """
    scale, sigma = model.scales.scale, model.sigma
    size = np.abs(model.y).max()
    values = model.values(z)
    again, jacobians = model.jacobians(z)
    bends = model.curvatures(z, weights)
    assert bends == pytest.approx(bends.transpose(0, 2, 1), rel=0, abs=0)
    for i in range(len(z)):
        exact = reference(model, z[i], weights[i])
        for found in (values[i], again[i]):
            error = gap(found, exact.values)
            assert error[:-1].max() <= 1e-11 * size
            assert error[-1] <= 1e-11 * max(1.0, abs(float(exact.values[-1])))
        error = gap(jacobians[i], exact.jacobian) * scale
        slope = np.abs((exact.jacobian[-1] * scale).astype(float)).max()
        assert error[:-1].max() <= 1e-11 * size / sigma
        assert error[-1].max() <= 1e-11 * max(1 / sigma, slope)
        error = gap(bends[i], exact.curvature) * scale[:, None] * scale
        assert error.max() <= 1e-11 * max(size, 1.0) * np.abs(weights[i]).max() / sigma**2


@pytest.mark.cheap_cases("numpy-2.0-0.03")
@pytest.mark.parametrize("far", FAR)
@pytest.mark.parametrize("sigma", SIGMAS)
def test_all_answers_are_exact(engine, sigma, far):
    z, y = data(200)
    model = model_of(z, y, sigma, backend=engine)
    weights = np.random.default_rng(2).standard_normal((1, NY + 1))
    assert_exact(model, queries(model, 1, far), weights)


@pytest.mark.costly
@settings(deadline=None, max_examples=25)
@given(
    n=st.integers(2, 300),
    nz=st.integers(1, 6),
    ny=st.integers(1, 5),
    sigma=st.floats(0.05, 2.0),
    far=st.floats(0.0, 20.0),
    seed=st.integers(0, 1 << 20),
)
def test_all_answers_are_exact_whatever_the_data(engine_of_property, n, nz, ny, sigma, far, seed):
    z, y = data(n, nz, min(ny, nz), seed)
    model = model_of(z, y, sigma, backend=engine_of_property)
    weights = np.random.default_rng(seed).standard_normal((1, min(ny, nz) + 1))
    assert_exact(model, queries(model, 1, far, seed), weights)


@pytest.fixture(scope="module", params=ENGINES)
def engine_of_property(request) -> str:
    return request.param


@pytest.mark.parametrize("sigma", [0.3, 0.6, 2.0])
def test_derivatives_are_differences(engine, sigma):
    z, y = data(500)
    model = model_of(z, y, sigma, backend=engine)
    at = queries(model, 3, 0.4)
    weights = np.random.default_rng(2).standard_normal((3, NY + 1))
    scale, h = model.scales.scale, 1e-4 * sigma
    steps = h * np.diag(scale)
    moved = [model.jacobians(at + way * step) for step in steps for way in (1, -1)]
    values, slopes = (np.stack(part) for part in zip(*moved, strict=True))
    # In normalised z, where a derivative of order m is of size sigma^-m: h² of the third remain.
    rough = (values[::2] - values[1::2]).transpose(1, 2, 0) / (2 * h)
    jacobians = model.jacobians(at)[1] * scale
    np.testing.assert_allclose(jacobians, rough, rtol=0, atol=1e-6 * 4 / sigma)
    rough = np.einsum("ni,knij->nkj", weights, (slopes[::2] - slopes[1::2]) * scale) / (2 * h)
    bends = model.curvatures(at, weights) * scale[:, None] * scale
    np.testing.assert_allclose(bends, rough, rtol=0, atol=1e-6 * 40 / sigma**2)


@pytest.mark.costly
def test_engines_agree_where_nothing_can_be_left_out():
    z, y = data(5000)
    for sigma in SIGMAS:
        c, numpy = (model_of(z, y, sigma, backend=name) for name in ENGINES)
        at = np.vstack([queries(c, 4, far) for far in FAR])
        weights = np.random.default_rng(0).standard_normal((len(at), NY + 1))
        np.testing.assert_allclose(c.values(at), numpy.values(at), rtol=1e-12)
        scale = c.scales.scale
        for own, other, order in (
            (c.jacobians(at)[1] * scale, numpy.jacobians(at)[1] * scale, 1),
            (c.curvatures(at, weights), numpy.curvatures(at, weights), 2),
        ):
            if order == 2:
                own, other = (a * scale[:, None] * scale for a in (own, other))
            size = np.maximum(np.abs(other).max(axis=(1, 2), keepdims=True), sigma**-order)
            assert (np.abs(own - other) <= 1e-11 * size).all()


@pytest.mark.one_case_in(2)
@pytest.mark.parametrize("n", [100, 3000])
@pytest.mark.parametrize("sigma", [0.1, 1.0])
def test_same_bits_for_any_threads_and_company(n, sigma):
    z, y = data(n)
    one, two, five = (model_of(z, y, sigma, backend="c", threads=k) for k in (1, 2, 5))
    at = np.vstack([queries(one, 60, far) for far in FAR])
    weights = np.random.default_rng(0).standard_normal((len(at), NY + 1))
    together = one.values(at), *one.jacobians(at), one.curvatures(at, weights)
    for other in (two, five):
        again = other.values(at), *other.jacobians(at), other.curvatures(at, weights)
        for a, b in zip(together, again, strict=True):
            assert np.array_equal(a, b)
    for i in range(0, len(at), 7):
        row = slice(i, i + 1)
        alone = one.values(at[row]), *one.jacobians(at[row])
        alone = *alone, one.curvatures(at[row], weights[row])
        for a, b in zip(together, alone, strict=True):
            assert np.array_equal(a[row], b)


@pytest.mark.parametrize("far", [1e2, 1e4, 1e7, 1e12])
def test_far_away_is_the_nearest_neighbour(engine, far):
    z, y = data(1000)
    model = model_of(z, y, 0.1, backend=engine)
    direction = np.random.default_rng(5).standard_normal(NZ)
    direction /= np.linalg.norm(direction)
    at = model.scales.denormalise(far * direction)[None]
    q, points = model.scales.normalise(at)[0], model.scales.normalise(z)
    nearest = np.argmin(np.sum(points**2, axis=1) - 2 * points @ q)
    values, jacobians = model.jacobians(at)
    assert np.array_equal(values[0, :-1], y[nearest])
    assert np.array_equal(model.values(at), values)
    assert not jacobians[0, :-1].any()
    weights = np.append(np.ones(NY), 2.0)[None]
    bends = model.curvatures(at, weights)[0] * model.scales.scale[:, None] * model.scales.scale
    np.testing.assert_allclose(bends, -2.0 / 0.1**2 * np.eye(NZ), atol=1e-9)
    square = np.sum((q - points[nearest]) ** 2)
    peak = np.log(1000) + NZ * np.log(0.1 * np.sqrt(2 * np.pi))
    assert values[0, -1] == pytest.approx(-square / (2 * 0.1**2) - peak, rel=1e-13)


@given(far=st.floats(0, 1e140), seed=st.integers(0, 1 << 20))
@settings(deadline=None, max_examples=50)
def test_answers_are_numbers_however_far(engine_of_property, far, seed):
    z, y = data(300)
    model = model_of(z, y, 0.05, backend=engine_of_property)
    at = model.scales.denormalise(far * np.random.default_rng(seed).standard_normal((1, NZ)))
    values, jacobians = model.jacobians(at)
    bends = model.curvatures(at, np.ones((1, NY + 1)))
    for answer in (values, jacobians, bends):
        assert np.isfinite(answer).all()
    assert (values[0, :-1] >= y.min(axis=0)).all()
    assert (values[0, :-1] <= y.max(axis=0)).all()


def test_neighbours_that_tie_share(engine):
    z = np.array([[-1.0, 0.0], [1.0, 0.0], [1.0, 0.0], [0.0, 50.0]])
    y = np.array([[0.0], [3.0], [6.0], [100.0]])
    model = EwdaModel(z, y, Normalisation(np.zeros(2), np.ones(2)), 0.3, origin(2, 1))
    values, jacobians = model.jacobians(np.zeros((1, 2)))
    assert values[0, 0] == pytest.approx(3.0, rel=1e-15)
    # Cov(y, z) = E[y z] - 0 + E y / 3 with weights of a third each: 3 - 3 (1 / 3) = 2.
    np.testing.assert_allclose(jacobians[0, 0], [2.0 / 0.09, 0.0], rtol=1e-14, atol=1e-14)


def test_a_mean_where_no_data_are_bends_nonetheless(engine):
    """Between two points g = tanh(z / sigma²), and its curvature is not lost, though all weights are exp(-1250).

    The second derivative is -2 tanh(t) / cosh²(t) / sigma⁴ at t = z / sigma².
    """
    z, sigma, t = np.array([[-1.0], [1.0]]), 0.02, 0.3
    unit = Normalisation(np.zeros(1), np.ones(1))
    model = EwdaModel(z, z, unit, sigma, origin(1, 1), backend=engine)
    at, only_g = np.array([[t * sigma**2]]), np.array([[1.0, 0.0]])
    assert model.values(at)[0, 0] == pytest.approx(np.tanh(t), rel=1e-12)
    slope = 1 / np.cosh(t) ** 2 / sigma**2
    assert model.jacobians(at)[1][0, 0, 0] == pytest.approx(slope, rel=1e-12)
    bend = -2 * np.tanh(t) * slope / sigma**2
    assert model.curvatures(at, only_g)[0, 0, 0] == pytest.approx(bend, rel=1e-12)


@pytest.mark.parametrize("at", [0.0, 0.7, 1e6])
def test_one_point_is_a_constant_and_a_gaussian(engine, at):
    model = model_of(np.array([[2.0]]), np.array([[5.0]]), 0.5, backend=engine)
    values, jacobians = model.jacobians(np.array([[2.0 + at]]))
    assert values[0, 0] == 5.0
    assert jacobians[0, 0, 0] == 0.0
    assert values[0, 1] == pytest.approx(norm.logpdf(at, scale=0.5), rel=1e-14)
    assert jacobians[0, 1, 0] == pytest.approx(-at / 0.25, rel=1e-14)
    bends = model.curvatures(np.array([[2.0 + at]]), np.array([[1.0, 3.0]]))
    assert bends[0, 0, 0] == pytest.approx(-12.0, rel=1e-14)


@settings(deadline=None, max_examples=25)
@given(
    n=st.integers(2, 400),
    nz=st.sampled_from([1, 2, 5, 8]),  # The kernel is compiled for each.
    sigma=st.floats(0.05, 2.0),
    far=st.floats(0.0, 5.0),
    seed=st.integers(0, 1 << 20),
)
def test_score_of_the_identity(engine_of_property, n, nz, sigma, far, seed):
    """For y = z, g(z~) = z~ + sigma² dlog p/dz~, so that the step climbs the density of the data."""
    z, _ = data(n, nz, 1, seed)
    model = model_of(z, z, sigma, backend=engine_of_property)
    at = queries(model, 3, far, seed)
    values, jacobians = model.jacobians(at)
    scale = model.scales.scale
    score = jacobians[:, -1] * scale
    moved = model.scales.normalise(at) + sigma**2 * score
    size = 1 + np.abs(model.scales.normalise(z)).max() + np.abs(z / scale).max()
    np.testing.assert_allclose(model.scales.normalise(values[:, :-1]), moved, rtol=0, atol=1e-13 * (size + far))


@pytest.mark.parametrize("at", [-3.0, -1.2, -1.0, -0.9, 0.0, 0.4, 1.05, 2.0])
def test_block_between_walls_is_the_mean_of_a_truncated_normal(engine, at):
    """Dense uniform data of f(q) = q on [-1, 1] give lemma 2 for a density that ends at the walls.

    Midpoints of n cells replace the integral up to the midpoint rule's error, (2 / n)² / 24 times
    the change of the integrand's slope over the interval, at most 3 / sigma² here.
    """
    n, sigma = 20_000, 0.1
    q = (np.arange(n) + 0.5)[:, None] * (2 / n) - 1
    unit = Normalisation(np.zeros(1), np.ones(1))
    model = EwdaModel(q, q, unit, sigma, origin(1, 1), backend=engine)
    values, jacobians = model.jacobians(np.array([[at]]))
    # Points are reflected to the left of the middle, where the normal's tails do not cancel.
    x = -abs(at)
    a, b = (-1 - x) / sigma, (1 - x) / sigma
    mass = norm.sf(a) - norm.sf(b)
    mean = x + sigma * (norm.pdf(a) - norm.pdf(b)) / mass
    density = mass / 2
    assert values[0, 0] == pytest.approx(mean * (1 if at <= 0 else -1), abs=1e-6)
    assert values[0, 1] == pytest.approx(np.log(density), rel=1e-6, abs=1e-6)
    assert -1 < values[0, 0] < 1
    ratio = (norm.pdf(a) - norm.pdf(b)) / mass
    variance = 1 + (a * norm.pdf(a) - b * norm.pdf(b)) / mass - ratio**2
    assert jacobians[0, 0, 0] == pytest.approx(variance, abs=1e-5)


def test_model_comes_back_from_its_dataset():
    z, y = data(50)
    model = model_of(z, y, 0.3, seed=7)
    dataset = model.dataset()
    assert dataset.attrs["kind"] == "ewda"
    assert dataset.attrs["schema"] == 1
    back = EwdaModel.from_dataset(dataset)
    at = queries(model, 3, 0.2)
    assert np.array_equal(back.values(at), model.values(at))
    assert back.origin == model.origin
    assert (back.sigma, back.seed) == (0.3, 7)
    assert [signal.name for signal in back.origin.inputs] == [f"z{k}" for k in range(NY, NZ)]
    with pytest.raises(ValueError, match="lacks y_data"):
        EwdaModel.from_dataset(dataset.drop_vars("y_data"))
    with pytest.raises(ValueError, match="kind 'ewda', found 'mlp'"):
        EwdaModel.from_dataset(dataset.assign_attrs(kind="mlp"))


@pytest.mark.parametrize("sigma", [0.0, -0.2, np.inf, np.nan])
def test_widths_that_are_none(sigma):
    with pytest.raises(ValueError, match=r"sigma, the width of the noise .* must be above 0"):
        model_of(*data(10), sigma)


@pytest.mark.parametrize("bad", [np.inf, -np.inf, np.nan])
def test_queries_that_are_nowhere(engine, bad):
    model = model_of(*data(10), 0.2, backend=engine)
    at = queries(model, 3, 0.1)
    at[1, 2] = bad
    for ask in (model.values, model.jacobians, lambda z: model.curvatures(z, np.ones((3, NY + 1)))):
        with pytest.raises(ValueError, match=r"query 1 is infinitely far from .* \(z2 = "):
            ask(at)


def test_data_that_are_none():
    z, y = data(10)
    broken = y.copy()
    broken[3, 0] = np.nan
    unit = Normalisation(np.zeros(NZ), np.ones(NZ))
    for what, rows, targets in (
        ("row 3 of y is not finite", z, broken),
        ("at least one", z[:0], y[:0]),
        ("one row a sample", z, y[:5]),
        ("6 targets, but 7 are named", z, y[:, :6]),
    ):
        with pytest.raises(ValueError, match=what):
            EwdaModel(rows, targets, unit, 0.2, origin(NZ, NY))
    with pytest.raises(ValueError, match=r"queries must be \(n, 11\)"):
        model_of(z, y, 0.2).values(z[0])


def test_no_queries_have_no_answers(engine):
    model = model_of(*data(10), 0.2, backend=engine)
    nothing = np.zeros((0, NZ))
    assert model.values(nothing).shape == (0, NY + 1)
    assert model.jacobians(nothing)[1].shape == (0, NY + 1, NZ)
    assert model.curvatures(nothing, np.zeros((0, NY + 1))).shape == (0, NZ, NZ)
