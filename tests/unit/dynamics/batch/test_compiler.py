"""The compiler and its cache when missing, failing, damaged, shared, or refused."""

from __future__ import annotations

import os
import shutil
import stat
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from dynamics.batch import BatchFunction, BatchWarning, CompilerError
from dynamics.batch.engines import compiler

SOURCE = "long long answer(void) { return %d; }\n"


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch) -> Path:
    """Give the test its own empty cache without loaded objects; return the cache's folder."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(compiler, "_loaded", {})
    return tmp_path / "cache" / "centralpath" / "objects"


@pytest.fixture
def graph() -> ca.Function:
    x = ca.SX.sym("x")
    return ca.Function("graph", [x], [ca.sin(x) + x * x])


def fake_compiler(folder: Path, script: str, monkeypatch) -> None:
    folder.mkdir()
    path = folder / "cc"
    path.write_text(f"#!/bin/sh\n{script}\n")
    path.chmod(0o755)
    monkeypatch.setenv("PATH", str(folder))


def test_object_is_cached_for_the_owner_alone(own_cache):
    assert compiler.load_library(SOURCE % 41).answer() == 41
    (path,) = own_cache.glob("*")
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert stat.S_IMODE(own_cache.stat().st_mode) == 0o700


def test_cached_object_is_not_compiled_again(own_cache, monkeypatch):
    compiler.load_library(SOURCE % 42)
    monkeypatch.setattr(compiler, "_loaded", {})
    monkeypatch.setattr(compiler, "_compile", lambda *_: pytest.fail("compiled again"))
    assert compiler.load_library(SOURCE % 42).answer() == 42


def test_corrupted_object_is_thrown_away_and_compiled_again(own_cache, monkeypatch):
    compiler.load_library(SOURCE % 43)
    (path,) = own_cache.glob("*.so")
    damaged = path.read_bytes()[:-100] + b"x" * 100
    path.unlink()  # writing over a loaded object would damage this very process
    path.write_bytes(damaged)
    monkeypatch.setattr(compiler, "_loaded", {})
    assert compiler.load_library(SOURCE % 43).answer() == 43
    assert len(list(own_cache.glob("*.so"))) == 1


def test_unusable_cache_is_done_without(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("not a folder")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert compiler.cache_directory() is None
    assert compiler.load_library(SOURCE % 44).answer() == 44
    assert compiler.compiler_info()["cache"] is None
    assert compiler.clear_cache() == 0


def test_cache_that_others_may_write_to_is_refused(own_cache):
    own_cache.mkdir(parents=True)
    own_cache.chmod(0o777)
    assert compiler.cache_directory() is None
    assert compiler.load_library(SOURCE % 45).answer() == 45
    assert not list(own_cache.glob("*.so"))


def test_full_disk_is_done_without(own_cache, monkeypatch):
    compile_, refused = compiler._compile, []

    def failing(*arguments):
        if arguments[-1] == own_cache:
            refused.append(1)
            raise OSError("No space left on device")
        return compile_(*arguments)

    monkeypatch.setattr(compiler, "_compile", failing)
    assert compiler.load_library(SOURCE % 46).answer() == 46
    assert refused


def test_no_compiler_falls_back_to_numpy_and_says_so(graph, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    message = r"no C compiler found \(looked for cc, gcc, clang\); 'graph' runs on the numpy"
    with pytest.warns(BatchWarning, match=message):
        f = BatchFunction(graph)
    assert f.backend == "numpy"
    np.testing.assert_allclose(f(np.array([[2.0]])), np.sin(2.0) + 4.0)
    with pytest.raises(CompilerError, match="no C compiler found"):
        BatchFunction(graph, backend="c")
    assert compiler.compiler_info()["compiler"] is None


def test_the_same_reason_is_told_once(graph, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.warns(BatchWarning) as told:
        for _ in range(3):
            BatchFunction(graph)
    assert len(told) == 1


def test_failing_compiler_shows_its_last_line_and_is_passed_over(graph, tmp_path, monkeypatch):
    script = """case "$*" in
      *--version*) echo "cc 0.1" ;;
      *-dM*) echo "#define __SSE2__ 1" ;;
      *) echo "first line" >&2; echo "cc1: out of memory" >&2; exit 1 ;;
    esac"""
    fake_compiler(tmp_path / "bin", script, monkeypatch)
    with pytest.warns(BatchWarning, match=r"cc failed: cc1: out of memory; 'graph' runs on the"):
        assert BatchFunction(graph).backend == "numpy"
    with pytest.raises(CompilerError, match=r"out of memory; use the numpy or auto backend$"):
        BatchFunction(graph, backend="c")


def test_a_broken_compiler_does_not_hide_one_that_works(tmp_path, monkeypatch):
    real = compiler.find_compiler().path
    fake_compiler(tmp_path / "bin", "echo no licence >&2; exit 1", monkeypatch)
    (tmp_path / "bin" / "gcc").symlink_to(real)
    assert compiler.find_compiler().path == str(tmp_path / "bin" / "gcc")


RUBBISH = {
    "text": "echo rubbish > $2",
    "nothing": ":",
    "another function": "echo 'int other(void) { return 0; }' | $REAL -shared -fPIC -xc - -o $2",
}


@pytest.mark.parametrize("made", RUBBISH)
def test_compiler_that_makes_rubbish_is_passed_over(graph, tmp_path, monkeypatch, made, own_cache):
    script = f"""REAL={compiler.find_compiler().path}
    case "$*" in
      *--version*) echo "cc 0.2" ;;
      *-dM*) echo "#define __SSE2__ 1" ;;
      *) while [ "$1" != "-o" ]; do shift; done; {RUBBISH[made]} ;;
    esac"""
    before = os.environ["PATH"]
    fake_compiler(tmp_path / "bin", script, monkeypatch)
    monkeypatch.setenv("PATH", f"{tmp_path / 'bin'}:{before}")
    with pytest.raises(CompilerError, match=r"does not load|produced no object"):
        BatchFunction(graph, backend="c")
    assert not list(own_cache.glob("*.so")), "a mended compiler gets its turn"
    with pytest.warns(BatchWarning, match="'graph' runs on the numpy"):
        assert BatchFunction(graph).backend == "numpy"


def test_compiler_that_hangs_is_ended_with_all_it_started(graph, tmp_path, monkeypatch):
    monkeypatch.setattr(compiler._run, "__defaults__", (0.3,))
    script = """case "$*" in
      *--version*) echo "cc 0.3" ;;
      *-dM*) echo "#define __SSE2__ 1" ;;
      *) /bin/sleep 60 ;;
    esac"""
    fake_compiler(tmp_path / "bin", script, monkeypatch)
    began = time.monotonic()
    with pytest.raises(CompilerError, match=r"cc did not finish within 0.3 s; use the numpy"):
        BatchFunction(graph, backend="c")
    assert time.monotonic() - began < 20, "its child held the pipe open"


def test_without_cache_and_temporary_files_numpy_is_taken(graph, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "gone"))
    compiler._private_directory.cache_clear()
    with pytest.warns(BatchWarning, match=r"produced no object.*'graph' runs on the numpy"):
        assert BatchFunction(graph).backend == "numpy"
    with pytest.raises(CompilerError, match="produced no object"):
        BatchFunction(graph, backend="c")


@pytest.mark.costly
def test_processes_may_compile_the_same_at_once(own_cache):
    load = "from dynamics.batch.engines.compiler import load_library"
    program = f"{load}; assert load_library({SOURCE % 47!r}).answer() == 47"
    racing = [subprocess.Popen([sys.executable, "-c", program]) for _ in range(4)]
    assert [process.wait(timeout=120) for process in racing] == [0, 0, 0, 0]
    assert len(list(own_cache.glob("*.so"))) == 1
    assert not list(own_cache.glob("build-*"))


def test_info_and_clear(own_cache):
    compiler.load_library(SOURCE % 48)
    told = compiler.compiler_info()
    assert told["objects"] == 1
    assert told["cache"] == str(own_cache)
    assert told["width"] in (2, 4, 8)
    assert compiler.clear_cache() == 1
    assert compiler.compiler_info()["objects"] == 0


def slow_compiler(folder: Path, monkeypatch) -> tuple[Path, Path]:
    """Install a compiler that creates one file at its start and waits for another; return both paths."""
    begun, go = folder / "begun", folder / "go"
    real = compiler.find_compiler().path
    script = f"""case "$*" in
      *--version*|*-dM*) exec {real} "$@" ;;
    esac
    /usr/bin/touch {begun}
    while [ ! -e {go} ]; do /bin/sleep 0.02; done
    exec {real} "$@\""""
    fake_compiler(folder / "bin", script, monkeypatch)
    monkeypatch.setenv("PATH", f"{folder / 'bin'}:/usr/bin:/bin")
    return begun, go


