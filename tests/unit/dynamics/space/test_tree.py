"""Trees in space agree with MuJoCo, Lagrange's equations, and conservation laws."""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dynamics.systems.space import Body, SpatialMachine, Tree, rotation
from problems.bodies.ant import ant
from problems.bodies.half_cheetah.machine import half_cheetah
from problems.bodies.hopper.machine import hopper
from problems.bodies.quadruped import quadruped

_HALF = 2**-0.5
_CRANE = (
    Body("base", None, 5.0, (0.1, 0.2, 0.25, 0.01, 0.02, -0.01), com=(0.1, 0.02, -0.03), joint="free"),
    Body(
        "hip",
        "base",
        1.0,
        (0.01, 0.02, 0.015),
        com=(0.1, 0.0, 0.1),
        position=(0.2, 0.1, 0.0),
        quaternion=(_HALF, _HALF, 0.0, 0.0),
        armature=0.1,
        spring=3.0,
        rest=0.2,
    ),
    Body(
        "rod",
        "hip",
        0.7,
        (0.01, 0.02, 0.015),
        com=(0.0, 0.05, 0.1),
        position=(0.2, 0.1, 0.0),
        joint="slide",
        axis=(0.6, 0.0, 0.8),
    ),
    Body("ball", "base", 0.9, (0.01, 0.012, 0.015), com=(0.0, 0.05, 0.1), position=(-0.2, 0.1, 0.0), joint="ball"),
    Body(
        "lid",
        "ball",
        0.4,
        (0.01, 0.012, 0.015),
        com=(0.0, 0.05, 0.1),
        joint="fixed",
        position=(0.0, 0.2, 0.0),
        quaternion=(0.6, 0.0, 0.8, 0.0),
    ),
    Body(
        "tail", "lid", 0.9, (0.01, 0.012, 0.015), com=(0.0, 0.05, 0.1), position=(-0.2, 0.1, 0.0), axis=(0.6, 0.8, 0.0)
    ),
)


@cache
def _tree(name: str) -> Tree:
    machines = {"ant": ant, "quadruped": quadruped}
    return machines[name]().tree() if name in machines else Tree(_CRANE)


@cache
def _maps(name: str) -> ca.Function:
    tree = _tree(name)
    q, v, w = (ca.SX.sym(s, n) for s, n in (("q", tree.nq), ("v", tree.nv), ("w", tree.nv)))
    by_w = ca.jacobian(tree.inverse_dynamics(q, v, w, ca.SX(tree.nv, 1)), w)
    outputs = [
        tree.mass(q),
        by_w,
        tree.bias(q, v),
        tree.weight(q),
        tree.energy(q, v),
        tree.momentum(q, v),
        tree.advance(q, v),
    ]
    return ca.Function("maps", [q, v], [ca.densify(one) for one in outputs], {"cse": True})


def _state(name: str, seed: int) -> tuple[np.ndarray, np.ndarray]:
    tree, rng = _tree(name), np.random.default_rng(seed)
    q = rng.normal(size=tree.nq)
    for k in range(0, len(tree.quaternion_entries), 4):
        four = tree.quaternion_entries[k : k + 4]
        q[four] /= np.linalg.norm(q[four])
    return q, rng.normal(size=tree.nv)


TREES = ("crane", "ant", "quadruped")


@pytest.mark.one_case_in(3)
@pytest.mark.parametrize("name", TREES)
def test_the_rate_of_the_mass_matrix_is_the_symmetric_part_of_c(name: str) -> None:
    maps, h = _maps(name), 1e-6
    q, v = _state(name, 0)
    mass, c, bias, weight, *_ = (np.array(one) for one in maps(q, v))
    ahead, behind = (np.array(maps(maps(q, sign * h * v)[6], v)[0]) for sign in (1, -1))
    assert np.allclose(c + c.T, (ahead - behind) / (2 * h), atol=1e-7 * np.abs(mass).max())
    assert np.allclose(c @ v + weight.ravel(), bias.ravel(), rtol=1e-12, atol=1e-12)
    assert np.allclose(mass, mass.T) and np.linalg.eigvalsh(mass).min() > 0


@pytest.mark.parametrize("name", TREES)
def test_the_bias_is_that_of_lagrange_equations(name: str) -> None:
    """Free motion conserves energy: ``d/dt (v'Mv/2 + V) = v'(M a + C v + g) = 0`` for every v."""
    tree, h = _tree(name), 1e-5
    q, v = _state(name, 1)
    mass, _, bias, *_ = (np.array(one) for one in _maps(name)(q, v))
    springs = np.zeros(tree.nv)
    if name == "crane":
        springs[6] = 3.0 * (0.2 - q[7])
    a = np.linalg.solve(mass, springs - bias.ravel())
    energies = []
    for sign in (1, -1):
        there = _maps(name)(q, sign * h * v)[6]
        energies.append(float(_maps(name)(there, v + sign * h * a)[4]))
    power = (energies[0] - energies[1]) / (2 * h)
    assert power == pytest.approx(0, abs=1e-6 * (1 + abs(energies[0])))


