"""Many samples at once: CasADi graphs over arrays, compiled where there is a compiler."""

from dynamics.batch.compiler import CompilerError
from dynamics.batch.function import BatchFunction
from dynamics.batch.nonfinite import BatchWarning, NonFinite
from dynamics.batch.tape import UnsupportedOperation

__all__ = ["BatchFunction", "BatchWarning", "CompilerError", "NonFinite", "UnsupportedOperation"]
