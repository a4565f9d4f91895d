"""Adam agrees with its recursion by hand."""

from __future__ import annotations

from itertools import islice

import numpy as np
import pytest

from ocp.learning.unrolling import adam


def test_steps_are_those_of_the_recursion_by_hand():
    """On a linear cost m/(1 - b1^t) = g and v/(1 - b2^t) = g², so that every step has the size of the rate."""
    slope = np.array([3.0, -1e-2, 0.5])
    found = list(islice(adam(lambda t: (float(slope @ t), slope), np.zeros(3), 0.1), 4))
    for count, (theta, cost) in enumerate(found):
        expected = -0.1 * count * slope / (np.abs(slope) + 1e-8)
        assert theta == pytest.approx(expected, rel=1e-12)
        assert cost == pytest.approx(float(slope @ expected), rel=1e-12)


def test_two_steps_on_a_parabola():
    a, rate = 2.0, 0.1
    first, second, third = (t[0] for t, _ in islice(adam(lambda t: (0.0, a * t), [1.0], rate), 3))
    assert (first, second) == (1.0, pytest.approx(1.0 - rate * a / (a + 1e-8), rel=1e-14))
    m = 0.9 * 0.1 * a + 0.1 * a * second
    v = 0.999 * 0.001 * a**2 + 0.001 * (a * second) ** 2
    step = rate * (m / (1 - 0.81)) / (np.sqrt(v / (1 - 0.999**2)) + 1e-8)
    assert third == pytest.approx(second - step, rel=1e-12)


def test_a_gradient_without_a_number_is_told():
    with pytest.raises(ValueError, match="gradient of step 0 is not finite; lower the rate"):
        list(islice(adam(lambda _: (0.0, np.array([np.nan])), np.zeros(1), 0.1), 2))
