"""Robustness of result folders: attacks on a small study with the tests' fake engine.

It writes research/data/reliability.json.

    python bench/reliability.py                              # minutes FLIPS=100000 KILLS=500 FUZZ=5000 python
    bench/reliability.py    # hours

A folder survives an attack if its rows are the same, or one line says what is wrong. A silent failure is one in which
rows differ and nothing says so; otherwise the attack ended in a traceback.
"""

import contextlib
import io
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import shared

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
import fake_engine  # pyright: ignore
from small_study import STUDY, content, start  # pyright: ignore

from sweep.cli.main import main
from sweep.core.errors import Fault, InputError
from sweep.runs import manifest, repair, runner, store

FLIPS, CUTS, KILLS, RELABELS, FUZZ, CONDITIONS, WORKERS = (
    int(os.environ.get(name, default))
    for name, default in (
        ("FLIPS", 5000),
        ("CUTS", 500),
        ("KILLS", 20),
        ("RELABELS", 40),
        ("FUZZ", 300),
        ("CONDITIONS", 2000),
        ("WORKERS", 2),
    )
)
SURVIVED, SILENT, TRACEBACK = "survived", "silent", "tracebacks"
Attack = Callable[[Path, random.Random], Iterator[str]]


def run_attack(work: Callable[[], bool]) -> str:
    """Return how an attack went; `work` returns whether everything is as it should be."""
    try:
        return SURVIVED if work() else SILENT
    except (InputError, Fault) as error:
        return SURVIVED if "\n" not in str(error) else TRACEBACK
    except Exception:
        return TRACEBACK


def quiet(*args: str) -> tuple[int, str]:
    """Return exit code and standard error of a command in this process."""
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()) as error:
        code = main(list(args))
    return code, error.getvalue()


def files(folder: Path) -> list[Path]:
    """Return all files that rows are read from."""
    named = [folder / name for name in (store.STUDY_FILE, store.POINTS_FILE, manifest.MANIFEST_FILE)]
    return named + [folder / entry.file for entry in store.list_current_parts(folder)]


def damage(folder: Path, chance: random.Random, number: int, change: Callable[[bytes], bytes]) -> Iterator[str]:
    """Yield results for files changed by `change`, one at a time."""
    rows, plan, places = content(folder), store.read_points(folder), files(folder)
    for _ in range(number):
        path = chance.choice(places)
        sound = path.read_bytes()
        path.write_bytes(change(sound))
        yield run_attack(lambda: content(folder).equals(rows) and store.read_points(folder).equals(plan))
        path.write_bytes(sound)


