"""Stage functions as compiled C, from the same cache as the batch engine's kernels."""

from __future__ import annotations

import casadi as ca


class StageCompiler:
    """Maps a function to the same one, evaluated by compiled C.

    Objects are kept in the user's cache directory by source, compiler and flags, so a second solve
    compiles nothing. Where there is no compiler, or it fails, functions are given back as they
    are, and ``outcome`` says why.
    """

    def __init__(self) -> None:
        self._reason = ""

    def __call__(self, function: ca.Function) -> ca.Function:
        """Return the compiled function, or ``function`` itself once compiling has failed."""
        from dynamics.batch.engines.compiler import load

        if self._reason:
            return function
        generator = ca.CodeGenerator(function.name())
        generator.add(function)
        try:
            return ca.external(function.name(), load(generator.dump())._name)
        except RuntimeError as error:
            self._reason = str(error).strip().splitlines()[-1]
            return function

    @property
    def outcome(self) -> str:
        """``compiled``, or why functions are interpreted instead."""
        return f"{self._reason}; functions are interpreted" if self._reason else "compiled"
