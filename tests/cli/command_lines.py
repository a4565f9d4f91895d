"""Hypothesis strategies for command lines that are mostly valid and sometimes odd."""

from __future__ import annotations

from hypothesis import strategies as st

LONG = "a" * 5000
ODD_NUMBERS = (
    "nan",
    "inf",
    "-inf",
    "1e400",
    "1e308",
    "-1e308",
    "1e-320",
    "1e300",
    "1e19",
    "1e30",
    "-1",
    "0",
    "1.5",
    "abc",
    "",
    " ",
    "1/0",
    "0x10",
    "1_000",
    "१२",
    "1e",
    "--",
    "None",
    "true",
    "100000000",
    "999999999999999999999999",
)
ODD_WORDS = (
    "",
    " ",
    LONG,
    "nope",
    "--help",
    "-",
    "a=b",
    "=",
    "a b",
    "naïve",
    "\udcff",
    ".",
    "%s",
    "{}",
    "None",
    "0",
    "\n",
    "\t",
    "exact ",
    "EXACT",
)
odd = st.sampled_from(ODD_NUMBERS + ODD_WORDS) | st.text(
    st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=8
)

PROBLEMS = ("wall-1d", "push-1d", "push-disc")
OBJECTIVES = ("heaviside", "coulomb", "belt-block", "ball-wall")
LAWS = ("exact", "barrier", "adaptive", "randomized")


def among(*words: str) -> st.SearchStrategy[str]:
    """Return a strategy for one of ``words``, or for odd text in one case of six."""
    return st.integers(0, 5).flatmap(lambda n: odd if n == 5 else st.sampled_from(words))


def number(*words: str) -> st.SearchStrategy[str]:
    """Return a strategy for one of ``words``, or for an odd number in one case of six."""
    few = st.sampled_from(ODD_NUMBERS) | st.floats().map(repr) | st.integers().map(str)
    return st.integers(0, 5).flatmap(lambda n: few if n == 5 else st.sampled_from(words))


def setting(**values: tuple[str, ...]) -> st.SearchStrategy[str]:
    """Return a strategy for ``name=value``, or for odd text in one case of ten."""
    sound = st.sampled_from(sorted(values)).flatmap(
        lambda name: number(*values[name]).map(lambda value: f"{name.replace('__', '.')}={value}")
    )
    return st.integers(0, 9).flatmap(lambda n: odd if n == 9 else sound)


