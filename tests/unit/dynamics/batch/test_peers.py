"""Peers that benchmarks compare with the engine return right results, and their failures are reported."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from dynamics.batch import RolloutFunction, open_loop
from dynamics.contact import Barrier
from problems.bodies.half_cheetah.machine import half_cheetah
from problems.bodies.hopper.machine import hopper
from tests.benchmarks.batch import mujoco_peer
from tests.benchmarks.batch.peers import casadi_forms, fastest, generated, mapped
from tests.benchmarks.batch.race import Row, race, tell
from tests.unit.dynamics.batch.rollout_cases import closed, four_contacts, wall
from tests.unit.dynamics.batch.test_friction_rollout import START, tossed_rod

N = 4


def case(name: str):
    """Return the parts of a rollout, its start, and inputs (n, N, nu)."""
    rng = np.random.default_rng(1)
    if name == "rod":
        step = tossed_rod("barrier")
        x, u, p = step.system.x, step.system.u, step.p.vector
        stage = ca.Function("stage", [x, u, p], [1e-2 * ca.sumsqr(u) + x[0] ** 2])
        parts = step, stage, ca.Function("end", [x, p], [ca.sumsqr(x - 0.5)]), N
        return parts, START, rng.standard_normal((6, N, 2))
    system = {"wall": wall, "four": four_contacts}[name]()
    parts = *closed(system, Barrier(mu=1e-3)), N
    return parts, np.full(system.nx, 0.5), 0.3 * rng.standard_normal((32, N, system.nu))


@pytest.mark.cheap_cases("wall")
@pytest.mark.parametrize("name", ["wall", "four", "rod"])
def test_every_form_is_the_same_rollout(name):
    (step, *rest), x0, theta = case(name)
    policy = open_loop(step.system.nx, step.system.nu)
    wanted = RolloutFunction(step, *rest, policy, backend="numpy")(x0, theta)
    forms = casadi_forms(step, *rest)
    assert len(forms) >= 2
    for form, graph in forms.items():
        if form.startswith(("4", "5")):  # too few iterations for some samples
            continue
        cost, gradient = mapped(graph, x0, np.zeros(step.system.nu), theta)()
        np.testing.assert_allclose(np.array(cost)[0], wanted.cost, rtol=1e-10)
        own = np.array(gradient).T.reshape(theta.shape)
        off = 1e-9 * np.abs(own).max()
        np.testing.assert_allclose(own, wanted.gradient, rtol=1e-8, atol=off)


@pytest.mark.costly
def test_several_contacts_are_not_measured_on_the_interior_point_path():
    parts, x0, theta = case("four")
    assert "Newton" in fastest(casadi_forms(*parts), x0, np.zeros(2), theta)


def test_a_form_that_is_fast_and_wrong_is_no_peer():
    parts, x0, theta = case("wall")
    forms = casadi_forms(*parts)
    some = next(iter(forms.values()))
    inputs = some.sx_in()
    forms["wrong"] = ca.Function("wrong", inputs, [ca.SX(1), ca.SX.ones(1, N)])
    assert fastest(forms, x0, np.zeros(1), theta) != "wrong"


@pytest.mark.costly
def test_casadis_own_c_is_the_same_function(tmp_path):
    parts, x0, theta = case("four")
    graph = casadi_forms(*parts)["6 Newton iterations, calls"]
    built = generated(graph, tmp_path / "c")
    assert built is not None
    for ours, theirs in zip(
        mapped(built, x0, np.zeros(2), theta)(),
        mapped(graph, x0, np.zeros(2), theta)(),
        strict=True,
    ):
        np.testing.assert_allclose(np.array(ours), np.array(theirs), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("row", "missed"),
    [
        (Row("ratio", 59.0, "x", least=60.0), True),
        (Row("ratio", float("nan"), "x", least=60.0), True),
        (Row("time", 1.5, " s", most=1.0), True),
        (Row("ratio", 60.0, "x", least=60.0), False),
        (Row("time", 1.0, " s", most=1.0), False),
        (Row("told", 0.0, "x"), False),
    ],
)
def test_a_missed_bound_is_printed_and_fails(row, missed, capsys):
    if missed:
        with pytest.raises(AssertionError, match=f"here: missed {row.what}"):
            tell("here", [row, Row("other", 1.0, "x")])
    else:
        tell("here", [row])
    assert ("MISSED" in capsys.readouterr().out) == missed


def test_a_race_tells_both_clocks():
    found = race({"idle": lambda: None, "busy": lambda: sum(range(200_000))}, rounds=3)
    assert 0 < found["idle"].wall < found["busy"].wall
    assert found["idle"].processor < found["busy"].processor


@pytest.mark.parametrize("machine", [hopper(), half_cheetah()], ids=["hopper", "half-cheetah"])
def test_mujoco_has_the_same_machines_and_their_derivatives(machine):
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(mujoco_peer.mjcf(machine))
    data, chain, x0 = mujoco.MjData(model), machine.tree(), machine.reset(0)
    q0 = data.qpos[:] = x0[: model.nq]
    mujoco.mj_forward(model, data)
    mass = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    q = ca.SX.sym("q", model.nq)
    np.testing.assert_allclose(mass, ca.Function("M", [q], [chain.mass(q)])(q0), atol=1e-12)
    gaps = [float(contact.phi) for contact in machine.contacts(ca.SX(q0)).values()]
    heights = data.geom_xpos[1:, 2] - model.geom_size[1:, 0]
    np.testing.assert_allclose(sorted(heights), sorted(gaps), atol=1e-12)

    inputs = 0.05 * np.random.default_rng(0).standard_normal((1, 8, model.nu))
    slopes = mujoco_peer.derivatives(model, x0, inputs, 1)()
    aside = np.zeros_like(inputs)
    aside[0, 3, 1] = 1e-5
    ends = [mujoco_peer.forward(model, x0, inputs + sign * aside, 1)()[0] for sign in (1, -1)]
    np.testing.assert_allclose(slopes[0, 3, 1], (ends[0] - ends[1])[0, -1, 1] / 2e-5, rtol=1e-3)
