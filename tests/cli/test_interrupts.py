"""Ctrl-C ends a command soon, whatever compiles: its exit code is 130, and the same command finishes the rest."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from sweep.cli.main import main
from sweep.runs import store

ROOT = Path(__file__).parents[2]
BLOCK = """
import ctypes, pathlib, subprocess, sys
sys.path.insert(0, {root!r})
libc = ctypes.CDLL(None)

def block(*_, **__):  # in C, where neither an exception nor another thread ends it
    pathlib.Path({began!r}).touch()
    mutex = ctypes.create_string_buffer(128)
    while True:
        libc.pthread_mutex_lock(mutex)

def block_in_child(*_, **__):
    code = "import signal, time; signal.signal(2, signal.SIG_IGN); time.sleep(60)"
    child = subprocess.Popen([sys.executable, "-c", code])
    pathlib.Path({began!r}).write_text(str(child.pid))
    block()

"""
COMPILERS = {
    "llvm": "import sweep.fused.llvm; sweep.fused.llvm.compile_llvm_assembly = block",
    "xla": "import jax; jax.stages.Lowered.compile = block",
    "child": "import sweep.fused.llvm; sweep.fused.llvm.compile_llvm_assembly = block_in_child",
}
RUN = ["run", "scenario=walk_tripod", "manoeuvre.steps=1", "+study.axes={m:{path:robot.body_mass,values:[14,15]}}"]


def has_ended(process: int) -> bool:
    """Whether a process is gone, or a zombie that nobody has waited for."""
    stat = Path(f"/proc/{process}/stat")
    return not stat.exists() or stat.read_text().rpartition(")")[2].split()[0] in "ZX"


@pytest.mark.parametrize("compiler", COMPILERS)
def test_an_interrupt_while_compiling_ends_the_command_within_two_seconds(tmp_path, monkeypatch, compiler):
    folder, began = tmp_path / "out", tmp_path / "began"
    given = [*RUN, "study.name=masses", f"out={folder}", f"engine.compiler={'xla' if compiler == 'xla' else 'fused'}"]
    text = BLOCK.format(root=str(ROOT), began=str(began)) + COMPILERS[compiler]
    code = f"{text}\nfrom sweep.cli.main import main\nsys.argv[1:] = {given!r}\nsys.exit(main())"
    env = {**os.environ, "XDG_CACHE_HOME": str(tmp_path / "cache")}
    process = subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.PIPE, text=True, env=env)
    while not began.exists():
        assert process.poll() is None, process.communicate()[1]
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    start = time.monotonic()
    _, error = process.communicate(timeout=30)
    assert time.monotonic() - start < 2
    assert process.returncode == 130, error
    assert error.count("interrupted; finished rollouts are kept, repeat the command") == 1
    if compiler == "child":
        assert has_ended(int(began.read_text()))
    assert not [path for path in tmp_path.rglob(".tmp-*") if path.is_file()]
    if compiler == "llvm":
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
        assert main(given) == 0
        assert len(store.read_rows(folder)) == 2