def flips(folder: Path, chance: random.Random) -> Iterator[str]:
    """Yield results of single flipped bits."""

    def flipped(content: bytes) -> bytes:
        bit = chance.randrange(8 * len(content))
        return content[: bit // 8] + bytes([content[bit // 8] ^ 1 << bit % 8]) + content[bit // 8 + 1 :]

    yield from damage(folder, chance, FLIPS, flipped)


def cuts(folder: Path, chance: random.Random) -> Iterator[str]:
    """Yield results of truncated files, or of a block of zeros as after a power cut.

    A manifest cut between two lines is an earlier manifest.
    """

    def cut(content: bytes) -> bytes:
        at = chance.randrange(len(content) - 1)
        return content[:at].rstrip(b"\n") if chance.random() < 0.5 else content[:at] + bytes(len(content) - at)

    yield from damage(folder, chance, CUTS, cut)


def kills(folder: Path, chance: random.Random) -> Iterator[str]:
    """Yield results of `kill -9` of `sweep run` at any moment, and the same command again."""
    rows = content(folder)
    for number in range(KILLS):
        killed = folder.with_name(f"killed{number}")
        process = start(killed, FAKE_SECONDS="0.05")
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.communicate(timeout=chance.uniform(1, 8))
        process.send_signal(signal.SIGKILL)
        process.communicate()
        yield run_attack(
            lambda killed=killed: quiet("run", *STUDY, f"out={killed}")[0] == 0 and content(killed).equals(rows)
        )


def relabels(folder: Path, chance: random.Random) -> Iterator[str]:
    """Yield results of `sweep relabel` ended before one of its writes: all rows use the new thresholds, or none."""
    for _ in range(RELABELS):
        limit, left = chance.uniform(0.02, 1.0), chance.randrange(12)
        real = store.write_part, store.write_study, repair.remove_parts

        def dying(work: Callable[..., Any]) -> Callable[..., Any]:
            def write(*args: Any) -> Any:
                nonlocal left
                left -= 1
                if left < 0:
                    raise KeyboardInterrupt
                return work(*args)

            return write

        store.write_part, store.write_study, repair.remove_parts = map(dying, real)
        quiet("relabel", str(folder), f"slip_max_m<{limit}", "tilt_max_deg<50")
        store.write_part, store.write_study, repair.remove_parts = real
        named = store.read_study(folder)["config"]["outcome"]
        yield run_attack(lambda named=named: is_judged_by(folder, named))


def is_judged_by(folder: Path, thresholds: dict[str, Any]) -> bool:
    """Return whether all rows are judged by `thresholds`; at first there is none on slip."""
    rows, slip = content(folder), thresholds["slip_max_m"]
    good = (rows["slip_max_m"] <= (float("inf") if slip is None else slip)) & (
        rows["tilt_max_deg"] <= thresholds["tilt_max_deg"]
    )
    return bool(((rows["outcome"] == "success") == good).all())


def stale(folder: Path, chance: random.Random) -> Iterator[str]:
    """Yield results of a worker whose command is dead, and which writes its part after another command relabelled."""
    code, real = runner.provenance.code_version(), runner._read_job
    for number in range(6):
        out = folder.with_name(f"stale{number}")
        shutil.copytree(folder, out)
        for entry in store.list_current_parts(out)[number + 1 :]:
            (out / entry.file).unlink()
        known = real(out.resolve(), "old")
        quiet("run", *STUDY, "--limit", str(8 * (number + 1)), f"out={out}", "outcome.slip_max_m=0.1")
        runner._read_job = lambda *_, known=known: known  # pyright: ignore
        runner.simulate_on_worker(out.resolve(), "old", code, chance.randrange(number + 1, 7))
        runner._read_job = real
        quiet("run", *STUDY, f"out={out}", "outcome.slip_max_m=0.1")
        yield run_attack(
            lambda out=out: is_judged_by(out, {"slip_max_m": 0.1, "tilt_max_deg": 30}) and len(content(out)) == 56
        )


# fmt: off
KEYS = (
    "contact.friction", "robot.shin", "engine.width", "engine.iterations", "study.name", "study.replicates", "study",
    "study.where", "study.resolution", "cluster", "robot", "scenario", "study.axes.f", "study.design.num", "foo.bar",
    "noise.delay", "drive.stiffness", "obstacle", "outcome.slip_max_m",
)
VALUES = (
    "0", "-1", "1e400", "-1e-320", "nan", "null", "true", "''", "..", "[]", "[1,2]", "{}", "{path: ''}", "9" * 400,
    "{path: contact.friction, values: [a, 1]}", "{path: robot, from: 0, to: 1, num: 2}", "${x.y}", "${oc.env:HOME}",
    "{path: contact.friction, from: 0, to: 1, num: 1000000000}", "1/0", "a/b", "\u00e4", "{a: {b: {c: 1}}}",
)
WORDS = (
    "friction", "outcome", "replicate", "1", "0", "1e400", "'success'", "9" * 50, "(", ")", "[", "]", ",", "+", "-",
    "*", "/", "not", "and", "or", "in", "==", "<", "sqrt", ".", "lambda", "x", "{}", "|", "&", "\n", "[0]*400000000",
)
# fmt: on


def settings(folder: Path, chance: random.Random) -> Iterator[str]:
    """Yield results of configurations with random keys and values, which run or are refused in one line."""
    for _ in range(FUZZ):
        some = [chance.choice(("", "", "+", "++", "~")) + chance.choice(KEYS) for _ in range(chance.randint(1, 3))]
        args = [key if key[0] == "~" else f"{key}={chance.choice(VALUES)}" for key in some]
        yield run_attack(lambda args=args: ended_as_documented(*quiet("run", "--dry-run", f"out={folder}-fuzz", *args)))


def conditions(folder: Path, chance: random.Random) -> Iterator[str]:
    """Yield results of conditions made of random words."""
    for _ in range(CONDITIONS):
        where = " ".join(chance.choices(WORDS, k=chance.randint(1, 9)))
        yield run_attack(
            lambda where=where: ended_as_documented(*quiet("table", str(folder), "--format", "csv", "--where", where))
        )


def ended_as_documented(code: int, error: str) -> bool:
    """Return whether a command ended as the documentation says."""
    if code == 2 and error.count("\n") != 1:
        raise RuntimeError(error)
    return code in (0, 2, 3, 4)


def workers(folder: Path, chance: random.Random) -> Iterator[str]:
    """Yield results of a Dask worker killed within a batch."""
    import psutil

    rows = content(folder)
    for number in range(WORKERS):
        out = folder.with_name(f"workers{number}")
        process = start(out, "cluster=dask_local", "cluster.workers=2", FAKE_SECONDS="0.5")
        time.sleep(chance.uniform(8, 14))
        for child in psutil.Process(process.pid).children(recursive=True) if process.poll() is None else ():
            if "spawn_main" in "".join(child.cmdline()):
                child.kill()
                break
        _, error = process.communicate()
        yield run_attack(lambda out=out, error=error: "Traceback" not in error and content(out).equals(rows))


ATTACKS: dict[str, Attack] = {
    "a bit of any file flipped": flips,
    "a file cut short or zeroed": cuts,
    "`kill -9` of a run": kills,
    "a relabelling ended": relabels,
    "a worker of a dead command": stale,
    "absurd configurations": settings,
    "absurd conditions": conditions,
    "a Dask worker killed": workers,
}


def measure() -> None:
    """Print and write one line for each attack."""
    fake_engine.install()
    start, lines = time.perf_counter(), [["attack", "tried", SURVIVED, SILENT, TRACEBACK]]
    for name, attack in ATTACKS.items():
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place) / "study"
            quiet("run", *STUDY, f"out={folder}")
            counts = Counter(attack(folder, random.Random(0)))
        lines.append([name, *(f"{count:,}" for count in (counts.total(), *(counts[how] for how in lines[0][2:])))])
        print(*lines[-1], flush=True)
    shared.write_tables("reliability", (), start, {"attacks": lines})


if __name__ == "__main__":
    measure()
