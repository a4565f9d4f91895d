"""Softened and exact contact agree with reference numbers, from 60-digit arithmetic and enumeration.

Their sources are the formulas above each table; eps = z + F lam is the gap.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from dynamics.contact import Adaptive, Barrier, ContactLaw, Exact
from dynamics.contact.adaptive import quartic_mu
from dynamics.contact.affine_step import lcp_solver
from dynamics.contact.interior_point import scalar_solution
from dynamics.systems import lcs


def contact(F, law: ContactLaw) -> tuple[ca.Function, np.ndarray]:
    """Return the contact ``lam(z)`` as the step of a system whose state is z, and the law's parameters."""
    n = len(F)
    eye, zero = np.eye(n), np.zeros((n, n))
    system = lcs("contact", A=zero, B=np.zeros((n, 1)), C=eye, D=eye, E=np.zeros((n, 1)), F=F)
    step = law.close(system)
    return step.map, step.p.values


def derivatives(F, law: ContactLaw, z) -> dict[str, np.ndarray]:
    """Return lam, d lam/dz, d lam/d(parameters) and, for one contact, d² lam/dz² by the step map."""
    step, parameters = contact(F, law)
    x, p = ca.MX.sym("z", len(F)), ca.MX.sym("p", len(parameters))
    lam = step(x, 0, p)[1]
    outputs = {"lam": lam, "jac": ca.jacobian(lam, x), "dmu": ca.jacobian(lam, p)}
    if len(F) == 1:
        outputs["dzz"] = ca.hessian(lam, x)[0]
    values = ca.Function("d", [x, p], list(outputs.values()))(z, parameters)
    return {key: np.array(value) for key, value in zip(outputs, values, strict=True)}


# F, z, mu, lam, d lam/dz, d² lam/dz², d lam/d mu with lam (z + F lam) = mu, lam > 0:
# -lam / r, 2 mu / r³ and 1 / r, r = sqrt(z² + 4 F mu).
SCALAR = [
    (1.0, 0.0, 0.01, 0.1, -0.5, 2.5, 5.0),
    (2.0, 0.3, 0.01, 0.028077640640441513, -0.06809828122275027, 0.28533602945450937, 2.42535625036333),
    (0.5, -0.7, 0.001, 1.4014271166700072, -1.9979654098963517, 0.005795385655611799, 1.4256648712805027),
    (0.11, 0.2, 0.0001, 0.0004998625755730478, -0.002497939388807073, 0.024958806646050904, 4.997252266672312),
    (3.0, 2.0, 1e-06, 4.999996250005625e-07, -2.4999943750140625e-07, 2.4999887500421874e-07, 0.4999992500016875),
    (1.0, 50.0, 1e-08, 1.999999999992e-10, -3.999999999952e-12, 1.5999999999616e-13, 0.01999999999984),
    (1.0, -50.0, 1e-08, 50.0000000002, -0.999999999996, 1.5999999999616e-13, 0.01999999999984),
    (0.01, 1e-06, 1e-12, 9.901951359278482e-07, -0.970966215453992, 1885732.068636385, 980580.6756909202),
]


@pytest.mark.parametrize(("F", "z", "mu", "lam", "dz", "dzz", "dmu"), SCALAR)
def test_one_softened_contact(F, z, mu, lam, dz, dzz, dmu):
    got = derivatives([[F]], Barrier(mu=mu), [z])
    assert got["lam"] == pytest.approx(lam, rel=1e-12)
    assert got["jac"] == pytest.approx(dz, rel=1e-11)
    assert got["dmu"] == pytest.approx(dmu, rel=1e-11)
    # r cancels where the softened contact is nearly linear: relative 1e-7 there, 1e-10 elsewhere
    assert got["dzz"] == pytest.approx(dzz, rel=1e-10, abs=1e-14)
    assert float(scalar_solution(z, F, mu)) == pytest.approx(lam, rel=1e-13)


