"""``ocp evaluate RUN``: evaluate a trained policy on new episodes, under any contact law."""

from __future__ import annotations

from typing import Any

from dynamics.contact import ContactLaw
from ocp.effort import check_memory
from ocp.factories import closing_law
from ocp.learning.experiment import Experiment
from ocp.learning.protocol import Trained
from ocp.learning.training import evaluate
from ocp.store.stored_run import StoredRun
from problems.tasks.training import rebuilt
from reports.cli.learning.options import EvaluateOptions
from reports.cli.request import assignments
from reports.trained.judgement import judgement, judgement_table, sentence

EvaluateRequest = tuple[StoredRun, Experiment, Trained, ContactLaw]


def check(options: EvaluateOptions) -> EvaluateRequest:
    """Read the policy, build its task, and make the law."""
    found = options.stored(options.run)
    experiment, policy = rebuilt(found)
    task = experiment.task
    law = closing_law(options.contact, assignments("-c", options.law_settings), task.system)
    numbers = task.horizon * (task.system.nx + task.system.nu)
    check_memory(f"--episodes {options.episodes}", 32.0 * options.episodes * numbers)
    return found, experiment, policy, law


def run(options: EvaluateOptions, request: EvaluateRequest) -> int:
    """Evaluate a trained policy: returns, lengths, measures, and violations in its episodes."""
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
