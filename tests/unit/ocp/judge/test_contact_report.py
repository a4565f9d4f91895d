"""Reports on contacts of trajectories that are written by hand, in the plane with friction."""

from __future__ import annotations

import numpy as np
import pytest

from ocp.judge.contact_report import contact_report
from ocp.judge.measures import pair_sizes
from ocp.problem.rollout import Rollout
from tests.unit.ocp.user_problems import at_defaults, rough_slope

SLOPE, FACE = 0, 1
"""Indices of the contacts."""
N = 5


def by_kind(kind: str) -> np.ndarray:
    """Return the indices of the pairs of a kind, that of the slope and that of the face."""
    pairs = rough_slope(N).system.pairs
    return np.array([i for i, pair in enumerate(pairs) if pair.kind == kind])


def report_of(lam: np.ndarray, gap: np.ndarray, speed: float = 0.0):
    """Return the report on a block that slides at ``speed``, with multipliers and gaps (N, nlam)."""
    problem = rough_slope(N)
    x = np.zeros((1, N + 1, 6))
    x[..., 4] = speed
    rollout = Rollout(x, np.zeros((1, N, 1)), lam[None], gap[None], lam[None], np.zeros(1))
    return contact_report(at_defaults(problem), problem.exact_step, rollout)


def test_a_contact_is_judged_by_the_gap_of_its_normal_pair() -> None:
    """Impulses of two sizes act at every step; from step 3 on the slope, and until step 1 the face, is 1 m away."""
    normal, friction = by_kind("normal"), by_kind("friction")
    lam, gap = np.zeros((N, 8)), np.zeros((N, 8))
    lam[:, normal], gap[:, friction] = (2.0, 3.0), 7.0
    gap[3:, normal[SLOPE]] = 10.0
    gap[:2, normal[FACE]] = 10.0
    report = report_of(lam, gap)
    np.testing.assert_array_equal(report.active[0, :, SLOPE], [1, 1, 1, 0, 0])
    np.testing.assert_array_equal(report.active[0, :, FACE], [0, 0, 1, 1, 1])
    assert [(contact.steps, contact.distant, contact.spans) for contact in report.contacts] == [
        (3, 2, [(0, 2)]),
        (3, 2, [(2, 4)]),
    ]
    np.testing.assert_array_equal(report.normal[0], lam[:, normal])
    assert [contact.peak_force for contact in report.contacts] == pytest.approx([2 / 0.05, 3 / 0.05])


def test_a_contact_is_degenerate_where_both_members_of_its_normal_pair_are_zero() -> None:
    """Members of friction pairs may both be zero where a contact sticks; they do not count."""
    normal = by_kind("normal")
    lam, gap = np.ones((N, 8)), np.zeros((N, 8))
    lam[2, by_kind("friction")] = 0.0
    lam[1, normal[SLOPE]] = lam[4, normal[FACE]] = 0.0
    lam[0, normal[SLOPE]], gap[0, normal[SLOPE]] = 0.0, 1.0
    report = report_of(lam, gap)
    np.testing.assert_array_equal(np.argwhere(report.degenerate[0]), [[1, SLOPE], [4, FACE]])
    assert [contact.degenerate for contact in report.contacts] == [1, 1]


@pytest.mark.parametrize("speed", [0.4, -0.4])
def test_friction_dissipates_as_much_as_its_cone_allows(speed: float) -> None:
    """The normal impulse 2 and friction 0.6 allow 1.2; less, more, and the wrong sign are measured in N s and J."""
    normal, (plus, minus) = by_kind("normal")[SLOPE], by_kind("friction")[[0, 2]]
    for tangential in (1.2, 0.5, 1.5, -0.3):
        lam = np.zeros((N, 8))
        lam[:, normal] = 2.0
        lam[:, minus if (speed > 0) == (tangential > 0) else plus] = abs(tangential)
        report = report_of(lam, np.zeros((N, 8)), speed)
        np.testing.assert_allclose(report.tangential[0, :, SLOPE], -np.sign(speed) * tangential)
        np.testing.assert_allclose(report.slip[0, :, SLOPE], speed)
        assert report.cone_violation == pytest.approx(max(0.0, abs(tangential) - 1.2))
        assert report.dissipation_residual == pytest.approx(max(0.0, 0.4 * (1.2 - tangential)))
        slope = report.contacts[SLOPE]
        assert (slope.slipping, slope.slid) == (N, pytest.approx(N * 0.05 * 0.4))


def test_sizes_of_pairs_are_those_of_their_units() -> None:
    """A slip pair's multiplier is a length and its gap, the cone's margin, an impulse; all others the reverse."""
    problem = rough_slope(N)
    lam, gap = pair_sizes(problem, problem.system)
    is_slip = np.isin(np.arange(8), by_kind("slip"))
    np.testing.assert_array_equal(lam, np.where(is_slip, problem.scales.gap, problem.scales.impulse))
    np.testing.assert_array_equal(gap, np.where(is_slip, problem.scales.impulse, problem.scales.gap))
    assert problem.scales.gap != problem.scales.impulse and is_slip.sum() == 2