MATRICES = {
    "symmetric": [[1, -0.9], [-0.9, 1]],
    "symmetric b": [[2, 0.5], [0.5, 1]],
    "nonsymmetric": [[1, 2], [-2, 1.5]],
    "P, not PD": [[1, -100], [0, 1]],
    "P, not PD, 3": [[1, -3, 2], [0.1, 0.5, -4], [0, 0.2, 2]],
    "SPD, 4": [[4, 1, 0, -1], [1, 3, -1, 0.5], [0, -1, 2.5, 0.2], [-1, 0.5, 0.2, 2]],
    "P, 5": [
        [1, 0.3, -0.5, 0.2, 0],
        [-0.4, 1.2, 0.1, 0, 0.6],
        [0.2, -0.7, 0.9, 0.3, -0.1],
        [0, 0.1, -0.2, 1.5, 0.4],
        [0.5, -0.3, 0, -0.6, 1.1],
    ],
}
POINTS = {
    "symmetric": ([0.1, 0.1], 0.01),
    "symmetric b": ([-1, 0.4], 1e-4),
    "nonsymmetric": ([-0.5, 0.2], 1e-3),
    "P, not PD": ([1, 1], 1.0),
    "P, not PD, 3": ([0.5, -1, 0.3], 0.01),
    "SPD, 4": ([-1, 0.5, -0.2, 0.05], 1e-3),
    "P, 5": ([-0.3, 0.8, -1.2, 0.1, -0.05], 1e-4),
}
# lam with lam_i (z + F lam)_i = mu
SOFTENED = {
    "symmetric": [0.0916079783099616, 0.0916079783099616],
    "symmetric b": [0.5000615370738999, 0.00015380248079936384],
    "nonsymmetric": [0.20795248249575424, 0.1484281541889997],
    "P, not PD": [60.81984087788798, 0.6180339887498949],
    "P, not PD, 3": [3.689835034517, 1.4065679586073188, 0.0162894947826836],
    "SPD, 4": [0.27822371089778336, 0.0013147583252071258, 0.0768796133715032, 0.11061537194660445],
    "P, 5": [
        0.8427292437969833,
        0.0001738636206927883,
        1.1186002698277324,
        0.08318697052403155,
        0.00031080787532717063,
    ],
}
# d lam/d mu = (diag(eps) + diag(lam) F)^-1 1
BY_MU = {
    "symmetric": [8.451542547285166, 8.451542547285166],
    "symmetric b": [0.6153568233201973, 1.537588306403743],
    "nonsymmetric": [-1.0827690371419263, 2.958299185325938],
    "P, not PD": [44.725710428519605, 0.4472135954999579],
    "P, not PD, 3": [23.326902962869262, 8.693040361271413, 1.5030497808232868],
    "SPD, 4": [1.6498237555996185, 1.3100751510927273, 5.039029896150464, 4.336453433918086],
    "P, 5": [-0.520752505763497, 1.737365363296925, 0.4520310914656004, 7.061262546771714, 3.1096222129543354],
}
# 0 <= lam ⟂ z + F lam >= 0 by enumeration of active sets
EXACT = {
    "symmetric": [0.0, 0.0],
    "symmetric b": [0.5, 0.0],
    "nonsymmetric": [0.20909090909090908, 0.14545454545454545],
    "P, not PD": [0.0, 0.0],
    "P, not PD, 3": [3.4375, 1.3125, 0.0],
    "SPD, 4": [0.2765282583621684, 0.0, 0.07151095732410612, 0.1061130334486736],
    "P, 5": [0.8427835051546392, 0.0, 1.1185567010309279, 0.08247422680412371, 0.0],
}
# d lam/dz = -(diag(eps) + diag(lam) F)^-1 diag(lam); row lam, column z
BY_Z = {
    "symmetric": [[-0.5488425006100678, -0.22538622574734937], [-0.22538622574734937, -0.5488425006100678]],
    "symmetric b": [[-0.49991482012944005, 5.911394948959383e-05], [5.911394948959383e-05, -0.0002365030774794773]],
    "nonsymmetric": [[-0.2768958186650393, 0.3583505561875922], [-0.3583505561875922, -0.18331861137724131]],
    "P, not PD": [[-0.9997297336043572, -27.631850245546875], [0.0, -0.276393202250021]],
    "P, not PD, 3": [
        [-0.635384220396774, -3.6414909601886727, -0.33500624910223714],
        [0.1209765903053271, -1.210654464446123, -0.1281186940563208],
        [-0.0006096625514429694, 0.006101103427094554, -0.02455188710322032],
    ],
    "SPD, 4": [
        [-0.2835871369506619, 0.0006239129052530142, 0.010528112026521257, -0.13738815222800133],
        [0.0006239129052530142, -0.0017226266419844876, -0.0007038999985651322, 0.0007810849910780494],
        [0.010528112026521257, -0.0007038999985651322, -0.37802193917310084, 0.04154455540771856],
        [-0.13738815222800133, 0.0007810849910780494, 0.04154455540771856, -0.5505463712645671],
    ],
    "P, 5": [
        [
            -0.9082666736876566,
            -2.0863374403284397e-05,
            -0.45775530297194716,
            0.21057447237758642,
            -0.00012544174532928994,
        ],
        [
            -0.00011570596756428977,
            -0.0003021716199801365,
            -2.6143217401611904e-05,
            2.0524183911572273e-05,
            1.6451049731839371e-07,
        ],
        [
            0.19330804225492504,
            -0.00022703898917718752,
            -0.9667373871896385,
            0.16591182898226187,
            -0.00015719902932435928,
        ],
        [
            0.025416484002195212,
            -1.0008482423231926e-05,
            -0.12770546281191128,
            -0.6382718273787455,
            0.0002340527028924602,
        ],
        [
            0.0004529165953205706,
            -8.320614965316245e-08,
            0.00014691637050922915,
            -0.00047115071702150444,
            -0.0009647938513084548,
        ],
    ],
}


