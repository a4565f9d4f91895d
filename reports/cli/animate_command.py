"""``ocp animate RUN -o FILE``: the motion of a stored run, plan and replay side by side."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import MISSING, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from reports.cli.options import Command, RunOptions, SourceOptions, option
from reports.cli.output import Output

if TYPE_CHECKING:
    from reports.view import RunView


@dataclass(frozen=True, kw_only=True)
class AnimateOptions(RunOptions, SourceOptions):
    """The run, the file, and the speed."""

    file: Path = option(MISSING, "--output", "-o", help="The .gif, .mp4 or .html file to write.")
    fps: int = option(25, "--fps", min=1, max=100, help="Frames per second.")
    speed: float = option(1.0, "--speed", min=1e-3, max=1e3, help="1 is real time, 0.5 half speed.")
    cones: bool = option(False, "--cones", help="Draw friction cones.")


def check(options: AnimateOptions) -> RunView:
    """Read the run, and check that it can be drawn."""
    from reports.cli.request import check_place
    from reports.cli.runs_command import stored
    from reports.motion.animation import check_drawable, frame_times
    from reports.motion.movie import check_format
    from reports.view import RunView

    check_format(options.file, options.fps)
    check_place(options.file, "animation")
    found = stored(options.run, options.out)
    view = RunView.of(found, options.own([found]))
    check_drawable(view)
    frame_times(float(view.time[-1]), options.fps, options.speed)
    return view


def run(options: AnimateOptions, view: RunView) -> int:
    """Animate a stored run: bodies and contact forces of the plan and of its exact replay."""
    from reports.motion.animation import Animation
    from reports.motion.movie import write
    from reports.style import styled

    output, file = options.output, options.file
    with styled():
        animation = Animation(view, options.fps, options.speed, options.cones)
        with _progress(output, len(animation.times)) as report:
            size = write(animation, file, report)
    output.say(f"animation: {file} ({len(animation.times)} frames)")
    output.document(
        {
            "animation": str(file),
            "run": str(view.run.path),
            "frames": len(animation.times),
            "fps": animation.fps,
            "speed": options.speed,
            "duration_s": float(animation.times[-1]),
            "bytes": size,
            "panels": [motion.title for motion in animation.motions],
        }
    )
    return 0


@contextmanager
def _progress(output: Output, frames: int) -> Iterator[Callable[[int], None]]:
    """Yield a callback for each finished frame: a bar on a terminal, and the check for Ctrl-C."""
    from rich.progress import Progress

    from reports.cli import interrupt

    console = output.console
    hidden = output.quiet or not console.is_terminal
    with Progress(console=console, transient=True, disable=hidden) as bar:
        task = bar.add_task("frames", total=frames)

        def report(done: int) -> None:
            interrupt.check()
            bar.update(task, completed=done)

        yield report


COMMAND = Command(
    AnimateOptions,
    check,
    run,
    examples=(
        "animate @last -o motion.gif",
        "animate push-disc -o push.html --speed 0.5",
    ),
)
