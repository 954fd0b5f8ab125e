"""Where batches are simulated: in this process, or by Dask workers on this machine, at an address, or as Slurm jobs.

A cluster hands out the numbers of batches; all else is in the study's folder, which workers read and write themselves.
What it starts talks by TLS with keys of its own, as whoever reaches a Dask scheduler can run code on all its workers.
"""

import logging
import math
import os
import signal
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, field
from functools import cache, partial
from importlib import import_module
from typing import Any, ClassVar

from sweep.core.errors import Fault, InputError
from sweep.core.interrupts import patient_exit
from sweep.core.parameters import choice, count

Work = Callable[[int], Any]
Dispatch = Callable[[Work, Iterable[int]], Iterator[Any]]  # results in the order in which they are ready


@dataclass
class WorkerStatus:
    """What is seen of the workers meanwhile."""

    on_message: Callable[[str], None]  # what a user should know, in one line
    workers: int | None = None  # alive; None where there are none but this process


@dataclass(frozen=True)
class Local:
    """In this process, one batch after the other, each on all its devices."""

    is_remote: ClassVar[bool] = False  # whether workers have other devices than this machine
    kind: str = choice("local", "local")

    def connect(self, _: WorkerStatus) -> AbstractContextManager[Dispatch]:
        """The built-in `map` takes a batch when the one before is done."""
        return nullcontext(map)


@dataclass(frozen=True)
class DaskLocal:
    """Worker processes on this machine."""

    is_remote: ClassVar[bool] = False
    kind: str = choice("dask_local", "dask_local")
    workers: int = count(2, at_least=1)  # processes, each of which simulates one batch at a time

    @contextmanager
    def connect(self, status: WorkerStatus) -> Iterator[Dispatch]:
        """Start the workers; a lost one is started again."""
        distributed = _dask("distributed", self.kind)
        from tornado.ioloop import PeriodicCallback

        options = {"n_workers": self.workers, "threads_per_worker": 1, "memory_limit": 0, "security": _security()}
        with distributed.LocalCluster(**options, **QUIET) as cluster, distributed.Client(cluster) as client:
            client.register_worker_callbacks(setup=_ignore_interrupt)
            # Dask starts a lost worker again, but not one that is lost before it has said that it started
            mend = PeriodicCallback(lambda: cluster.scale(self.workers), MEND)
            cluster.loop.add_callback(mend.start)
            try:
                yield partial(_distribute, client, status)
            finally:
                cluster.loop.add_callback(mend.stop)


@dataclass(frozen=True)
class DaskAddress:
    """Workers of a Dask scheduler that runs already; they need this package and the study's folder under its path."""

    is_remote: ClassVar[bool] = True
    kind: str = choice("dask_address", "dask_address")
    address: str = ""  # of a scheduler that runs already, such as tcp://host:8786

    @contextmanager
    def connect(self, status: WorkerStatus) -> Iterator[Dispatch]:
        """Raises `InputError` where no scheduler answers."""
        distributed = _dask("distributed", self.kind)
        if not self.address:
            raise InputError("cluster.address is missing: a scheduler's, such as tcp://host:8786")
        try:
            client = distributed.Client(self.address, timeout=5)
        except (OSError, ValueError) as error:
            reason = str(error).splitlines()[0]
            raise InputError(f"cluster.address = {self.address} is not a scheduler that answers: {reason}") from None
        with client:
            yield partial(_distribute, client, status)


