"""Fixtures that run the program in this process, and stored runs for tests."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from reports.cli.app import main


@dataclass
class Done:
    code: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        return json.loads(self.out)


Ocp = Callable[..., Done]


@pytest.fixture
def ocp(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Ocp:
    """Return a function that runs ``ocp`` with arguments in an empty directory."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments: str) -> Done:
        capsys.readouterr()
        code = main(arguments)
        captured = capsys.readouterr()
        return Done(code, captured.out, captured.err)

    return call


@pytest.fixture(scope="session")
def store_of_runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a store with four solves and one continuation, which tests only read."""
    root = tmp_path_factory.mktemp("store")
    calls = [
        ["solve", "wall-1d", "--contact", "barrier", "-c", "mu=1e-3"],
        ["solve", "push-1d", "--contact", "exact", "--effort", "quick"],
        ["solve", "push-1d", "--contact", "adaptive", "--method", "multiple-shooting"],
        ["solve", "push-disc", "--contact", "barrier", "-p", "scenarios=3", "--policy", "feedback"],
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
            "1e-4",
            "--scale",
            "log",
            "--steps",
            "4",
        ],
    ]
    for arguments in calls:
        assert main([*arguments, "--out", str(root), "--quiet"]) == 0
    return root
