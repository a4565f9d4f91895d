"""Stage functions as compiled C, from the same cache as the batch engine's kernels."""

from __future__ import annotations

import casadi as ca

from dynamics.batch.compiler import CompilerError, load
from ocp.errors import InputError


def compiled_stage(function: ca.Function) -> ca.Function:
    """Return the same function, evaluated by compiled C.

    The object is kept in the user's cache directory by source, compiler and flags, so a second
    solve compiles nothing. Raises :class:`~ocp.errors.InputError` where no compiler is found or it
    fails.
    """
    generator = ca.CodeGenerator(function.name())
    generator.add(function)
    try:
        library = load(generator.dump())
    except CompilerError as error:
        raise InputError(f"compile=true: {error}; leave compile out") from error
    return ca.external(function.name(), library._name)
