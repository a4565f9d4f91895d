"""``ocp animate``: files from stored runs, and messages where it cannot write them."""

from __future__ import annotations

from pathlib import Path

import pytest
from PIL import Image

from reports.cli.app import main

USER = """
from dataclasses import replace
from problems.library import push_1d

name, title, Params = "bare", "Without a drawing", push_1d.Params


def build(params):
    return replace(push_1d.build(params), name=name)
"""


@pytest.fixture(scope="module")
def store_of_runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a store with one short solve, one continuation, and one solve of a problem without a drawing."""
    root = tmp_path_factory.mktemp("animated")
    (root / "bare.py").write_text(USER)
    for arguments in (
        ["solve", "push-1d", "--contact", "barrier", "-p", "N=6"],
        ["solve", str(root / "bare.py"), "--contact", "barrier", "-p", "N=6"],
        [
            "continue",
            "wall-1d",
            "--contact",
            "barrier",
            "--over",
            "contact.mu",
            "--from",
            "1e-1",
            "--to",
            "1e-2",
            "--scale",
            "log",
            "--steps",
            "2",
        ],
    ):
        assert main([*arguments, "--out", str(root / "runs"), "--quiet"]) == 0
    return root / "runs"


@pytest.mark.costly
def test_a_gif_of_a_stored_run(ocp, store_of_runs: Path) -> None:
    out = ["--out", str(store_of_runs)]
    done = ocp("animate", "push-1d/", "-o", "push.gif", "--fps", "10", "--json", *out)
    assert done.code == 0, done.err
    with Image.open("push.gif") as movie:
        assert movie.n_frames == done.json["frames"] == 7
    assert done.json["duration_s"] == pytest.approx(0.6)
    assert done.json["bytes"] == Path("push.gif").stat().st_size
    assert done.json["panels"] == ["planned under the barrier law", "replayed under the exact law"]
    slow = ocp("animate", "push-1d/", "-o", "s.html", "--fps", "5", "--speed", "0.5", "--json", *out)
    assert slow.json["frames"] == 7
    plain = ocp("animate", "push-1d/", "-o", "again.gif", "--fps", "10", "--quiet", *out)
    assert plain.out == "animation: again.gif (7 frames)\n" and plain.err == ""
    assert Path("again.gif").read_bytes() == Path("push.gif").read_bytes()


@pytest.mark.costly_cases("ending", "ffmpeg", "run")
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["push-1d/", "-o", "x.avi"], ["'.avi'", ".gif, .mp4 or .html", "x.gif"]),
        (["push-1d/", "-o", "x.mp4"], ["ffmpeg", "x.gif or x.html"]),
        (["nothing", "-o", "x.gif"], ["no run 'nothing'"]),
        (["wall-1d/", "-o", "x.gif"], ["run of ocp continue", "ocp solve"]),
        (["bare/", "-o", "x.gif"], ["no drawing", "draw(params, state)"]),
        (["push-1d/"], ["--output"]),
        (["push-1d/", "-o", "x.gif", "--fps", "0"], ["--fps"]),
        (["push-1d/", "-o", "x.gif", "--speed", "0"], ["--speed"]),
        (["push-1d/", "-o", "x.gif", "--speed", "0.001"], ["at most 1500", "--speed"]),
        (["push-1d/", "-o", "x.gif", "--repeat", "2"], ["periodic motions", "drop --repeat"]),
    ],
    ids=[
        "ending",
        "ffmpeg",
        "run",
        "kind",
        "drawing",
        "no file",
        "fps",
        "speed",
        "frames",
        "repeat",
    ],
)
def test_what_it_cannot_do_is_said(
    ocp, store_of_runs: Path, monkeypatch, arguments: list[str], said: list[str]
) -> None:
    monkeypatch.setattr("reports.motion.movie.shutil.which", lambda name: None)
    done = ocp("animate", *arguments, "--out", str(store_of_runs))
    assert done.code == 2
    assert "Traceback" not in done.err and done.out == ""
    assert all(part in done.err for part in said), done.err
    assert not [path for path in Path().iterdir() if path.is_file()]


def test_a_directory_in_the_place_of_the_file(ocp, store_of_runs: Path) -> None:
    Path("taken.gif").mkdir()
    done = ocp("animate", "push-1d/", "-o", "taken.gif", "--out", str(store_of_runs))
    assert done.code == 2 and "is a directory" in done.err
