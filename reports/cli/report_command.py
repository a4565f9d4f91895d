"""``ocp report`` and ``ocp animate``: a PDF of stored runs, and an animation of one."""

from __future__ import annotations

from rich.progress import Progress

from ocp.errors import InputError
from ocp.store.stored_run import StoredRun
from problems.spec import ProblemSpec
from reports.cli import interrupt
from reports.cli.options.output import AnimateOptions, ReportOptions
from reports.cli.request import check_output_file
from reports.documents.pdf import write_pdf
from reports.drawing.style import house_style
from reports.drawing.view import RunView
from reports.motion.animation import Animation, check_drawable, frame_times, is_periodic, repeated
from reports.motion.movie import check_format, write_animation


def check_report(options: ReportOptions) -> tuple[list[StoredRun], ProblemSpec | None]:
    """Return the runs, and the problem of ``--source`` (None without it)."""
    check_output_file(options.pdf, "PDF")
    runs = [options.stored(text) for text in options.runs]
    return runs, options.problem_from_source(runs)


def run_report(options: ReportOptions, request: tuple[list[StoredRun], ProblemSpec | None]) -> int:
    """Write the PDF report of the runs."""
    runs, file_spec = request
    write_pdf(runs, options.pdf, options.cones, file_spec, options.signals)
    options.output.say(f"PDF: {options.pdf}")
    options.output.document({"pdf": str(options.pdf), "runs": [str(item.path) for item in runs]})
    return 0


def check_animate(options: AnimateOptions) -> RunView:
    """Return the view of the run, after checks that it can be drawn and the animation can be written."""
    check_format(options.file, options.fps)
    check_output_file(options.file, "animation")
    stored_run = options.stored(options.run)
    view = RunView.of(stored_run, options.problem_from_source([stored_run]))
    check_drawable(view)
    if options.repeat > 1:
        if not is_periodic(view):
            raise InputError(
                f"--repeat is for periodic motions; {view.run.meta['problem']} does not end as it"
                " began, so drop --repeat"
            )
        view = repeated(view, options.repeat)
    frame_times(float(view.time[-1]), options.fps, options.speed)
    return view


def run_animate(options: AnimateOptions, view: RunView) -> int:
    """Write the animation, with a progress bar on a terminal and a check for Ctrl-C after each frame."""
    output, file = options.output, options.file
    hidden = output.quiet or not output.console.is_terminal
    with house_style(), Progress(console=output.console, transient=True, disable=hidden) as bar:
        animation = Animation(view, options.fps, options.speed, options.cones)
        task = bar.add_task("frames", total=len(animation.times))

        def report(done: int) -> None:
            interrupt.raise_if_interrupted()
            bar.update(task, completed=done)

        size = write_animation(animation, file, report)
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
