"""Command lines with nonsense and extreme numbers give a finite result or one sentence."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path
from random import Random
from typing import Any

import pytest

from tests.attack import program
from tests.attack.works import furnish

DRAWN = 160
PATIENCE_S = 60.0
MEMORY = 8 << 30
"""Maximum address space [byte] of a command; no small command needs more."""
REFUSED = """\
solve push-1d -p N=1e23
solve push-1d -p N=100000000
solve push-1d -p N=1_0
solve push-1d -p N=१२
solve push-1d -p N=0
solve push-1d -p N=-3
solve push-1d -p N=2.5
solve push-1d -p N=nan
solve push-1d -p M=nan
solve push-1d -p M=inf
solve push-1d -p M=1e400
solve push-1d -p M=-1
solve push-1d -p M=0
solve push-1d -p M=1_000.5
solve push-1d -p nothing=1
solve push-1d -p M
solve push-1d --contact barrier -c mu=nan
solve push-1d --contact barrier -c mu=-1
solve push-1d --contact barrier -c mu=inf
solve push-1d -s tol=1e10 -s dual_inf_tol=1e10 -s compl_inf_tol=1e10
solve push-1d -s tol=0
solve push-1d -s tol=nan
solve push-1d -s factor=0.999999
solve push-1d -s factor=1
solve push-1d -s factor=0
solve push-1d -s max_iter=1e300
solve push-1d --seed -1
solve push-1d --starts 0
solve push-1d --starts 1000000000
solve push-disc --policy feedback -p scenarios=100000000
solve push-1d --contact randomized -c samples=1e12
solve push-1d --contact nothing
solve nothing
solve
continue wall-1d --contact barrier --over contact.mu --from 1 --to 1e-300 --scale linear -p N=nan
continue wall-1d --over nothing --from 1 --to 2
continue wall-1d --over m --from nan --to 2
continue wall-1d --over m --from 1 --to inf
continue wall-1d --over m --from 1 --to -1
continue wall-1d --contact barrier --over contact.mu --from 0 --to 1 --scale log
continue wall-1d --contact barrier --over contact.mu --from 1 --to 2 --steps 1000000000
estimate heaviside --sweep nu=0.1:1:1e9
estimate heaviside --sweep sigma=0.1:1:0
estimate heaviside --sweep sigma=1:nan:3
estimate heaviside --sweep sigma=0:1:3:log
estimate heaviside -n 1e300
estimate heaviside -n nan
estimate heaviside -n 0
estimate heaviside -n 1.5
estimate heaviside --sigma -1
estimate heaviside --sigma nan
estimate heaviside --sigma inf
estimate heaviside --threads 0
estimate heaviside --threads 1000000
estimate heaviside --estimators nothing
estimate push-1d -p N=3 -n 10 --at nothing
sweep push-1d --over M=1:2:1e9
sweep push-1d --contact barrier --over M=1:2:1000000 --over mu=1:2:100000
sweep push-1d --over M=1:2:-1
sweep push-1d --over M=1:2:2 -j 0
sweep push-1d --over M=nan:2:2
train ball-throw --iterations 0
train ball-throw --seeds 1000000
train ball-throw -s samples=1e12
train ball-throw -s samples=0
train ball-throw -s hidden=100000,100000
train ball-throw -p horizon=1e12
collect push-1d --samples 1e300 -o data.nc
collect push-1d --samples 0 -o data.nc
collect push-1d --samples nan -o data.nc
figure A2v -p first=3
figure nothing
figure P2 -p nothing=1
animate @5 -o motion.html --fps 1000000
animate @5 -o motion.html --speed 0
animate @5 -o motion.nothing
runs @999999999
runs @0
runs --since yesterday
runs -n 0
runs rm nothing
runs rm ..
runs rm /
runs export @1 -o out.nothing
report nothing -o out.pdf
replay @5 --contact nothing
replay @5 -c mu=nan
export push-1d -o out.c -p N=1e99
evaluate @5
show nothing
show ../../etc/passwd
settings nothing
laws nothing
nothing
--nothing
"""
"""Options that must be rejected with exit code 2, whatever else is in the command line."""
FINITE = """\
solve push-1d -p N=4 --json -s print_level=5
solve push-1d -p N=4 --json --solver uno
solve push-1d -p N=4 --json --solver fatrop
solve push-1d -p N=4 --json --solver sleqp
solve push-1d -p N=4 --json -p M=1e-300
solve push-1d -p N=4 --json -p M=1e300
solve push-1d -p N=4 --json -p M=1e-3 -p goal_x=1e308
solve wall-1d -p N=4 --json --contact barrier -c mu=1e-300
solve wall-1d -p N=4 --json --contact barrier -c mu=1e300
continue wall-1d -p N=3 --over m --from 1 --to 1e-300 --steps 3 --json
continue wall-1d --contact barrier -p N=3 --over mu --from 1 --to 1e-99 --scale log --steps 3 --json
estimate belt-block --sigma 1e308 -n 100 --json
estimate heaviside --sigma 1e308 -n 100 --json
estimate heaviside --sigma 1e-308 -n 100 --json
estimate heaviside -n 1 --json
estimate push-1d -p N=3 -n 2 --sigma 1e200 --json
sweep push-1d -p N=3 --over M=1e-300:1e300:3:log --json
train ball-throw --iterations 1 -s samples=2 -s unroll=2 -s rate=1e300 -p horizon=3 -j 1 --json
replay @5 -c mu=1e-300 --json
list --json
runs --json
laws --json
settings --json
doctor --json
"""
"""Command lines that print one JSON document, without NaN and infinity if they report success."""
NUMBERS = (
    "0",
    "-0.0",
    "-1",
    "1",
    "1e-323",
    "1e-300",
    "1e-12",
    "1e12",
    "1e23",
    "1e300",
    "1e308",
    "1e400",
    "nan",
    "inf",
    "-inf",
    "1_0",
    "0x10",
    "१२",
    "1e",
    "",
    " 1",
    "1,5",
    "1/3",
    "true",
    "None",
    "9" * 400,
    "2147483648",
    "9223372036854775808",
    "-9223372036854775809",
    "0.1",
    "3",
)


@pytest.fixture(scope="module")
def shop(servers, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return furnish(servers[0], tmp_path_factory.mktemp("shop"))


def test_nonsense_is_refused(shop, tally, side_by_side, tmp_path) -> None:
    lines = [line.split(" ") for line in REFUSED.splitlines()]
    account = tally(
        "Nonsense is refused with exit code 2, and before it costs memory or time.",
        f"{len(lines)} command lines of impossible numbers, sizes and names, in {MEMORY >> 30} GB",
        81,
    )

    def attack(server, line: list[str]) -> None:
        limits = {"RLIMIT_AS": MEMORY}
        end = server.run(line, shop, patience=PATIENCE_S, limits=limits)
        found = program.faults(end, expected=(2,))
        if end.code == 2 and end.err.count("\n") > 2:
            found.append(("no sentence", end.line))
        if end.code == 2 and end.seconds > PATIENCE_S / 3:
            found.append(("late", f"{end.line} after {end.seconds:.0f} s"))
        account.count(found)

    side_by_side(attack, lines)


def test_json_is_json_and_finite(shop, tally, side_by_side, tmp_path) -> None:
    lines = [line.split() for line in FINITE.splitlines()]
    account = tally(
        "`--json` prints one JSON document and nothing else; what is not finite is no success.",
        f"{len(lines)} commands at extreme numbers and with solvers that print",
        84,
    )
    side_by_side(lambda server, line: account.count(json_of(server, line, shop)), lines)


def json_of(server, line: list[str], place: Path) -> list[tuple[str, str]]:
    """Return the faults in the JSON of a command."""
    end = server.run(line, place, patience=PATIENCE_S, limits={"RLIMIT_AS": MEMORY})
    found = program.faults(end, expected=(0, 2, 3))
    if end.code in (0, 3):
        try:
            document = json.loads(end.out, parse_constant=lambda word: math.nan)
        except ValueError as error:
            return [*found, ("no JSON", f"{end.line}: {error}: {end.out[:80]!r}")]
        if end.code == 0 and not_finite(document):
            found.append(("nonsense accepted", f"{end.line}: NaN or infinity, exit 0"))
        if end.code == 0 and (why := nonsense(document)):
            found.append(("nonsense accepted", f"{end.line}: {why}"))
    return found


def nonsense(value: Any) -> str:
    """Return a text on a success in a document without a finite number, or an empty one."""
    if isinstance(value, list):
        return next(filter(None, map(nonsense, value)), "")
    if not isinstance(value, dict):
        return ""
    if value.get("success") is True and value.get("cost", 0.0) is None:
        return "success without a finite cost"
    verdict = str(value.get("verdict"))
    if verdict.startswith("unbiased") and not value.get("variance", 1.0):
        return "unbiased at a variance of zero, or of none"
    return nonsense(list(value.values()))


def not_finite(value: Any) -> bool:
    """Return whether a document contains NaN or infinity."""
    if isinstance(value, dict):
        return any(not_finite(one) for one in value.values())
    if isinstance(value, list):
        return any(not_finite(one) for one in value)
    return isinstance(value, float) and not math.isfinite(value)


def drawn(dice: Random) -> list[str]:
    """Draw a command line with one or two extreme numbers."""

    def odd() -> str:
        free = f"{dice.choice([-1, 1]) * 10 ** dice.uniform(-320, 308):.6g}"
        return dice.choice((*NUMBERS, free))

    small = {
        "solve push-1d": [
            "-p N={}",
            "-p M={}",
            "-p goal_x={}",
            "-p h={}",
            "-c mu={}",
            "--seed {}",
            "--starts {}",
            "-s max_iter={}",
            "-s factor={}",
            "-s homotopy_start={}",
            "-s tol={}",
        ],
        "solve wall-1d --contact adaptive": ["-p N={}", "-c sigma={}", "-p m={}", "-p h={}"],
        "solve wall-1d --contact randomized -c samples=8": ["-c samples={}", "-c sigma={}", "-c seed={}"],
        "continue wall-1d --contact barrier -p N=3 --over mu --from 1 --to 1e-2 --steps 3": [
            "--from {}",
            "--to {}",
            "--steps {}",
            "-p N={}",
            "-p m={}",
        ],
        "estimate heaviside -n 100": [
            "-n {}",
            "--sigma {}",
            "--seed {}",
            "--sweep sigma={}:1:3",
            "--sweep sigma=0.1:1:{}",
            "--reference-samples {}",
        ],
        "estimate push-1d -p N=3 -n 20": ["-n {}", "--sigma {}", "-p N={}", "--threads {}", "-p M={}"],
        "sweep push-1d -p N=3 --over M=1:2:2": ["--over h={}:0.1:2", "-p N={}", "-j {}", "--starts {}"],
        "train ball-throw --iterations 1 -s samples=2 -s unroll=2 -p horizon=3 -j 1": [
            "--iterations {}",
            "-s samples={}",
            "-s unroll={}",
            "-s rate={}",
            "-s hidden={}",
            "-p horizon={}",
            "-s episodes={}",
            "--seed {}",
        ],
        "collect push-1d --samples 10 -o data.nc": ["--samples {}", "--seed {}", "-p M={}"],
        "replay @5": ["-c mu={}", "-c sigma={}"],
        "animate @5 -o motion.html": ["--fps {}", "--speed {}"],
    }
    head = dice.choice(sorted(small))
    words = head.split()
    if words[0] == "solve":
        words += ["-p", "N=4"]
    for option in dice.sample(small[head], min(len(small[head]), dice.choice((1, 1, 2)))):
        flag, _, form = option.partition(" ")
        if flag.startswith("--") and flag in words:
            at = words.index(flag)
            del words[at : at + 2]
        if flag == "-p" and form.startswith("N=") and "N=4" in words:
            del words[-2:]
        words += [flag, form.format(odd())]
    return [*words, "--json"]


def test_drawn_numbers(shop, tally, side_by_side, dice: Random, tmp_path) -> None:
    account = tally(
        "Nonsense is refused with exit code 2, and before it costs memory or time.",
        f"{DRAWN} drawn command lines of twelve kinds with extreme numbers",
        83,
    )
    lines = [drawn(dice) for _ in range(DRAWN)]

    def attack(server, item) -> None:
        at, line = item
        here = shutil.copytree(shop, tmp_path / str(at)) if "@5" in line else tmp_path
        account.count(json_of(server, line, here))

    side_by_side(attack, list(enumerate(lines)))