def waited_for(place: Path) -> None:
    end = time.monotonic() + 60
    while not place.exists():
        assert time.monotonic() < end
        time.sleep(0.01)


@pytest.mark.parametrize("how", ["clear", "rm"])
def test_what_is_being_compiled_survives_an_emptied_cache(own_cache, tmp_path, monkeypatch, how):
    """`clear` keeps objects in compilation; if their folder is removed, they are compiled again."""
    begun, go = slow_compiler(tmp_path, monkeypatch)
    with ThreadPoolExecutor(1) as pool:
        loaded = pool.submit(compiler.load_library, SOURCE % 49)
        waited_for(begun)
        if how == "clear":
            assert compiler.clear_cache() == 0
        else:
            shutil.rmtree(own_cache)
        go.touch()
        assert loaded.result(60).answer() == 49
    if how == "clear":
        assert [path.suffix for path in own_cache.iterdir()] == [".so"]
        assert compiler.clear_cache() == 1


def test_what_is_cleared_before_it_is_loaded_is_compiled_again(own_cache, monkeypatch):
    compile_ = compiler._compile

    def cleared(*arguments):
        path = compile_(*arguments)
        compiler.clear_cache()
        return path

    monkeypatch.setattr(compiler, "_compile", cleared)
    assert compiler.load_library(SOURCE % 50).answer() == 50