Options = dict[str, st.SearchStrategy[str] | None]
COMMON: Options = {"--json": None, "--quiet": None}
STORE: Options = {"--out": among("runs", "store", "deep/er"), "-v": None}
LAW: Options = {
    "--contact": among(*LAWS),
    "-c": setting(
        mu=("1e-3", "1"),
        kappa=("10",),
        sigma=("0.1",),
        samples=("8",),
        seed=("3",),
        base=("barrier",),
        base__mu=("1e-2",),
        law=("gaussian", "quartic"),
        gradient=("total",),
        scheme=("sobol", "gauss-hermite"),
        noise=("input", "state"),
    ),
}
PROBLEM: Options = {
    "--tag": among("paper", "two words"),
    "-p": setting(N=("5", "8"), h=("0.1",), m=("2",), goal_x=("0.5",), M=("2",), scenarios=("3",)),
    "--policy": among("open-loop", "feedback"),
    "--seed": number("0", "7"),
    "--pdf": among("a.pdf", "new/b.pdf"),
}
SOLVER: Options = {
    "-s": setting(
        max_iter=("5", "50"),
        tol=("1e-8",),
        homotopy=("true", "false"),
        strategy=("l1",),
        factor=("0.3",),
        start=("0.1",),
        jit=("false",),
        policy__penalty=("1e-3",),
        policy__stationary=("true",),
        linear_solver=("mumps",),
        mu_init=("1e-2",),
        dual_inf_tol=("1e-5",),
        compl_inf_tol=("1e-9",),
        print_user_options=("no",),
    ),
    "--method": among("direct", "multiple-shooting", "single-shooting"),
    "--solver": among("ipopt", "ipopt", "fatrop", "uno", "sleqp"),
}
COMMANDS: dict[str, tuple[st.SearchStrategy[list[str]], Options]] = {
    "list": (st.just([]), {}),
    "show": (among(*PROBLEMS, *OBJECTIVES, "@data", "none.nc").map(lambda name: [name]), {}),
    "runs": (
        st.just([]) | among("@solve", "@train", "wall", "@last").map(lambda run: [run]),
        {
            **STORE,
            "--tag": among("a"),
            "--since": among("2h", "2026-01-01"),
            "--last": number("2"),
            "--status": among("solved"),
            "--contact": among(*LAWS),
            "--problem": among(*PROBLEMS),
        },
    ),
    "runs rm": (among("@solve", "@last", "@3", "none").map(lambda run: [run]), STORE),
    "runs export": (
        st.tuples(among("@solve", "@continue", "@train"), among("a.csv", "b.npz", "c.x")).map(
            lambda t: [t[0], "-o", t[1]]
        ),
        {**STORE, "--format": among("csv", "npz")},
    ),
    "settings": (st.just([]) | among("ipopt", "fopg", "sigma").map(lambda word: [word]), {}),
    "doctor": (st.just([]), {}),
    "solve": (
        among(*PROBLEMS).map(lambda name: [name]),
        {
            **STORE,
            **LAW,
            **PROBLEM,
            **SOLVER,
            "--starts": number("1", "2", "3"),
            "--rank": among("planned", "referee"),
            "--require": among("survives"),
            "--until": among("survives"),
            "--from": among("@solve", "@continue"),
        },
    ),
    "continue": (
        st.tuples(
            among(*PROBLEMS),
            among("contact.mu", "goal_x", "m"),
            number("1", "0.5"),
            number("1e-2", "0.1"),
        ).map(lambda t: [t[0], "--over", t[1], "--from", t[2], "--to", t[3]]),
        {
            **STORE,
            **LAW,
            **PROBLEM,
            **SOLVER,
            "--steps": number("2", "10"),
            "--scale": among("log", "linear"),
        },
    ),
    "estimate": (
        among(*PROBLEMS, *OBJECTIVES).map(lambda name: [name]),
        {
            **STORE,
            **LAW,
            **PROBLEM,
            "-s": setting(
                alpha__gamma=("0.1",),
                policy__stationary=("true",),
                alpha__delta=("0.05",),
                policy__penalty=("1",),
            ),
            "--estimators": among("zobg", "fobg,zobg", "alpha", "zobg,fobg,alpha", "es"),
            "-n": number("100", "1e4", "1e19", "1e300"),
            "--sigma": number("0.1", "1e-3"),
            "--sweep": among(
                "sigma=0.01:1:3",
                "samples=10:100:2",
                "contact.mu=1e-3:1:3:log",
                "N=2:4:3",
                "nu=0.1:1:2",
                "samples=2:3:1e30",
                "N=1:1e9:3",
                "sigma=1e-320:1:2",
            ),
            "--reference": among("auto", "closed-form", "quadrature", "zobg", "none"),
            "--reference-samples": number("100", "1e5"),
            "--at": among("@solve", "@continue"),
            "--backend": among("auto", "numpy", "casadi"),
            "--threads": number("1", "2"),
        },
    ),
    "mpc": (
        among("wall-1d", "push-1d").map(lambda name: [name]),
        {
            **STORE,
            **LAW,
            "-p": PROBLEM["-p"],
            "--seed": number("0", "7"),
            "--pdf": among("a.pdf", "new/b.pdf"),
            "--tag": among("paper", "two words"),
            "--phase": among("qpcc", "qp", "relaxed", "policy", "full"),
            "--plant": among("exact", "noise", "referee", "h/4", "mujoco"),
            "--steps": number("2", "5"),
            "--rate": number("100", "1e6"),
            "--iterations": number("1", "2"),
            "--trust": number("0.5", "1"),
            "--deadline": number("1e-3"),
            "--noise-state": number("0.01") | setting(q=("0.1",)),
            "--noise-input": number("0.01"),
            "--mismatch": setting(m=("2",), M=("2",)),
            "--delay": None,
            "--push": among("1:q=0.1", "1:x=0.1", "9:x=1", "x:1"),
            "--seeds": number("1", "2"),
            "--certify": number("1", "2"),
        },
    ),
    "replay": (
        among("@solve", "@continue", "@train").map(lambda run: [run]),
        {**STORE, **LAW, "--world": among("mujoco", "moon")},
    ),
    "report": (
        st.tuples(
            st.lists(among("@solve", "@continue", "@train"), min_size=1, max_size=2),
            among("a.pdf", "new/b.pdf"),
        ).map(lambda t: [*t[0], "-o", t[1]]),
        STORE,
    ),
    "animate": (
        st.tuples(among("@solve", "@continue", "@train"), among("a.gif", "a.html", "a.mp4")).map(
            lambda t: [t[0], "-o", t[1]]
        ),
        {**STORE, "--fps": number("5", "25"), "--speed": number("1", "4")},
    ),
    "export": (
        st.tuples(among(*PROBLEMS, "@solve", "@continue", "heaviside"), among("a.c", "new/b.c")).map(
            lambda t: [t[0], "-o", t[1]]
        ),
        {**STORE, **LAW, "-p": PROBLEM["-p"]},
    ),
    "collect": (
        st.tuples(among(*PROBLEMS, "heaviside"), among("a.nc", "new/b.nc")).map(lambda t: [t[0], "-o", t[1]]),
        {
            "-p": PROBLEM["-p"],
            "--samples": number("100", "1e3", "1e30"),
            "--seed": number("0", "3"),
        },
    ),
    "learn": (
        st.tuples(
            among("@data", "none.nc", "own.csv"),
            among("ewda", "ewda", "mlp"),
            among("a.nc", "new/b.nc"),
        ).map(lambda t: [t[0], "--model", t[1], "-o", t[2]]),
        {
            "--noise": number("0.2", "1"),
            "--hidden": among("8", "4,4", "8,x"),
            "--epochs": number("1", "2"),
            "--seed": number("0", "3"),
            "--problem": among("push-1d", "wall-1d"),
            "--columns": among("qu=a,qa=b"),
        },
    ),
    "train": (
        among("ball-throw", "ball-throw", "hopper", "wall-1d").map(lambda task: [task]),
        {
            **STORE,
            **LAW,
            "-p": setting(h=("0.02",), horizon=("5",), m=("2",), spheres=("foot",)),
            "-a": among("fopg", "ars", "zopg,ars", "aobg", "total-propagation", "fopg,fopg", "mbpo"),
            "-s": setting(
                hidden=("affine", "open-loop", "4", "4,x"),
                samples=("2", "4"),
                unroll=("3",),
                rate=("0.1",),
                sigma=("0.1",),
                discount=("0.9", "1.1"),
                episodes=("2",),
                ars__top=("1", "99"),
                evaluate_every=("1",),
                normalise=("false",),
            ),
            "--iterations": number("1", "2"),
            "--seeds": number("1", "2"),
            "--jobs": number("1"),
            "--seed": number("0", "7"),
            "--scheduler": among("nowhere", "tcp://"),
            "--pdf": among("a.pdf", "new/b.pdf"),
        },
    ),
    "evaluate": (
        among("@train", "@solve", "ball").map(lambda run: [run]),
        {**STORE, **LAW, "--episodes": number("1", "3"), "--seed": number("0", "3")},
    ),
    "gradients": (
        among("two-balls", "corner", "nowhere", "new/bad.py").map(lambda name: [name]),
        {
            **STORE,
            "--world": among("exact", "closed-form", "penalty", "nobody"),
            "-s": setting(h=("0.02",), stiffness=("1e3",), mu=("1e-4",)),
            "-n": number("20", "1e19"),
            "--tolerance": number("0.1", "2"),
            "--refinements": number("0", "1"),
            "--parameter": number("0", "1"),
            "--component": number("0", "1"),
            "--seed": number("0", "3"),
            "--pdf": among("a.pdf", "new/b.pdf"),
        },
    ),
    "figure": (
        among("P6", "p1", "N2", "T1").map(lambda name: [name]) | st.just([]),
        {
            **STORE,
            "--all": None,
            "--seed": number("0", "3"),
            "-p": setting(sigma=("0.1",), samples=("100",), n=("10",), seed=("1",)),
        },
    ),
}
OFTEN = (*COMMANDS, *3 * ("solve", "estimate"), "continue", "replay")
"""Names of the commands, repeated according to how much can go wrong in them."""


@st.composite
def lines(draw: st.DrawFn, commands: tuple[str, ...] = OFTEN) -> list[str]:
    """Draw a command line, in which ``@solve``, ``@continue``, ``@train`` stand for runs and ``@data`` for data."""
    name = draw(st.sampled_from(commands))
    words, options = draw(COMMANDS[name][0]), {**COMMANDS[name][1], **COMMON}
    given = draw(st.lists(st.sampled_from(sorted(options)), max_size=5))
    if draw(st.integers(0, 9)) < 9:
        # An option given twice is rejected at once, which would hide everything else.
        given = [flag for i, flag in enumerate(given) if flag in "-p-c-s" or flag not in given[:i]]
    line = [*name.split(), *words]
    for flag in given:
        value = options[flag]
        line += [flag] if value is None else [flag, draw(value)]
    if draw(st.integers(0, 19)) == 0:
        line.insert(draw(st.integers(0, len(line))), draw(odd))
    return line
