"""The player's page: it has the run's data, loads nothing else, and plays in a browser."""

from __future__ import annotations

import html
import json
import math
import re
import shutil
import subprocess
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from PIL import Image

from dynamics.contact import Barrier
from ocp import solve, store
from ocp.labelled import LabelledArrays
from ocp.store.stored_run import StoredRun
from problems import drawing, get
from problems.tasks import registry as tasks
from reports.drawing.view import RunView
from reports.motion.animation import Animation
from reports.motion.movie import write_animation
from reports.motion.player import cumulative_cost, player_data, player_page
from tests.unit.reports.made import sliding_box

N = 4
NORMAL = np.array([[1.0, 2.0], [0.0, 0.0], [4.0, 1.0], [1.0, 1.0]])
SLIP = 0.4 * NORMAL
VIEW = sliding_box(NORMAL, SLIP)
BROWSER = shutil.which("chromium") or shutil.which("chromium-browser")
browsing = pytest.mark.skipif(BROWSER is None, reason="there is no chromium")


def data_of(page: str) -> dict:
    """Return the data of a page, as a browser reads them."""
    (found,) = re.findall(r'<script id="film" type="application/json">(.*?)</script>', page, re.S)
    return json.loads(found)


@pytest.fixture(scope="module")
def solved(tmp_path_factory: pytest.TempPathFactory) -> RunView:
    root = tmp_path_factory.mktemp("runs")
    solution = solve(get("push-1d", N=8), contact=Barrier(mu=1e-2))
    return RunView.of(store.load(store.save(solution, root, []).path))


def test_shapes_of_the_page_are_those_of_the_stored_states(solved: RunView) -> None:
    h = float(solved.time[1])
    film = data_of(player_page(Animation(solved, fps=round(1 / h))))
    np.testing.assert_allclose(film["times"], solved.time, rtol=1e-6)
    spec = solved.spec
    assert spec is not None and spec.draw is not None
    for motion, name in zip(film["motions"], ("x", "x_replay"), strict=True):
        x = solved.array(name)
        assert x is not None and len(motion["frames"]) == len(x[0]) == 9
        for frame, state in zip(motion["frames"], x[0], strict=True):
            told = []
            for kind, *numbers in [*motion["fixed"], *frame]:
                form, role = film["kinds"][kind]
                names = [part.name for part in fields(getattr(drawing, form)) if part.name != "role"]
                told.append((form, role, dict(zip(names, numbers, strict=True))))
            for shape in spec.draw(solved.params, state):
                same = [
                    values
                    for form, role, values in told
                    if form == type(shape).__name__
                    and role == shape.role
                    and all(abs(getattr(shape, k) - v) <= 1e-5 for k, v in values.items())
                ]
                assert same, shape


def test_arrows_and_curves_of_the_page_are_the_stored_impulses() -> None:
    film = player_data(Animation(VIEW, fps=10))
    assert film["nodes"] == pytest.approx(VIEW.time)
    force = np.hypot(NORMAL, SLIP)
    for motion, share in zip(film["motions"], (1, 0.5), strict=True):
        assert motion["arrows"][0] == [], "no step has led to the start"
        for step in range(N):
            sizes = [math.hypot(*arrow[2:4]) for arrow in motion["arrows"][step + 1]]
            assert sizes == pytest.approx([f * share for f in force[step] if f > 0], rel=1e-6)
    planned, replayed = film["charts"]
    for chart, share in ((planned, 1), (replayed, 0.5)):
        assert [curve["name"] for curve in chart["curves"]] == ["heel", "toe"]
        for curve, expected in zip(chart["curves"], force.T, strict=True):
            np.testing.assert_allclose(curve["values"], share * expected, rtol=1e-6)
    assert planned["range"] == replayed["range"] and planned["range"][1] > force.max()
    assert planned["label"] == "impulse [N s]"
    assert [planned["title"], replayed["title"]] == [
        "contact impulses, planned",
        "contact impulses, replayed",
    ]


def test_costs_add_up_to_what_the_solution_says(solved: RunView) -> None:
    paid, end = cumulative_cost(solved, "") or (np.zeros(0), 0)
    assert paid[0] == 0 and len(paid) == 9
    assert end == pytest.approx(solved.run.meta["cost"], rel=1e-9)
    again = cumulative_cost(solved, "_replay")
    assert again is not None
    assert again[1] == pytest.approx(solved.run.audit.exact_cost, rel=1e-9)
    cost = player_data(Animation(solved))["charts"][-1]
    assert [curve["name"] for curve in cost["curves"]] == ["planned", "replayed"]
    assert cost["curves"][0]["end"] == pytest.approx(end, rel=1e-6)


@pytest.mark.parametrize("steps", [2, 50])
def test_rewards_add_up_step_by_step(steps: int) -> None:
    """An episode of ball-throw has 50 steps, and only a complete one has the final reward."""
    spec = tasks.spec("ball-throw")
    params = spec.params({})
    task = spec.build(params)
    rng, p = np.random.default_rng(1), task.parameters.values
    x = rng.standard_normal((1, steps + 1, task.system.nx))
    u = rng.standard_normal((1, steps, task.system.nu))
    dims = {"x": ("scenario", "node", "state"), "u": ("scenario", "interval", "control")}
    data = xr.Dataset({"x": (dims["x"], x), "u": (dims["u"], u)})
    view = RunView(StoredRun(Path("runs/ball"), LabelledArrays.of(data), {"kind": "train"}), spec, params, task)
    rewards = [float(task.rewards(x[0, k], u[0, k], x[0, k + 1], p)) for k in range(steps)]
    gained, end = cumulative_cost(view, "") or (np.zeros(0), 0)
    np.testing.assert_allclose(gained, np.cumsum([0, *rewards]), atol=1e-12)
    final = float(task.finals(x[0, -1], p))
    assert final < -0.1
    assert end == pytest.approx(gained[-1] + (final if steps == 50 else 0))


