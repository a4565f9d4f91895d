"""Fixtures of attacks, which are seeded, counted, and run two at a time."""

from __future__ import annotations

import os
import random
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Protocol

import pytest

from tests.attack.forked import Server
from tests.attack.ledger import Tally

SEED = int(os.environ.get("ATTACK_SEED", "14"))
AT_A_TIME = 2


class Opened(Protocol):
    def __call__(self, promise: str, attack: str, order: int) -> Tally: ...


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark all tests of this folder as attacks, which only ``make test-attack`` runs."""
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.attack)


def pytest_report_header() -> str:
    return f"attacks: ATTACK_SEED={SEED}"


@pytest.fixture
def dice(request: pytest.FixtureRequest) -> random.Random:
    """Return the random generator of one attack, which depends on ATTACK_SEED and the test's name."""
    return random.Random(f"{SEED} {request.node.name}")


@pytest.fixture
def tally(request: pytest.FixtureRequest) -> Iterator[Opened]:
    """Yield a function that opens the tally of an attack; store the counts, and fail if there are faults."""
    opened: list[Tally] = []

    def open_account(promise: str, attack: str, order: int) -> Tally:
        file, test = Path(request.node.path).name, request.node.originalname
        command = f"{file} -k {test}"
        account = Tally(request.node.name, promise, attack, order, command)
        opened.append(account)
        return account

    yield open_account
    for account in opened:
        account.keep(SEED)
        print(f"{account.name}: {account.attempts} attempts, {len(account.faults)} faults")
        assert account.attempts, "an attack that attempted nothing proves nothing"
        assert not account.faults, account.told()


@pytest.fixture(scope="session")
def servers() -> Iterator[list[Server]]:
    """Yield servers that fork the program, one for each attack that runs at a time."""
    ready = [Server() for _ in range(AT_A_TIME)]
    yield ready
    for server in ready:
        server.close()


@pytest.fixture
def side_by_side(servers: list[Server]) -> Callable[..., list[Any]]:
    """Return a function that calls ``attack(server, item)`` for every item, two at a time, and returns the results."""

    def attack_all(attack: Callable[[Server, Any], Any], items: Iterable[Any]) -> list[Any]:
        free = list(servers)

        def one(item: Any) -> Any:
            server = free.pop()
            try:
                return attack(server, item)
            finally:
                free.append(server)

        with ThreadPoolExecutor(AT_A_TIME) as pool:
            return list(pool.map(one, items))

    return attack_all