def test_free_fall_keeps_momentum_but_for_gravity() -> None:
    q, v = _state("ant", 2)
    mass, _, bias, *_ = (np.array(one) for one in _maps("ant")(q, v))
    a, h = np.linalg.solve(mass, -bias.ravel()), 1e-5
    moved = [np.array(_maps("ant")(_maps("ant")(q, s * h * v)[6], v + s * h * a)[5]).ravel() for s in (1, -1)]
    force = (moved[0] - moved[1]) / (2 * h)
    # Armature is inertia without weight and without momentum.
    assert np.allclose(force, [0, 0, -9.81 * float(ca.evalf(_tree("ant").total_mass))], atol=1e-5)


def test_turning_is_that_of_rotation_vectors_and_stays_of_unit_length() -> None:
    rng, way = np.random.default_rng(3), ca.SX.sym("way", 3)
    q = ca.SX.sym("q", 4)
    turned = ca.Function("turned", [q, way], [rotation.integrate(q, way)])
    for size in (0.0, 1e-9, 1e-3, 0.06, 0.0633, 1.0, 7.0):
        one, by = Rotation.random(random_state=1), size * np.array([0.6, 0.0, -0.8])
        wxyz = np.roll(one.as_quat(), 1)
        found = np.array(turned(wxyz, by)).ravel()
        expected = (one * Rotation.from_rotvec(by)).as_matrix()
        R = np.array(ca.evalf(rotation.matrix(ca.SX(found))))
        assert np.allclose(R, expected, atol=2e-15)
    along = np.array(turned.mapaccum(10_000)([1, 0, 0, 0], rng.normal(size=(3, 10_000))))
    assert np.abs(np.linalg.norm(along, axis=0) - 1).max() < 1e-14


def test_the_slope_of_turning_is_its_derivative() -> None:
    """For a unit quaternion ``q = (s, a)``, ``dq/dt = (-a, s I + [a]) omega / 2``."""
    q, way = ca.SX.sym("q", 4), ca.SX.sym("way", 3)
    s, a = q[0], q[1:]
    rate = ca.vertcat(-a.T, s * ca.SX.eye(3) + ca.skew(a)) / 2
    both = ca.Function("both", [q, way], [ca.jacobian(rotation.integrate(q, way), way), rate])
    at = np.roll(Rotation.random(random_state=4).as_quat(), 1)
    found, expected = (np.array(one) for one in both(at, np.zeros(3)))
    assert np.allclose(found, expected, atol=1e-15)


@pytest.mark.parametrize("machine", [hopper, half_cheetah])
def test_planar_machines_are_a_special_case(machine) -> None:
    """The planar chain has smaller graphs: 231 instead of 273 nodes, and 456 instead of 596."""
    planar = machine()
    bodies = []
    for link in planar.links:
        inertia = (float(link.inertia),) * 3
        own = {"mass": float(link.mass), "inertia": inertia, "com": _in_space(link.com)}
        if link.joint == "free":
            bodies += [
                Body("x", None, 0.0, joint="slide", axis=(1.0, 0.0, 0.0)),
                Body("z", "x", 0.0, joint="slide", axis=(0.0, 0.0, 1.0)),
                Body(link.name, "z", **own),
            ]
            continue
        half = float(link.offset) / 2
        bodies.append(
            Body(
                link.name,
                link.parent,
                position=_in_space(link.anchor),
                quaternion=(np.cos(half), 0.0, np.sin(half), 0.0),
                **own,
            )
        )
    chain, tree = planar.tree(), Tree(bodies)
    q, v = ca.SX.sym("q", chain.nq), ca.SX.sym("v", chain.nq)
    rng = np.random.default_rng(5)
    at = rng.normal(size=chain.nq), rng.normal(size=chain.nq)
    sizes = []
    for make in (chain, tree):
        f = ca.Function("f", [q, v], [make.mass(q), make.bias(q, v)], {"cse": True})
        sizes.append((f.n_instructions(), [np.array(one) for one in f(*at)]))
    assert all(np.allclose(a, b, atol=1e-12) for a, b in zip(sizes[0][1], sizes[1][1], strict=True))
    assert sizes[0][0] < sizes[1][0]


def _in_space(point) -> tuple[float, float, float]:
    return float(point[0]), 0.0, float(point[1])


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        (lambda: Body("a", None, -1.0), "mass must not be negative"),
        (lambda: Body("a", None, 1.0, (1.0, 1.0, 3.0)), "is impossible"),
        (lambda: Body("a", None, 1.0, axis=(1.0, 1.0, 0.0)), "use .0.707107, 0.707107, 0."),
        (lambda: Body("a", None, 1.0, joint="screw"), "joint must be one of"),  # pyright: ignore
        (lambda: Body("a", "b", 1.0, joint="free"), "floats freely"),
        (lambda: Body("a", None, 1.0, joint="ball", gear=1.0), "ball joint has no gear"),
        (lambda: Body("a", None, 1.0, gear=1.0, servo=1.0), "two kinds of motor"),
        (lambda: Body("a", None, 1.0, com=(0.0, 0.0)), "tuple of 3 numbers"),
        (lambda: Body("a", None, 1.0, limits=(1.0, 0.0)), "expected the lower one first"),
        (lambda: SpatialMachine((Body("world", None, 1.0),)), "never moves"),
        (lambda: Tree((Body("a", "b", 1.0), Body("b", "a", 1.0))), "cycle"),
    ],
)
def test_wrong_bodies_are_told_in_a_sentence(wrong, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        wrong()