@pytest.mark.parametrize("name", MATRICES)
def test_several_softened_contacts(name):
    z, mu = POINTS[name]
    got = derivatives(MATRICES[name], Barrier(mu=mu), z)
    assert np.allclose(got["lam"].ravel(), SOFTENED[name], rtol=1e-9, atol=1e-13)
    assert np.allclose(got["dmu"].ravel(), BY_MU[name], rtol=1e-8, atol=1e-8)
    assert np.allclose(got["jac"], BY_Z[name], rtol=1e-8, atol=1e-11)


@pytest.mark.parametrize("name", MATRICES)
def test_several_exact_contacts(name):
    z, _ = POINTS[name]
    step, _ = contact(MATRICES[name], Exact())
    assert np.allclose(np.array(step(z, 0, [])[1]).ravel(), EXACT[name], rtol=0, atol=1e-12)


def test_exact_contacts_without_coupling():
    assert np.allclose(np.array(contact(np.eye(2), Exact())[0]([-1, 2], 0, [])[1]).ravel(), [1, 0])


def test_every_contact_may_have_its_own_mu():
    z, _ = POINTS["SPD, 4"]
    own = Adaptive(law=lambda z, F: ca.SX([0.001, 0.01, 0.0001, 0.1]))
    got = derivatives(MATRICES["SPD, 4"], own, z)["lam"].ravel()
    expected = [0.3221535704457143, 0.010628193439859074, 0.06121365707934927, 0.296138365593832]
    assert np.allclose(got, expected, rtol=1e-9)


# abs, eq. C.2: mu = 1e-2 (100 d² + 1)^-4
@pytest.mark.parametrize(
    ("d", "mu"),
    [
        (0, 0.01),
        (0.01, 0.009609803444828162),
        (0.1, 6.25e-4),
        (0.5, 2.1882987290360983e-08),
        (1, 9.609803444828163e-11),
    ],
)
def test_quartic_mu(d, mu):
    assert float(quartic_mu(d, 1e-2, 100, 4)) == pytest.approx(mu, rel=1e-12)
    step, parameters = contact([[1.0]], Adaptive(law="quartic"))
    lam = float(step(d, 0, parameters)[1])
    assert lam * (d + lam) == pytest.approx(mu, rel=1e-9)


def test_the_claimed_bound_of_theorem_4_5_is_exceeded():
    # F P but not PD: |dx+/dx| = 250, and the paper's d² |C| |D| |lam|² / mu is 8
    got = derivatives([[1, -1000], [0, 1]], Barrier(mu=1.0), [1000, 0])
    lam = got["lam"].ravel()
    assert abs(got["jac"][0, 1]) == pytest.approx(250, rel=1e-8)
    assert 4 * lam @ lam / 1.0 == pytest.approx(8, rel=1e-8)


def test_the_claimed_bound_of_theorem_5_1_is_exceeded():
    # z > 0 throughout, yet |dx+/dx| = 27.63 > 4, since lam_1 = 60.8 > mu / z
    got = derivatives([[1, -100], [0, 1]], Barrier(mu=1.0), [1, 1])
    assert abs(got["jac"][0, 1]) == pytest.approx(27.631850245546875, rel=1e-9)
    assert got["lam"][0, 0] > 1


@pytest.mark.parametrize("name", MATRICES)
def test_the_solver_reports_gap_and_error(name):
    z, mu = POINTS[name]
    lam, gap, error = (
        np.array(value).ravel() for value in lcp_solver(len(z))(z, np.array(MATRICES[name]), np.full(len(z), mu))
    )
    assert np.allclose(lam * gap, mu, rtol=1e-9)
    assert np.allclose(gap, np.array(z) + np.array(MATRICES[name]) @ lam, atol=1e-9)
    assert np.all(error <= 1e-10)
