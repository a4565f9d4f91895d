"""LLVM backend: the kernels and loops of backend `c`, for machines without a compiler.

`llvmlite`, an extra of this package, brings LLVM along. Where the system has glibc's vector math
library its functions are used, else those of C's library, lane by lane.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import importlib.util
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from dynamics.batch import compiler
from dynamics.batch.backends import MissingExtra
from dynamics.batch.c_flat import CompiledEngine
from dynamics.batch.compiler import CompilerError, vector_math
from dynamics.batch.rollout_engines import CompiledRolloutEngine
from dynamics.batch.rollout_tapes import RolloutTapes
from dynamics.batch.tape import Tape

if TYPE_CHECKING:
    from llvmlite import ir

    from dynamics.batch.llvm_vectors import Machine

# CPU features, doubles a register, and how the vector math library mangles for it.
_SIMD = (
    ({"avx512f", "avx512dq"}, 8, "_ZGVeN8"),
    ({"avx2"}, 4, "_ZGVdN4"),
    ({"avx"}, 4, "_ZGVcN4"),
    ({"sse2"}, 2, "_ZGVbN2"),
    ({"neon"}, 2, "_ZGVnN2"),
)
_OPTIMISATION = 2


def llvm_engine(tape: Tape, threads: int) -> CompiledEngine:
    """The engine of backend `llvm`. Raises `MissingExtra` where llvmlite is not installed."""
    _need_llvmlite()
    from dynamics.batch import llvm_flat

    return CompiledEngine("llvm", tape, threads, load(llvm_flat.module(tape, machine())))


def llvm_rollout_engine(tapes: RolloutTapes, threads: int, block: int) -> CompiledRolloutEngine:
    """The engine of rollouts. Raises `MissingExtra` where llvmlite is not installed."""
    _need_llvmlite()
    from dynamics.batch import llvm_rollout

    run = load(llvm_rollout.module(tapes, block, machine()))
    return CompiledRolloutEngine(tapes.nu, threads, lambda own_p: run)


def info() -> dict[str, object] | None:
    """What `ocp doctor` shows: llvmlite's version and doubles a register, None without llvmlite."""
    if not _has_llvmlite():
        return None
    return {"llvmlite": version("llvmlite"), "width": machine().width}


def _has_llvmlite() -> bool:
    return importlib.util.find_spec("llvmlite") is not None


def _need_llvmlite() -> None:
    if not _has_llvmlite():
        raise MissingExtra(
            "backend 'llvm' needs llvmlite, which is not installed: pip install 'centralpath[llvm]'"
        )


@functools.cache
def machine() -> Machine:
    """What LLVM tells of this CPU."""
    from llvmlite import binding

    from dynamics.batch.llvm_vectors import Machine

    features = {name for name, has in binding.get_host_cpu_features().items() if has}
    for needed, width, mangling in _SIMD:
        if needed <= features:
            fma = bool({"fma", "neon"} & features)
            return Machine(width, fma, vector_math(mangling))
    return Machine(2, False, {})


@functools.cache
def _target() -> Any:
    from llvmlite import binding

    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    return binding.Target.from_default_triple()


def load(module: ir.Module) -> Any:
    """The function `run` of a module as machine code, for ctypes; it owns that code.

    Takes the code from the cache of compiled objects, or compiles it and leaves it there. Raises
    `CompilerError` where LLVM finds fault with the module, in one line.
    """
    from llvmlite import binding

    cpu, features = binding.get_host_cpu_name(), binding.get_host_cpu_features().flatten()
    machine = _target().create_target_machine(
        cpu=cpu, features=features, opt=_OPTIMISATION, jit=True
    )
    text = str(module)
    versions = version("llvmlite"), binding.llvm_version_info, _OPTIMISATION
    identity = "\n".join((*map(str, versions), machine.triple, cpu, features, text))
    key = hashlib.sha256(identity.encode()).hexdigest()[:32]
    _provide_symbols()
    try:
        code = compiler.kept(key)
        if code is None:
            code = _compile(text, machine)
            compiler.keep(key, code)
        engine = binding.create_mcjit_compiler(binding.parse_assembly(""), machine)
        engine.add_object_file(binding.ObjectFileRef.from_data(code))
        engine.finalize_object()
    except RuntimeError as error:
        raise CompilerError(f"LLVM failed: {str(error).strip().splitlines()[-1]}") from error
    run: Any = ctypes.CFUNCTYPE(ctypes.c_int64)(engine.get_function_address("run"))
    run.engine = engine
    return run


def _compile(text: str, machine: Any) -> bytes:
    from llvmlite import binding

    parsed = binding.parse_assembly(text)
    parsed.verify()
    options = binding.create_pipeline_tuning_options(_OPTIMISATION)
    builder = binding.create_pass_builder(machine, options)
    builder.getModulePassManager().run(parsed, builder)
    return machine.emit_object(parsed)


@functools.cache
def _provide_symbols() -> None:
    """Make the vector library's functions known to LLVM, which looks in this process alone."""
    from llvmlite import binding

    symbols = machine().vector_math.values()
    if symbols:
        library = ctypes.CDLL("libmvec.so.1")
        for symbol in symbols:
            address = ctypes.cast(getattr(library, symbol), ctypes.c_void_p).value
            binding.add_symbol(symbol, address)
