"""What can go wrong on the user's side, each with a sentence and an exit code."""

from __future__ import annotations


class InputError(ValueError):
    """Wrong usage: the message says what was wrong, what was expected and how to mend it."""

    exit_code = 2


class NotConverged(RuntimeError):
    """A solve or a rollout that did not reach its tolerance; the message says where."""

    exit_code = 3


class DamagedRun(RuntimeError):
    """A run directory that cannot be read back; the message names the file and the reason."""

    exit_code = 4