@dataclass(frozen=True)
class Slurm:
    """One Slurm job for each worker, sent from here; a job that ends early, as by its time limit, is sent again."""

    is_remote: ClassVar[bool] = True
    kind: str = choice("slurm", "slurm")
    workers: int = count(2, at_least=1)  # jobs that are sent, each with one worker
    cores: int = count(1, at_least=1)  # processor cores of a job
    memory: str = "4GB"  # that a job asks for
    walltime: str = "01:00:00"  # after which Slurm ends a job, which is then sent again
    queue: str | None = None  # partition
    account: str | None = None
    interface: str | None = None  # network that the nodes reach this machine by, such as ib0
    directives: list[str] = field(default_factory=list)  # further #SBATCH lines, such as --gres=gpu:1
    prologue: list[str] = field(default_factory=list)  # shell lines before the worker, such as module load cuda
    logs: str = "results/slurm"  # folder of the jobs' output

    @contextmanager
    def connect(self, status: WorkerStatus) -> Iterator[Dispatch]:
        """Send the jobs; Slurm starts them when it can. Raises `InputError` where it never would."""
        distributed, jobqueue = _dask("distributed", self.kind), _dask("dask_jobqueue", self.kind)
        os.makedirs(self.logs, exist_ok=True)
        cluster = jobqueue.SLURMCluster(
            cores=self.cores,
            processes=1,
            memory=self.memory,
            walltime=self.walltime,
            queue=self.queue,
            account=self.account,
            interface=self.interface,
            job_extra_directives=list(self.directives),
            job_script_prologue=list(self.prologue),
            log_directory=self.logs,
            python=sys.executable,
            # one batch at a time; Slurm guards the memory, where Dask would only pause the worker
            worker_extra_args=["--nthreads", "1", "--memory-limit", "0"],
            scheduler_options=QUIET_SCHEDULER,
            security=_security(),
            shared_temp_directory=os.path.abspath(self.logs),  # readable by this user alone
        )
        with patient_exit(), cluster, distributed.Client(cluster) as client:  # which cancels the jobs at the end
            _check_job(cluster.job_script())
            cluster.adapt(minimum_jobs=self.workers, maximum_jobs=self.workers)
            yield partial(_distribute, client, status)


@contextmanager
def connect_lazily(cluster: "Cluster", status: WorkerStatus) -> Iterator[Dispatch]:
    """Hand out batches, connecting to the `cluster` at the first: a finished study sends no job."""
    with ExitStack() as stack:
        connect = cache(lambda: stack.enter_context(cluster.connect(status)))
        yield lambda work, batches: connect()(work, batches)


CLUSTERS = {"local": Local, "dask_local": DaskLocal, "dask_address": DaskAddress, "slurm": Slurm}
Cluster = Local | DaskLocal | DaskAddress | Slurm
MEND = 5000  # ms between two looks for workers that are lost
LEAST, TIMES = 60.0, 10  # s, and medians, that a batch may take before its worker is given up
POLL = 0.05  # s, between two looks for results
FETCH = 5.0  # s, for a result, of a few hundred bytes
GIVE_UP = 30.0  # s, for a worker to end and start again
FIRST = 600.0  # s, of a worker's first batch, for which it compiles
QUIET_SCHEDULER: dict[str, Any] = {"dashboard": False, "dashboard_address": "localhost:0"}  # where no port is taken
QUIET: dict[str, Any] = {"scheduler_kwargs": QUIET_SCHEDULER, "silence_logs": logging.CRITICAL}


def _dask(module: str, kind: str) -> Any:
    """The module, with its loggers quiet: what a user must know is one line of ours."""
    try:
        import dask.config

        dask.config.set({"distributed.logging": {"distributed": "critical", "distributed.client": "critical"}})
        return import_module(module)
    except ImportError:
        raise InputError(f"cluster = {kind} needs the extra `cluster`: pip install 'insect-sweep[cluster]'") from None


