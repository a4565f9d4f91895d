"""Transitions: rejected values, stored values, and the hash by which they are compared."""

from __future__ import annotations

import numpy as np
import pytest

from dynamics.learned.transitions import Normalisation, Transitions, split_rows
from dynamics.systems import signals

STATES, INPUTS = signals("x [m]; v [m/s]"), signals("u [N]")


def arrays(n: int = 60, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    x, u = rng.standard_normal((n, 2)), 5.0 * rng.standard_normal((n, 1))
    return x, u, x + 0.1 * u


def made(n: int = 60, seed: int = 0) -> Transitions:
    return Transitions.from_arrays(*arrays(n, seed), STATES, INPUTS, {"problem": "own", "seed": seed})


def test_scales_are_mean_and_deviation_of_every_coordinate() -> None:
    data = made(500)
    z = data.normalisation.normalise(data.z)
    np.testing.assert_allclose(z.mean(axis=0), 0, atol=1e-14)
    np.testing.assert_allclose(z.std(axis=0), 1, rtol=1e-14)
    np.testing.assert_allclose(data.normalisation.denormalise(z), data.z, rtol=1e-13, atol=1e-13)
    assert (data.names, data.units) == (["x", "v", "u"], ["m", "m/s", "N"])


def test_a_dataset_is_read_back_as_it_was() -> None:
    data = made()
    again = Transitions.from_dataset(data.dataset())
    for name in ("x", "u", "x_next"):
        assert np.array_equal(getattr(again, name), getattr(data, name))
    assert (again.states, again.inputs) == (STATES, INPUTS)
    assert dict(again.provenance) == dict(data.provenance) and again.hash == data.hash
    assert np.array_equal(again.normalisation.scale, data.normalisation.scale)


def test_what_is_held_out_is_drawn_once_for_all() -> None:
    rest, held = split_rows(200, 0.1, seed=4)
    assert (len(rest), len(held)) == (180, 20)
    assert sorted([*rest, *held]) == list(range(200))
    assert np.array_equal(split_rows(200, 0.1, seed=4)[1], held)
    assert not np.array_equal(split_rows(200, 0.1, seed=5)[1], held)


def test_the_hash_is_of_values_names_and_units() -> None:
    # Of these very numbers: what a stored model says it was made from must not change its name.
    x = np.arange(60, dtype=float).reshape(30, 2)
    known = Transitions.from_arrays(x, x[:, :1] ** 2, x + 1, STATES, INPUTS)
    assert known.hash == "675130d82baad74bd95568fe57d6840edb8639af085953ec4e81b6eb9947faa8"
    others = [
        Transitions.from_arrays(x, x[:, :1] ** 2, x + 1.5, STATES, INPUTS),
        Transitions.from_arrays(x, x[:, :1] ** 2, x + 1, STATES, signals("w [N]")),
        Transitions.from_arrays(x, x[:, :1] ** 2, x + 1, STATES, signals("u [mN]")),
    ]
    assert len({data.hash for data in (known, *others)}) == 4
    told = Transitions.from_arrays(x, x[:, :1] ** 2, x + 1, STATES, INPUTS, {"seed": 3})
    assert told.hash == known.hash


Arrays = tuple[np.ndarray, np.ndarray, np.ndarray]


def spoiled(index: tuple[int, int], value: float, which: int) -> Arrays:
    found = arrays()
    found[which][index] = value
    return found


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        (spoiled((7, 1), np.nan, 0), r"1 of 60 rows .*\(7, counted from 0; v is nan in row 7\)"),
        (spoiled((9, 0), np.inf, 2), r"x_next is inf in row 9"),
        (spoiled((9, 0), -np.inf, 1), r"u is -inf in row 9"),
        (arrays(29), r"29 rows are too few .*3 coordinates \(x, v, u\) need at least 30"),
        ((arrays()[0], np.full((60, 1), 2.0), arrays()[2]), r"u never varies"),
        ((arrays()[0][:, :1], *arrays()[1:]), r"x has shape \(60, 1\), expected \(60, 2\)"),
        ((arrays()[0], arrays(50)[1], arrays()[2]), r"u has shape \(50, 1\), expected \(60, 1\)"),
    ],
)
def test_bad_data_is_told(bad: Arrays, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Transitions.from_arrays(*bad, STATES, INPUTS)


def test_data_of_another_system_are_told() -> None:
    data = made()
    data.check_signals(STATES, INPUTS, "own")
    with pytest.raises(ValueError, match=r"states are x \[m\], v \[m/s\], and push has q \[m\]"):
        data.check_signals(signals("q [m]"), INPUTS, "push")
    with pytest.raises(ValueError, match=r"inputs are u \[N\], and push has u \[N s\]"):
        data.check_signals(STATES, signals("u [N s]"), "push")


def test_datasets_that_are_no_transitions_are_told() -> None:
    good = made().dataset()
    with pytest.raises(ValueError, match="of kind 'transitions', found 'ewda'"):
        Transitions.from_dataset(good.assign_attrs(kind="ewda"))
    with pytest.raises(ValueError, match="its schema is 9, this version reads 1"):
        Transitions.from_dataset(good.assign_attrs(schema=9))
    with pytest.raises(ValueError, match="lacks x_next, z_scale;"):
        Transitions.from_dataset(good.drop_vars(["x_next", "z_scale"]))
    changed = good.assign(x=good["x"] + 1e-9)
    with pytest.raises(ValueError, match="their hash differs"):
        Transitions.from_dataset(changed)


def test_a_system_without_inputs_has_transitions_too() -> None:
    x = np.linspace(0, 1, 20)[:, None]
    data = Transitions.from_arrays(x, np.empty((20, 0)), x, signals("x [m]"), ())
    again = Transitions.from_dataset(data.dataset())
    assert again.u.shape == (20, 0) and again.hash == data.hash
    assert isinstance(again.normalisation, Normalisation)
