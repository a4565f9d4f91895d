"""Formulations of the friction cone: their impulses do the work of their rows, and they state Coulomb's law."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from dynamics.systems import Signal
from dynamics.systems.contact_rows import FORMS
from dynamics.systems.shapes.contact import ConeForm, FrictionSpec

NQ = 4
F = 0.6
"""Coulomb's coefficient."""
NORMAL = 0.7
"""Normal impulse [N s]."""
SLIP = 0.3
"""Distance [m] that a sliding contact slides in a step."""


def spec_of(form: ConeForm, directions: int, gap: ca.SX, slip: list[ca.SX], friction: ca.SX) -> FrictionSpec:
    """Return contacts with random rows along the normal and the tangents, and symbols as multipliers."""
    nc, rng = gap.numel(), np.random.default_rng(0)
    rows = [ca.SX(rng.normal(size=(nc, NQ))) for _ in range(1 + directions)]
    lam = [ca.SX.sym(f"lam{i}", nc) for i in range(1 + form.n_further(directions))]
    contacts = tuple(Signal(f"c{i}", "N s") for i in range(nc))
    return FrictionSpec(contacts, gap, rows[0], rows[1:], friction, slip, lam)


@pytest.mark.parametrize("friction", [0.0, F])
@pytest.mark.parametrize(
    ("cone", "directions"), [("linearised", 1), ("linearised", 2), ("edges", 1), ("edges", 2), ("second-order", 1)]
)
def test_impulses_of_a_cone_do_the_work_of_its_rows(cone: str, directions: int, friction: float) -> None:
    """``sum of direction' lam`` over all rows is ``J_n' normal + sum of J_t' tangential``, for any multipliers."""
    form = FORMS[cone]
    slip = [ca.SX.sym(f"slip{k}", 2) for k in range(directions)]
    spec = spec_of(form, directions, ca.SX.sym("gap", 2), slip, friction * ca.SX.ones(2))
    rows, normal, tangential = form.pairs(spec)
    impulse = sum((row.direction.T @ lam for row, lam in zip(rows, spec.lam, strict=True)), ca.SX.zeros(NQ))
    work = spec.J_n.T @ normal
    for row, along in zip(spec.J_t, tangential, strict=True):
        work += row.T @ along
    lam = ca.vertcat(*spec.lam)
    sides = ca.Function("sides", [lam], [impulse, work, ca.vertcat(*tangential)])
    values = [np.array(v) for v in sides(np.random.default_rng(1).uniform(0.1, 1, lam.numel()))]
    np.testing.assert_allclose(values[0], values[1], atol=1e-12)
    assert np.all(values[2] == 0) == (friction == 0)


MODES = {
    "slides forward": (SLIP, -F * NORMAL),
    "slides back": (-SLIP, F * NORMAL),
    "sticks": (0.0, 0.3 * F * NORMAL),
    "sticks, held back": (0.0, -0.8 * F * NORMAL),
}


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("cone", ["second-order", "linearised"])
def test_solutions_of_coulombs_law_are_complementary(cone: str, mode: str) -> None:
    """Each mode gives the multipliers in closed form; no pair has both members positive, and none is negative."""
    slip, tangential = MODES[mode]
    if cone == "second-order":
        lam = [NORMAL, F * NORMAL + tangential, max(0.0, -2 * slip)]
    else:
        lam = [NORMAL, max(0.0, tangential), max(0.0, -tangential), abs(slip)]
    gap, t, normal = evaluated(cone, lam, slip)
    assert (t, normal) == (pytest.approx(tangential), pytest.approx(NORMAL))
    np.testing.assert_allclose(np.array(lam) * gap, 0.0, atol=1e-12)
    assert np.all(gap >= -1e-12)


@pytest.mark.parametrize("mode", MODES)
def test_a_contact_on_an_edge_of_its_cone_opens_as_it_slides(mode: str) -> None:
    """Anitescu's contact opens by f times the distance slid; where it sticks it is closed, and both edges act."""
    slip, tangential = MODES[mode]
    lam = [(NORMAL + sign * tangential / F) / 2 for sign in (1, -1)]
    gap, t, normal = evaluated("edges", lam, slip, F * abs(slip))
    assert (t, normal) == (pytest.approx(tangential), pytest.approx(NORMAL))
    np.testing.assert_allclose(np.array(lam) * gap, 0.0, atol=1e-12)
    assert np.all(gap >= -1e-12) and min(lam) >= -1e-12
    np.testing.assert_allclose(np.ptp(gap), 2 * F * abs(slip))


@pytest.mark.parametrize("cone", ["second-order", "linearised"])
@pytest.mark.parametrize(("slip", "tangential"), [(SLIP, F * NORMAL), (-SLIP, -F * NORMAL), (SLIP, -F * NORMAL / 2)])
def test_impulses_that_dissipate_less_than_they_can_are_no_solutions(cone: str, slip: float, tangential: float) -> None:
    """No multipliers on a grid, with the same impulses, make the gaps complementary."""
    grid = np.linspace(0.0, 2.0, 21)
    least = np.inf
    for free in grid:
        if cone == "second-order":
            lam = [NORMAL, F * NORMAL + tangential, free]
        else:
            lam = [NORMAL, max(0.0, tangential), max(0.0, -tangential), free]
        gap = evaluated(cone, lam, slip)[0]
        least = min(least, float(np.abs(np.minimum(lam, gap)).max()))
    assert least > 0.05


def evaluated(cone: str, lam: list[float], slip: float, distance: float = 0.0) -> tuple[np.ndarray, float, float]:
    """Return all gaps of one contact in the plane at a distance, and its tangential and normal impulse."""
    form = FORMS[cone]
    spec = spec_of(form, 1, ca.SX([distance]), [ca.SX([slip])], ca.SX([F]))
    rows, normal, (tangential,) = form.pairs(spec)
    outputs = [ca.vertcat(*(row.gap for row in rows)), tangential, normal]
    gap, t, n = ca.Function("gaps", spec.lam, outputs)(*lam)
    return np.array(gap).ravel(), float(t), float(n)


@pytest.mark.parametrize("cone", FORMS)
@pytest.mark.parametrize("directions", [1, 2])
def test_pairs_of_a_cone_have_different_names(cone: str, directions: int) -> None:
    """One tangent needs no number; two are numbered 1 and 2."""
    if cone == "second-order" and directions == 2:
        with pytest.raises(ValueError, match="one tangent"):
            FORMS[cone].pairs(spec_of(FORMS[cone], 2, ca.SX.zeros(1), [ca.SX(1, 1)] * 2, ca.SX([F])))
        return
    spec = spec_of(FORMS[cone], directions, ca.SX.zeros(2), [ca.SX.zeros(2)] * directions, F * ca.SX.ones(2))
    names = [signal.name for row in FORMS[cone].pairs(spec)[0] for signal in row.signals]
    assert len(set(names)) == len(names) == 2 * (1 + FORMS[cone].n_further(directions))
    assert [number for number, *_ in spec.directions] == ([""] if directions == 1 else ["1", "2"])
