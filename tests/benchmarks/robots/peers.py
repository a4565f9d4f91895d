"""Measurements of a robot with pin and adam-robotics, in the Python of PEERS=PYTHON.

``python -m venv /tmp/peers; /tmp/peers/bin/pip install pin cmeel-eigen adam-robotics liecasadi``,
then ``make bench-robots PEERS=/tmp/peers/bin/python``. This file runs there, on a URDF that it
takes as its argument, and prints JSON.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

HERE = Path(__file__).parent
BUILT = HERE.parents[2] / "runs" / "bench-robots-pin"
"""Program that is kept from one run to the next, since compiling takes minutes."""
FLAGS = (
    *("-std=c++17", "-O3", "-DNDEBUG", "-march=native"),
    # Flags are those of pin's own build; the wheel's objects have the alignment of SSE2.
    *("-DBOOST_MPL_LIMIT_LIST_SIZE=30", "-DBOOST_MPL_CFG_NO_PREPROCESSED_HEADERS"),
    *("-DBOOST_FUSION_INVOKE_MAX_ARITY=10", "-DFUSION_MAX_VECTOR_SIZE=10"),
    *("-DEIGEN_MAX_STATIC_ALIGN_BYTES=16", "-DEIGEN_MAX_ALIGN_BYTES=16"),
)


def asked(python: str, urdf: Path) -> dict[str, Any]:
    """Run this file by ``python``, and return what it prints."""
    command = [python, __file__, str(urdf)]
    found = subprocess.run(command, capture_output=True, text=True, check=True)
    return json.loads(found.stdout.splitlines()[-1])


def adam(urdf: str) -> dict[str, int]:
    """Return the numbers of CasADi instructions of M, bias and a foot's Jacobian by adam-robotics."""
    from adam.casadi import KinDynComputations  # pyright: ignore

    root = ElementTree.parse(urdf).getroot()
    moving = ("revolute", "continuous", "prismatic")
    joints = [j.get("name") for j in root.findall("joint") if j.get("type") in moving]
    made = KinDynComputations(urdf, joints)
    foot = next(link.get("name") for link in root.findall("link") if "FOOT" in link.get("name", ""))
    functions = {
        "M": made.mass_matrix_fun(),
        "bias": made.bias_force_fun(),
        "J": made.jacobian_fun(foot),
    }
    return {name: function.expand().n_instructions() for name, function in functions.items()}


def pin(urdf: str) -> dict[str, float | str]:
    """Return microseconds of pin's derivatives, in C++ if that compiles, else called from Python."""
    import numpy as np
    import pinocchio  # pyright: ignore

    model = pinocchio.buildModelFromUrdf(urdf, pinocchio.JointModelFreeFlyer())
    prefix = Path(pinocchio.__file__).parents[4]
    BUILT.parent.mkdir(exist_ok=True)
    include, lib, text = prefix / "include", prefix / "lib", f"{BUILT}.txt"
    model.saveToText(text)
    where = [f"-I{include}", f"-I{include / 'eigen3'}", f"-L{lib}", f"-Wl,-rpath,{lib}"]
    libraries = ["-lpinocchio_default", "-lboost_serialization"]
    command = ["g++", *FLAGS, *where, str(HERE / "pin.cpp"), "-o", str(BUILT), *libraries]
    try:
        if not BUILT.exists():
            subprocess.run(command, check=True)
        found = subprocess.run([BUILT, text], check=True, capture_output=True, text=True).stdout
        return {"how": "in C++", **json.loads(found)}
    except (OSError, subprocess.CalledProcessError) as error:
        print(error, file=sys.stderr)
    q = pinocchio.randomConfiguration(model, -np.ones(model.nq), np.ones(model.nq))
    data, v = model.createData(), np.ones(model.nv)
    calls = {
        "rnea": pinocchio.rnea,
        "RNEA derivatives": pinocchio.computeRNEADerivatives,
        "ABA derivatives": pinocchio.computeABADerivatives,
    }
    return {
        "how": "from Python, without second derivatives",
        **{name: least_us(lambda f=f: f(model, data, q, v, v)) for name, f in calls.items()},
    }


def least_us(call: Callable[[], object]) -> float:
    """Return the least processor microseconds of a call."""
    best = 1.0
    for _ in range(60):
        began = time.thread_time()
        for _ in range(100):
            call()
        best = min(best, (time.thread_time() - began) / 100)
    return 1e6 * best


if __name__ == "__main__":
    found: dict[str, Any] = {}
    for peer in (adam, pin):
        try:
            found[peer.__name__] = peer(sys.argv[1])
        except ImportError as error:
            found[peer.__name__] = {"missing": str(error)}
    print(json.dumps(found))
