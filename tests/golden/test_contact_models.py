"""One step of the papers' models, built by this package, agrees with reference numbers."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from dynamics.contact import Adaptive, Barrier, ContactLaw, Exact, Randomized
from dynamics.systems import (
    ContactSystem,
    Parameter,
    ParameterTable,
    quasi_dynamic,
    signals,
    time_stepping,
)


def wall(m: float, h: float) -> ContactSystem:
    """Return the system of a mass against a wall, Suh et al. 2022, eq. 2-5; the input is an impulse."""
    table = ParameterTable([Parameter("m", m, "kg"), Parameter("h", h, "s")])
    return time_stepping(
        "wall",
        states=signals("x [m]; v [m/s]"),
        inputs=signals("u [N s]"),
        contacts=signals("wall [N s]"),
        h=table["h"],
        mass=table["m"],
        impulse=lambda q, v, u: u,
        distance=lambda q: q,
        parameters=table,
    )


def pusher(m: float, k: float, h: float, r: float = 0.0) -> ContactSystem:
    """Return the system of the one-dimensional pusher of Suh et al. 2023, eq. 13."""
    table = ParameterTable([Parameter("m", m), Parameter("k", k), Parameter("h", h)])
    return quasi_dynamic(
        "pusher",
        states=signals("qu [m]; qa [m]"),
        inputs=signals("u [m]"),
        contacts=signals("push [N s]"),
        h=table["h"],
        mass=table["m"],
        stiffness=table["k"],
        distance=lambda q: q[0] - q[1] - r,
        parameters=table,
    )


def one_step(system: ContactSystem, law: ContactLaw, x, u) -> dict[str, np.ndarray]:
    """Return the next state, the impulse, and the derivatives of the next state by x and u."""
    step = law.close(system)
    mx, mu = ca.MX.sym("x", system.nx), ca.MX.sym("u", system.nu)
    x_next, lam = step.map(mx, mu, step.p.values)
    outputs = [x_next, lam, ca.jacobian(x_next, mx), ca.jacobian(x_next, mu)]
    values = ca.Function("step", [mx, mu], outputs)(x, u)
    return dict(zip(("x", "lam", "dx", "du"), (np.array(v) for v in values), strict=True))


# x, v, u, m, h, kappa; s = (s0 + sqrt(s0² + 4/(kappa m)))/2, s0 = x/h + v + u/m, s' = ds/ds0:
# x+ = h s, v+ = s - x/h, lam = 1/(kappa s), mu = h/kappa;
# dx+/du = h s'/m, dx+/dx = s', dx+/dv = h s', dv+/du = s'/m, dv+/dx = (s' - 1)/h, dv+/dv = s'
BARRIER = [
    ((0, 0, 0, 1, 0.1, 100), (0.01, 0.1, 0.1, 0.001), (0.05, 0.5, 0.05, 0.5, -5.0, 0.5)),
    (
        (0.05, -1, 0.2, 2, 0.1, 1000),
        (0.00012461179749810727, -0.4987538820250189, 0.8024922359499621, 0.0001),
        (
            0.0001548002500023367,
            0.003096005000046734,
            0.0003096005000046734,
            0.001548002500023367,
            -9.969039949999532,
            0.003096005000046734,
        ),
    ),
    (
        (0.3, -4, -0.5, 0.5, 0.05, 50),
        (0.05192582403567252, -4.961483519286549, 0.0192582403567252, 0.001),
        (
            0.09642383454426297,
            0.9642383454426297,
            0.048211917272131484,
            1.9284766908852593,
            -0.7152330911474069,
            0.9642383454426297,
        ),
    ),
]
# At kappa = infinity x+ = max(0, x + h (v + u/m)), v+ = (x+ - x)/h, lam = m (v+ - v) - u.
EXACT_WALL = [(0.0, 0.0, 0.0), (0.0, -0.5, 0.8), (0.05, -5.0, 0.0)]


@pytest.mark.parametrize(("given", "values", "derivatives"), BARRIER)
@pytest.mark.parametrize("parameter", ["kappa", "mu"])
def test_a_barrier_on_the_wall(given, values, derivatives, parameter):
    x, v, u, m, h, kappa = given
    x_next, v_next, lam, mu = values
    law = Barrier(kappa=kappa) if parameter == "kappa" else Barrier(mu=mu)
    got = one_step(wall(m, h), law, [x, v], u)
    assert np.allclose(got["x"].ravel(), [x_next, v_next], rtol=1e-10, atol=1e-12)
    assert got["lam"] == pytest.approx(lam, rel=1e-10)
    assert got["lam"] * got["x"][0] == pytest.approx(mu, rel=1e-9)
    dxdu, dxdx, dxdv, dvdu, dvdx, dvdv = derivatives
    assert np.allclose(got["du"].ravel(), [dxdu, dvdu], rtol=1e-9)
    assert np.allclose(got["dx"], [[dxdx, dxdv], [dvdx, dvdv]], rtol=1e-9)


@pytest.mark.parametrize(("row", "expected"), [*zip(BARRIER, EXACT_WALL, strict=True)])
def test_the_exact_wall(row, expected):
    x, v, u, m, h, _ = row[0]
    got = one_step(wall(m, h), Exact(), [x, v], u)
    assert np.allclose([*got["x"].ravel(), got["lam"].item()], expected, atol=1e-13)


def test_the_barrier_keeps_the_mass_off_the_wall():
    # x+(0, 0, u = 0) = h / sqrt(kappa m): 1e-3 at h = 0.1, m = 1, kappa = 1e4
    got = one_step(wall(1, 0.1), Barrier(kappa=1e4), [0, 0], 0)
    assert got["x"][0] == pytest.approx(1e-3, rel=1e-12)


# h = 0.1, m = 1, k = 1000, qu = 0.5, qa = 0, r = 0; u: (qu+, qa+, lam) with
# F = h/m + 1/(h k), z = qu - u - r, qu+ = qu + (h/m) lam, qa+ = u - lam/(h k)
PUSH_EXACT = {
    0.3: (0.5, 0.3, 0.0),
    0.5: (0.5, 0.5, 0.0),
    0.6: (0.5909090909090909, 0.5909090909090909, 0.9090909090909091),
    1.0: (0.9545454545454546, 0.9545454545454546, 4.545454545454546),
}
# (u, mu): (qu+, qa+, lam, dqu+/du = (h/m) lam / sqrt(z² + 4 F mu))
PUSH_BARRIER = {
    (0.3, 1e-2): (0.5048695795713886, 0.29951304204286117, 0.04869579571388535, 0.023110001930682276),
    (0.3, 1e-4): (0.5000499862575573, 0.2999950013742443, 0.0004998625755730478, 0.00024979393888070734),
    (0.5, 1e-2): (0.5301511344577764, 0.49698488655422235, 0.30151134457776363, 0.45454545454545453),
    (0.5, 1e-4): (0.5030151134457777, 0.4996984886554222, 0.03015113445777636, 0.45454545454545453),
    (0.6, 1e-2): (0.6, 0.59, 1.0, 0.8333333333333334),
    (0.6, 1e-4): (0.5910089811504274, 0.5908991018849572, 0.9100898115042745, 0.9080941970373103),
    (1.0, 1e-2): (0.9565367311439725, 0.9543463268856027, 4.565367311439726, 0.9051429464307637),
    (1.0, 1e-4): (0.954565453665532, 0.9545434546334468, 4.54565453665532, 0.9090509143701349),
}
# E qu+(u + w), w ~ N(0, 0.1²): qu + rho G(u + r - qu), rho = h² k/(m + h² k)
PUSH_SMOOTHED = {
    0.3: 0.5007718820560754,
    0.5: 0.5362674800364938,
    0.6: 0.5984832245988806,
    1.0: 0.954545459405605,
}


@pytest.mark.parametrize(("u", "expected"), PUSH_EXACT.items())
def test_the_exact_pusher(u, expected):
    got = one_step(pusher(1, 1000, 0.1), Exact(), [0.5, 0], u)
    assert np.allclose([*got["x"].ravel(), got["lam"].item()], expected, atol=1e-12)


@pytest.mark.parametrize(("given", "expected"), PUSH_BARRIER.items())
@pytest.mark.parametrize("parameter", ["kappa", "mu"])
def test_a_barrier_on_the_pusher(given, expected, parameter):
    u, mu = given
    # quasi-dynamics: mu = 1/kappa, since the objective of its QP is in J s
    law = Barrier(kappa=1 / mu) if parameter == "kappa" else Barrier(mu=mu)
    got = one_step(pusher(1, 1000, 0.1), law, [0.5, 0], u)
    values = [*got["x"].ravel(), got["lam"].item(), got["du"][0, 0]]
    assert np.allclose(values, expected, rtol=1e-10, atol=0)


@pytest.mark.costly
@pytest.mark.parametrize(("u", "expected"), PUSH_SMOOTHED.items())
def test_the_randomized_pusher(u, expected):
    system = pusher(1, 1000, 0.1)
    adaptive = one_step(system, Adaptive(sigma=0.1), [0.5, 0], u)
    assert adaptive["x"][0] == pytest.approx(expected, rel=1e-11)
    sampled = one_step(system, Randomized(sigma=0.1, samples=512, seed=1), [0.5, 0], u)
    assert sampled["x"][0] == pytest.approx(expected, abs=1e-3)


def chain() -> ContactSystem:
    """Return the system of two bodies in a row, pushed by one actuator, h = 0.1, k = 500, m = (1, 2), no widths."""
    table = ParameterTable([Parameter("k", 500.0)])
    return quasi_dynamic(
        "chain",
        states=signals("o1 [m]; o2 [m]; a [m]"),
        inputs=signals("u [m]"),
        contacts=signals("first [N s]; second [N s]"),
        h=0.1,
        mass=ca.SX(ca.diag([1, 2])),
        stiffness=table["k"],
        distance=lambda q: ca.vertcat(q[0] - q[2], q[1] - q[0]),
        parameters=table,
    )


def test_a_chain_of_two_bodies():
    # F = J P^-1 J', P = diag(m/h, h k); q = (0.5, 0.9, 0), u = 0.8
    system = chain()
    data = Exact().close(system).data([0.5, 0.9, 0], 0.8, 500)
    assert np.allclose(np.array(data[3]), [[0.12, -0.1], [-0.1, 0.15]], atol=1e-12)
    exact = one_step(system, Exact(), [0.5, 0.9, 0], 0.8)
    assert np.allclose(exact["lam"].ravel(), [2.5, 0.0], atol=1e-10)
    assert np.allclose(exact["x"].ravel(), [0.75, 0.9, 0.75], atol=1e-12)


@pytest.mark.parametrize(
    ("mu", "lam", "q"),
    [
        (1e-2, (2.5873270393075103, 0.0661425206306324), (0.7521184518676878, 0.9033071260315316, 0.7482534592138498)),
        (
            1e-4,
            (2.500888729252884, 0.0006666172496093265),
            (0.7500222112003274, 0.9000333308624805, 0.7499822254149423),
        ),
    ],
)
def test_a_barrier_on_the_chain(mu, lam, q):
    got = one_step(chain(), Barrier(mu=mu), [0.5, 0.9, 0], 0.8)
    assert np.allclose(got["lam"].ravel(), lam, rtol=1e-9)
    assert np.allclose(got["x"].ravel(), q, rtol=1e-10)