def _check_job(script: str) -> None:
    """Ask Slurm whether it would take the job: Dask would send it for ever. Raises `InputError`."""
    try:
        asked = subprocess.run(["sbatch", "--test-only"], input=script, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        raise InputError("cluster = slurm needs Slurm's sbatch on the PATH") from None
    if asked.returncode:
        lines = [line.partition("error: ")[2] for line in asked.stderr.splitlines() if "error: " in line]
        raise InputError(f"cluster = slurm is not allowed as asked for, says sbatch: {'; '.join(lines)}")


def _ignore_interrupt() -> None:
    """A terminal's Ctrl-C reaches all processes of the command; ending the workers is for this one to do."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _security() -> Any:
    """Keys for one scheduler and its workers, which nobody else has."""
    from distributed.security import Security

    try:
        return Security.temporary()
    except ImportError:
        raise InputError("cluster needs the package cryptography: pip install 'insect-sweep[cluster]'") from None


def _distribute(client: Any, status: WorkerStatus, work: Work, batches: Iterable[int]) -> Iterator[Any]:
    """Let the workers of `client` do it. Raises `Fault` after all others where workers kept dying over a batch."""
    from distributed import KilledWorker, as_completed

    tasks = [(client.submit(_timed, work, number, pure=False), number) for number in batches]
    watch = _WorkerWatch(client, status, {future.key: number for future, number in tasks})
    ready, lost = as_completed([future for future, _ in tasks]), []
    del tasks  # nothing but `ready` refers to the futures: a finished one that a dying worker holds is not done again
    while ready.count():
        if not ready.has_ready():
            watch.poll()
            time.sleep(POLL)
            continue
        future = next(ready)
        try:
            seconds, result = future.result(timeout=FETCH)
        except TimeoutError:  # it is on a worker that hangs over another batch
            ready.add(future)
            watch.report_unfetched(future)
            watch.poll()
            continue
        except KilledWorker as error:
            lost.append(error.task)
        else:
            watch.took.append(seconds)
            yield result
        future.release()
    if lost:
        raise Fault(f"{len(lost)} batches lost their worker again and again; is its memory too small?")


def _timed(work: Work, number: int) -> tuple[float, Any]:
    """The result of `work`, after the seconds that it took."""
    start = time.monotonic()
    result = work(number)
    return time.monotonic() - start, result


@dataclass
class _WorkerWatch:
    """Which workers are at their batch for too long: they are started again, and their batches go to others."""

    client: Any
    watched: WorkerStatus
    numbers: Mapping[str, int]  # of batches, by the key of their task
    took: list[float] = field(default_factory=list)  # s, of finished batches
    tasks: dict[str, set[str]] = field(default_factory=dict)  # that each worker has, the first of them running
    since: dict[str, float] = field(default_factory=dict)  # s, when that one began, as far as is seen from here
    warm: set[str] = field(default_factory=set)  # workers that have finished a batch
    asked: dict[str, float] = field(default_factory=dict)  # s, when a result was first asked for in vain, by task
    last: float = -math.inf  # s, when this looked

    def poll(self) -> None:
        """Look once a second how workers do."""
        now = time.monotonic()
        if now < self.last + 1:
            return
        self.last, tasks = now, {worker: set(keys) for worker, keys in self.client.processing().items()}
        self.watched.workers = len(tasks)
        for worker, keys in tasks.items():
            before = self.tasks.get(worker, set())
            if not before <= keys:
                self.warm.add(worker)
            if not before or not before <= keys:
                self.since[worker] = now
            if keys and now - self.since[worker] > self.time_limit_s(worker):
                self.restart_worker(worker, min(self.numbers[key] for key in keys), now - self.since[worker])
        self.tasks = tasks

    def report_unfetched(self, future: Any) -> None:
        """A batch is done, and the worker that did it does not tell."""
        now = time.monotonic()
        waited = now - self.asked.setdefault(future.key, now)
        if waited > LEAST:
            for worker in self.client.who_has([future])[future.key]:
                self.restart_worker(worker, self.numbers[future.key], waited)

    def restart_worker(self, worker: str, number: int, waited: float) -> None:
        """Let its nanny kill `worker` and start it again; the scheduler forgets one that has none that answers."""
        self.watched.on_message(
            f"batch {number} has kept worker {worker} for {waited:.0f} s: it goes to another worker"
        )
        self.client.restart_workers([worker], timeout=GIVE_UP, raise_for_error=False)
        self.since[worker] = time.monotonic()

    def time_limit_s(self, worker: str) -> float:
        """Seconds that a batch of `worker` may take."""
        usual = TIMES * statistics.median(self.took) if self.took else 0.0
        return max(usual, LEAST if worker in self.warm else FIRST)
