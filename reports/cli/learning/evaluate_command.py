"""``ocp evaluate RUN``: a trained policy judged on fresh episodes, under any contact law."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from reports.cli.options import Command, LawOptions, RunOptions, option

if TYPE_CHECKING:
    from dynamics.contact import ContactLaw
    from ocp.learning.experiment import Experiment
    from ocp.learning.protocol import Trained
    from ocp.store.stored_run import StoredRun

    Asked = tuple[StoredRun, Experiment, Trained, ContactLaw]


@dataclass(frozen=True, kw_only=True)
class EvaluateOptions(RunOptions, LawOptions):
    """Which policy, under which law, over how many episodes."""

    contact: str = option("exact", "--contact", help="Contact law; ocp list shows them.")
    episodes: int = option(100, "--episodes", "-n", min=1, max=1_000_000, help="How many.")
    seed: int = option(0, "--seed", min=0, help="Seed of the first states.")


def check(options: EvaluateOptions) -> Asked:
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


def run(options: EvaluateOptions, asked: Asked) -> int:
    """Judge a trained policy: return, lengths, measures, and what is wrong with its episodes.

    The seed of the first states is no seed of a training; the same seed gives the same episodes.
    """
    from ocp.learning.evaluation import evaluate
    from reports.trained.judgement import judgement, judgement_table, sentence

    found, experiment, policy, law = asked
    seen = evaluate(experiment, policy, law, options.episodes, options.seed)
    told: dict[str, Any] = {
        "run": str(found.path),
        "task": experiment.task.name,
        "contact": law.name,
        "contact_settings": law.settings(),
        "seed": options.seed,
        **judgement(experiment.task, seen),
        "own": found.meta["evaluation"],
    }
    told["verdict"] = sentence(told)
    output = options.output
    output.say(told["verdict"])
    output.note(judgement_table(told))
    output.document(told)
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
