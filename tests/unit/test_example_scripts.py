"""Scripts and notebooks in ``examples/`` run, find known solutions, and are stored clean."""

from __future__ import annotations

import os
import subprocess
import sys
from functools import cache
from pathlib import Path

import nbformat
import numpy as np
import pytest
import xarray as xr

from ocp import Solution, solve
from problems.loading import import_file
from tests import notebooks
from tests.docs.pages import agrees

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"
SCRIPTS = [
    "past_a_post",
    "behind",
    "slope",
    "double_pendulum_walls",
    "walk_round",
    "friction_study",
]
NOTEBOOKS = sorted(EXAMPLES.glob("*.ipynb"))


@cache
def solved(name: str, survives: bool = True) -> Solution:
    """Solve an example from its own guess under the exact law; check its certificate and its replay at h."""
    found = solve(str(EXAMPLES / f"{name}.py"), contact="exact")
    assert found.success and found.certificate.stationarity == "B"
    assert found.referee.survives_at_h or not survives
    return found


def states(found: Solution, *names: str) -> np.ndarray:
    return found.data["x"].sel(scenario=0, state=list(names)).values


@pytest.mark.costly
def test_the_pusher_walks_round_object_and_post_and_brings_the_object_back() -> None:
    found = solved("behind")
    object_, pusher = (states(found, f"{n}_x", f"{n}_y") for n in ("object", "pusher"))
    assert object_[-1] == pytest.approx([-0.5, 0], abs=0.02)
    assert pusher[0, 0] < object_[0, 0] < pusher[:, 0].max(), "it comes from the other side"
    assert pusher[-1, 0] > object_[-1, 0]
    apart = np.hypot(*(pusher - object_).T)
    assert apart.min() > 0.3 - 1e-7
    for place, radius in ((pusher, 0.1), (object_, 0.2)):
        assert np.hypot(*(place - [0, -0.35]).T).min() > 0.1 + radius - 1e-7


@pytest.mark.costly
def test_the_block_goes_up_the_slope_and_stays() -> None:
    found = solved("slope")
    up, m, g, h = 0.3, 1.0, 9.81, 0.05
    along = np.array([np.cos(up), np.sin(up)])
    block = states(found, "block_x", "block_y") - [-0.1 * np.sin(up), 0.1 * np.cos(up)]
    way = block @ along
    assert way[-1] == pytest.approx(0.8, abs=0.05)
    np.testing.assert_allclose(block @ [-np.sin(up), np.cos(up)], 0, atol=1e-6)
    assert np.abs(np.diff(way)[-2:]).max() < 1e-4, "at rest: the slope is less than atan(f)"
    # The normal forces at the four corners balance the block's weight across the slope; friction,
    # weight and the cart's push change its momentum along the slope.
    normal, drag = (found.data[f"{kind}_impulse"].sel(scenario=0) for kind in ("normal", "friction"))
    corners = [f"block on slope {i}" for i in range(1, 5)]
    np.testing.assert_allclose(normal.sel(point=corners).sum("point"), h * m * g * np.cos(up), rtol=1e-5)
    assert float(np.abs(drag.sel(point="cart on block")).max()) == 0
    push = normal.sel(point="cart on block").values
    gained = m * np.diff(states(found, "v_block_x", "v_block_y") @ along)
    rubbed = drag.sel(point=corners).sum("point").values
    np.testing.assert_allclose(gained, push - h * m * g * np.sin(up) + rubbed, atol=1e-6)


@pytest.mark.costly
def test_a_block_that_slides_goes_as_one_that_could_turn_and_does_not(tmp_path: Path) -> None:
    """Two models with different contacts have the same optimum."""
    text = (EXAMPLES / "slope.py").read_text()
    inertia = text[text.index("inertia=") : text.index("),", text.index("inertia="))]
    sliding = tmp_path / "sliding.py"
    sliding.write_text(text.replace(inertia, "inertia=None"))
    one, other = solve(str(sliding), contact="exact"), solved("slope")
    assert one.data.sizes["point"] < other.data.sizes["point"]
    assert one.success and one.cost == pytest.approx(other.cost, rel=1e-2)


@pytest.mark.costly
def test_the_double_pendulum_stands_up_and_uses_a_wall() -> None:
    found = solved("double_pendulum_walls", survives=False)
    q = states(found, "upper", "lower")
    assert q[-1] == pytest.approx([np.pi, 0], abs=0.05)
    upper, lower = q[:, 0], q.sum(axis=1)
    elbow = -0.5 * np.sin(upper)
    tip = elbow - 0.5 * np.sin(lower)
    reach = np.abs([elbow, tip]).max(axis=1)
    assert reach.max() == pytest.approx(0.53, abs=1e-6), "a ball of 5 cm at a wall of 0.58 m"
    acts = found.data["active"].sel(scenario=0).sum("interval")
    assert float(acts.sum()) >= 1


@pytest.mark.costly
def test_the_pusher_follows_the_goal_to_the_other_side() -> None:
    curve = import_file(EXAMPLES / "walk_round.py").walk()
    goals = np.array([point.value for point in curve.points])
    for asked in np.linspace(1.0, -1.5, 21):
        assert np.abs(goals - asked).min() < 1e-9
    assert curve.break_reason is None and all(point.solution.success for point in curve.points)
    assert curve.nlp_builds == 2, "either form once"
    for point, side in ((curve.points[0], -1), (curve.points[-1], 1)):
        ox, ax = states(point.solution, "ox", "ax")[-1]
        assert np.sign(ax - ox) == side
        assert ox == pytest.approx(point.value, abs=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("name", SCRIPTS)
def test_a_script_runs_anywhere(name: str, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / f"{name}.py")],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    told = {"walk_round": "goal_x -1.5000", "friction_study": "exact: cost"}
    assert told.get(name, "B-stationary") in done.stdout
    if name != "friction_study":
        return
    assert (tmp_path / "friction.png").stat().st_size > 10_000
    exact, barrier = (xr.load_dataset(tmp_path / f"friction-{law}.nc") for law in ("exact", "barrier"))
    order = exact.sortby("friction")
    assert np.all(np.diff(order.planned) >= 0), "rougher slopes cost more"
    np.testing.assert_allclose(exact.exact, exact.planned, rtol=1e-3)
    assert np.all(barrier.exact > 1.5 * barrier.planned), "the smoothing promises too much"


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_small_and_holds_nothing_of_a_machine(path: Path) -> None:
    notebook = nbformat.read(path, 4)
    nbformat.validate(notebook)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in code] == list(range(1, len(code) + 1))
    assert all(not cell.metadata for cell in code)
    assert set(notebook.metadata) == {"kernelspec", "language_info"}
    text = path.read_text()
    assert len(text) < 120_000
    assert not any(place in text for place in ("/home", "/root", "/tmp", str(ROOT)))


def test_there_are_two_notebooks() -> None:
    assert len(NOTEBOOKS) == 2


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_gives_what_it_shows(path: Path, monkeypatch) -> None:
    """The printed outputs are compared; pictures and tables that contain seconds are not."""
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    shown, fresh = nbformat.read(path, 4), notebooks.execute(path)
    told = ""
    for kept, new in zip(shown.cells, fresh.cells, strict=True):
        assert len(kept.get("outputs", ())) == len(new.get("outputs", ()))
        for old, now in zip(kept.get("outputs", ()), new.get("outputs", ()), strict=True):
            pair = [one.get("text") or one.data["text/plain"] for one in (now, old)]
            assert agrees(*pair), pair
            told += pair[1]
    assert "B-stationary" in told and "survives" in told
