"""``ocp evaluate RUN``: evaluate a trained policy on new episodes, under any contact law."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from reports.cli.options import Command, LawOptions, RunOptions, option

if TYPE_CHECKING:
    from dynamics.contact import ContactLaw
    from ocp.learning.experiment import Experiment
    from ocp.learning.protocol import Trained
    from ocp.store.stored_run import StoredRun

    EvaluateRequest = tuple[StoredRun, Experiment, Trained, ContactLaw]


@dataclass(frozen=True, kw_only=True)
class EvaluateOptions(RunOptions, LawOptions):
    """The policy, the law, and the number of episodes."""

    contact: str = option("exact", "--contact", help="Contact law; list with ocp laws.")
    episodes: int = option(
        100, "--episodes", "-n", min=1, max=1_000_000, help="Number of episodes."
    )
    seed: int = option(0, "--seed", min=0, help="Seed of the initial states.")


def check(options: EvaluateOptions) -> EvaluateRequest:
    """Read the policy, build its task, and make the law."""
    from ocp.effort import check_memory
    from problems.tasks.training import rebuilt
    from reports.cli.request import closing_law
    from reports.cli.runs_command import stored

    found = stored(options.run, options.out)
    experiment, policy = rebuilt(found)
    task = experiment.task
    law = closing_law(options.contact, options.law_settings, task.system)
    numbers = task.horizon * (task.system.nx + task.system.nu)
    check_memory(f"--episodes {options.episodes}", 32.0 * options.episodes * numbers)
    return found, experiment, policy, law


def run(options: EvaluateOptions, request: EvaluateRequest) -> int:
    """Evaluate a trained policy: returns, lengths, measures, and violations in its episodes.

    The initial states differ from those of every training; the same seed gives the same episodes.
    """
    from ocp.learning.evaluation import evaluate
    from reports.trained.judgement import judgement, judgement_table, sentence

    found, experiment, policy, law = request
    seen = evaluate(experiment, policy, law, options.episodes, options.seed)
    content: dict[str, Any] = {
        "run": str(found.path),
        "task": experiment.task.name,
        "contact": law.name,
        "contact_settings": law.settings(),
        "seed": options.seed,
        **judgement(experiment.task, seen),
        "own": found.meta["evaluation"],
    }
    content["verdict"] = sentence(content)
    output = options.output
    output.say(content["verdict"])
    output.note(judgement_table(content))
    output.document(content)
    return 0


COMMAND = Command(
    EvaluateOptions,
    check,
    run,
    examples=(
        "evaluate @last",
        "evaluate @last --contact barrier -c mu=1e-3 --episodes 1000",
    ),
)
