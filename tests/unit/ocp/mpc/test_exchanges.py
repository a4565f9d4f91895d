"""Exchanges of contacts that wait for the next sample: shifted with the plan, also with a rate or a shorter horizon."""

from __future__ import annotations

import numpy as np
import pytest

from ocp.mpc.newton_phase import PairExchange
from ocp.mpc.qpcc_phase import QPCC
from ocp.mpc.stages import Plan
from tests.unit.ocp.mpc.test_stages import Horizon

STEP, PAIR = 5, 0
"""Step and pair of the exchange."""


@pytest.mark.parametrize(("shift", "shorter"), [(1, 0), (0, 0), (1, 1), (0, 1)])
def test_an_exchange_is_tried_once_at_the_same_time_of_the_shifted_plan(shift: int, shorter: int) -> None:
    made = Horizon("soft-walls", 0)
    phase = QPCC(made.model, made.rollouts)
    plan = made.plan
    pairs = np.zeros((len(plan.u), made.model.n), dtype=bool)
    pairs[[STEP, -1], PAIR] = True
    held = Plan(*(np.concatenate([v[shift:], v[-1:]][: 1 + shift]) for v in (plan.x, plan.u, plan.lam, plan.gap)))
    n = len(plan.u) - shorter
    rest = Plan(held.x[: n + 1], held.u[:n], held.lam[:n], held.gap[:n])
    own, _ = phase.active_set(rest)
    exchange = PairExchange(phase.sets.of(plan), pairs)
    phase.exchange = exchange.shifted() if shift else exchange
    closed, is_exchanged = phase.active_set(rest)
    assert is_exchanged
    expected = np.concatenate([pairs[shift:], np.zeros_like(pairs[:shift])])[:n]
    assert np.array_equal(closed ^ own, expected)


def test_a_pair_whose_side_has_changed_since_is_not_exchanged() -> None:
    made = Horizon("soft-walls", 0)
    phase = QPCC(made.model, made.rollouts)
    own = phase.sets.of(made.plan)
    phase.exchange = PairExchange(~own, np.ones_like(own))
    closed, is_exchanged = phase.active_set(made.plan)
    assert np.array_equal(closed, own) and not is_exchanged