def test_what_never_moves_is_told_once_and_a_still_camera_too() -> None:
    film = player_data(Animation(VIEW, fps=20))
    assert film["kinds"] == [("Wall", "environment"), ("Rectangle", "object")]
    for motion in film["motions"]:
        assert motion["fixed"] == [[0, 0.0, 0.0, 0.0, 1.0]]
        assert [len(frame) for frame in motion["frames"]] == [1] * 9
        assert len(motion["middle"]) == 1


def test_a_page_asks_nobody_for_anything_is_small_and_never_varies(tmp_path: Path) -> None:
    for name in ("a.html", "b.html"):
        write_animation(Animation(sliding_box(np.ones((50, 2)), np.ones((50, 2)), h=0.04)), tmp_path / name)
    text = (tmp_path / "a.html").read_text()
    assert text.startswith("<!doctype html>") and len(text) < 60_000
    assert len(data_of(text)["times"]) == 51
    assert not re.search(r"https?:|//\w+\.|<link|@import|url\(|src=|\bfetch\(|data:", text)
    assert (tmp_path / "b.html").read_text() == text


def test_names_cannot_break_out_of_the_page() -> None:
    nasty = "</script><script>alert(1)</script> & <b>"
    view = sliding_box(NORMAL, SLIP)
    view.run.meta["record"]["contact"] = view.run.meta["verdict"] = nasty
    text = player_page(Animation(view))
    assert text.count("</script>") == 2 and text.count("<script") == 2 and "<b>" not in text
    assert data_of(text)["motions"][0]["title"] == f"planned under the {nasty} law"
    assert html.escape(nasty) in text


def browsed(page: str, room: Path, *options: str) -> str:
    """Return the output of headless Chromium for a page."""
    asked = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"]
    place = ["--window-size=1000,900", f"--user-data-dir={room / 'profile'}"]
    done = subprocess.run(
        [str(BROWSER), *asked, *place, *options, page],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    return done.stdout


DRIVEN = """<script>
"use strict";
const told = [];
window.onerror = (text) => told.push(["error", text]);
const say = (what) => told.push([what, now, byId("clock").value, Number(byId("scrub").value)]);
say("start");
byId("on").click(); say("on");
byId("scrub").value = 3; byId("scrub").dispatchEvent(new Event("input")); say("scrub");
byId("back").click(); say("back");
document.dispatchEvent(new KeyboardEvent("keydown", { key: "End" })); say("end");
byId("on").click(); say("past the end");
byId("play").click(); say(byId("play").getAttribute("aria-label"));
setTimeout(() => {
  say(byId("play").getAttribute("aria-label"));
  make("pre", document.body, JSON.stringify(told)).id = "told";
}, 1500);
</script>"""


@browsing
@pytest.mark.slow
def test_a_browser_scrubs_steps_and_plays(tmp_path: Path) -> None:
    page = tmp_path / "box.html"
    write_animation(Animation(VIEW, fps=10), page)
    page.write_text(page.read_text().replace("</body>", f"{DRIVEN}</body>"))
    dumped = browsed(page.as_uri(), tmp_path, "--virtual-time-budget=4000", "--dump-dom")
    (told,) = re.findall(r'<pre id="told">(.*?)</pre>', dumped)
    steps = json.loads(html.unescape(told))
    assert [step[:2] for step in steps] == [
        ["start", 0],
        ["on", 1],
        ["scrub", 3],
        ["back", 2],
        ["end", 4],
        ["past the end", 4],
        ["pause", 0],
        ["play", 4],
    ]
    assert [step[3] for step in steps] == [step[1] for step in steps]
    assert steps[2][2] == "t = 0.30 s"
    assert 'data-frame="4"' in dumped


@browsing
@pytest.mark.slow
def test_a_screenshot_shows_the_box_where_its_state_says(tmp_path: Path) -> None:
    """The columns of the plan's picture in the body's colour move to the right with the box."""
    page, middles = tmp_path / "box.html", []
    write_animation(Animation(VIEW, fps=10), page)
    for frame in (0, 2, 4):
        shot = tmp_path / f"{frame}.png"
        browsed(f"{page.as_uri()}#{frame}", tmp_path, f"--screenshot={shot}")
        with Image.open(shot) as picture:
            plan = np.asarray(picture.convert("RGB"), dtype=int)[:380]
        # The colour is a quarter of the bodies' blue on white paper.
        body = np.abs(plan - (191, 220, 236)).max(axis=-1) < 6
        columns = np.flatnonzero(body.sum(axis=0) > 3)
        middles.append((columns.min() + columns.max()) / 2)
    assert middles[1] - middles[0] == pytest.approx(middles[2] - middles[1], abs=4)
    assert middles[2] - middles[0] > 300