def test_clear_removes_what_a_killed_process_left(own_cache):
    left, young = own_cache / "build-left", own_cache / "build-young"
    for folder in (left, young):
        folder.mkdir(parents=True, mode=0o700)
        (folder / "batch.c").write_text("")
    own_cache.chmod(0o700)
    os.utime(left, times=(0, 0))
    assert compiler.clear_cache() == 0
    assert list(own_cache.iterdir()) == [young]


def test_a_cleared_object_stays_loaded_for_a_solver(own_cache):
    """CasADi loads the object by name, possibly after another process has cleared the cache."""
    from ocp.transcription.nlp import StageCompiler

    x = ca.SX.sym("x")
    function = ca.Function("squared", [x], [x**2])
    load = compiler.load_library

    def cleared(source):
        library = load(source)
        assert compiler.clear_cache() == 1
        return library

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(compiler, "load_library", cleared)
        stages = StageCompiler()
        assert float(stages(function)(3.0)) == 9.0
    assert stages.outcome == "compiled"


@pytest.mark.parametrize("native", [("-march=x86-64",), ("-march=haswell",)])
def test_narrower_cpus_get_the_same_numbers(native, monkeypatch):
    machine = compiler.find_compiler()
    if machine.instruction_set not in ("AVX-512", "AVX2"):
        pytest.skip("this CPU cannot run the narrower code")
    monkeypatch.setattr(compiler, "NATIVE_FLAGS", (native,))
    compiler._probe.cache_clear()
    x = ca.SX.sym("x", 9)
    y = ca.if_else(x > 0, ca.sqrt(ca.fabs(x)), ca.atan2(x, 2)) * ca.exp(x) + ca.floor(x)
    f = ca.Function("f", [x], [y, ca.erf(x) / 3])
    at = np.random.default_rng(0).standard_normal((101, 9))
    got, wanted = BatchFunction(f, backend="c")(at), BatchFunction(f, backend="numpy")(at)
    compiler._probe.cache_clear()
    for one, other in zip(got, wanted, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-14)
