"""``ocp animate RUN -o FILE``: the motion of a stored run, plan beside replay."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from reports.cli.common import Debug, Json, Out, Output, Quiet


def run(
    run: Annotated[str, typer.Argument(help="A run: its path, or part of its name.")],
    file: Annotated[
        Path, typer.Option("--output", "-o", help="The .gif, .mp4 or .html file to write.")
    ],
    fps: Annotated[int, typer.Option("--fps", min=1, max=100, help="Frames a second.")] = 25,
    speed: Annotated[
        float, typer.Option("--speed", min=1e-3, max=1e3, help="1 is real time, 0.5 half as fast.")
    ] = 1.0,
    out: Out = Path("runs"),
    as_json: Json = False,
    quiet: Quiet = False,
    debug: Debug = False,
) -> int:
    """Animate a stored run: bodies, contact forces and cones, the plan beside its exact replay."""
    from ocp import store
    from reports.animation import Animation
    from reports.cli.request import check_place
    from reports.cli.runs_command import find
    from reports.movie import check_format, playable, write
    from reports.style import styled
    from reports.view import RunView

    check_format(file)
    check_place(file, "animation")
    stored = store.load(find(run, out))
    output = Output(as_json, quiet)
    with styled():
        animation = Animation(RunView.of(stored), playable(fps, file), speed)
        with _progress(output, len(animation.times)) as told:
            write(animation, file, told)
    output.say(f"animation: {file} ({len(animation.times)} frames)")
    output.document(
        {
            "animation": str(file),
            "run": str(stored.path),
            "frames": len(animation.times),
            "fps": animation.fps,
            "speed": speed,
            "duration_s": float(animation.times[-1]),
            "bytes": file.stat().st_size,
            "panels": [motion.title for motion in animation.motions],
        }
    )
    return 0


@contextmanager
def _progress(output: Output, frames: int) -> Iterator[Callable[[int], None]]:
    """Yield what is called after each frame: a bar on a terminal; Ctrl-C is noticed there too."""
    from rich.progress import Progress

    from reports.cli import interrupt

    console = output.console
    hidden = output.quiet or not console.is_terminal
    with Progress(console=console, transient=True, disable=hidden) as bar:
        task = bar.add_task("frames", total=frames)

        def told(done: int) -> None:
            interrupt.check()
            bar.update(task, completed=done)

        yield told
