"""Where batches are simulated: in this process, by Dask workers on this machine or at an address, or in Slurm jobs.

A cluster distributes only the numbers of batches. Workers read and write the study's folder themselves. Connections use
TLS with temporary keys, because whoever reaches a Dask scheduler can run code on its workers.
"""

import logging
import math
import os
import re
import signal
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import CancelledError
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, field
from functools import cache, partial
from importlib import import_module
from typing import Any, ClassVar

from sweep.core.errors import Fault, InputError
from sweep.core.interrupts import suspend_forced_exit
from sweep.core.parameters import choice, count

BatchFunction = Callable[[int], Any]
DispatchFunction = Callable[
    [BatchFunction, Iterable[int]], Iterator[Any]
]  # results in the order in which they are ready


@dataclass
class WorkerStatus:
    """State of the workers while batches run, for progress messages."""

    on_message: Callable[[str], None]  # prints one line for the user
    workers: int | None = None  # alive; None if batches run in this process


@dataclass(frozen=True)
class LocalCluster:
    """Simulate in this process, one batch after the other; each batch uses all devices."""

    is_remote: ClassVar[bool] = False  # whether workers have other devices than this machine
    kind: str = choice("local", "local")

    def connect(self, _: WorkerStatus) -> AbstractContextManager[DispatchFunction]:
        """Return a context that simulates batches one after the other in this process."""
        return nullcontext(map)


@dataclass(frozen=True)
class DaskLocalCluster:
    """Simulate in Dask worker processes on this machine."""

    is_remote: ClassVar[bool] = False
    kind: str = choice("dask_local", "dask_local")
    workers: int = count(2, at_least=1)  # processes, each of which simulates one batch at a time

    @contextmanager
    def connect(self, status: WorkerStatus) -> Iterator[DispatchFunction]:
        """Start worker processes on this machine, and restart those that are lost, within this context."""
        distributed = _dask("distributed", self.kind)
        from tornado.ioloop import PeriodicCallback

        options = {"n_workers": self.workers, "threads_per_worker": 1, "memory_limit": 0, "security": _security()}
        with distributed.LocalCluster(**options, **QUIET_CLUSTER) as cluster, distributed.Client(cluster) as client:
            client.register_worker_callbacks(setup=_ignore_interrupt)
            # Dask starts a lost worker again, but not one that is lost before it has said that it started
            restart_lost = PeriodicCallback(lambda: cluster.scale(self.workers), RESTART_PERIOD_MS)
            cluster.loop.add_callback(restart_lost.start)
            try:
                yield partial(_distribute, client, status)
            finally:
                cluster.loop.add_callback(restart_lost.stop)


@dataclass(frozen=True)
class DaskSchedulerCluster:
    """Simulate on the workers of a running Dask scheduler, which need this package, and the study's folder at the same
    path."""

    is_remote: ClassVar[bool] = True
    kind: str = choice("dask_address", "dask_address")
    address: str = ""  # of a scheduler that runs already, such as tcp://host:8786

    @contextmanager
    def connect(self, status: WorkerStatus) -> Iterator[DispatchFunction]:
        """Connect to a running Dask scheduler within this context. Raises `InputError` if none answers."""
        distributed = _dask("distributed", self.kind)
        if not self.address:
            raise InputError("cluster.address is missing: the address of a Dask scheduler, such as tcp://host:8786")
        try:
            client = distributed.Client(self.address, timeout=5)
        except (OSError, ValueError) as error:
            reason = str(error).splitlines()[0]
            raise InputError(f"cluster.address = {self.address} does not answer: {reason}") from None
        with client:
            yield partial(_distribute, client, status)


@dataclass(frozen=True)
class SlurmCluster:
    """Simulate in Slurm jobs, one for each worker, submitted from this machine. A job that ends early is submitted
    again."""

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
    def connect(self, status: WorkerStatus) -> Iterator[DispatchFunction]:
        """Submit the Slurm jobs, and cancel them when this context ends. Raises `InputError` if sbatch refuses them."""
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
            scheduler_options=QUIET_SCHEDULER_OPTIONS,
            security=_security(),
            shared_temp_directory=os.path.abspath(self.logs),  # readable by this user alone
        )
        with suspend_forced_exit(), cluster, distributed.Client(cluster) as client:  # which cancels the jobs at the end
            _check_job(cluster.job_script())
            cluster.adapt(minimum_jobs=self.workers, maximum_jobs=self.workers)
            yield partial(_distribute, client, status)


@contextmanager
def connect_lazily(cluster: "Cluster", status: WorkerStatus) -> Iterator[DispatchFunction]:
    """Connect to a cluster only when the first batch is distributed, so that a finished study starts no workers.

    Args:
        cluster: The cluster.
        status: Receives the number of workers, and messages for the user.

    Yields:
        A function `(work, batches)` that applies `work` to each batch number and yields results as they are ready.
    """
    with ExitStack() as stack:
        connect = cache(lambda: stack.enter_context(cluster.connect(status)))
        yield lambda work, batches: connect()(work, batches)


CLUSTERS = {
    "local": LocalCluster,
    "dask_local": DaskLocalCluster,
    "dask_address": DaskSchedulerCluster,
    "slurm": SlurmCluster,
}
Cluster = LocalCluster | DaskLocalCluster | DaskSchedulerCluster | SlurmCluster
RESTART_PERIOD_MS = 5000  # between two searches for lost workers
# a worker is restarted if its batch takes longer than both, the second in median durations of a batch
MIN_TIME_LIMIT_S, MEDIANS_PER_LIMIT = 60.0, 10
POLL_PERIOD_S = 0.05  # between two polls for results
FETCH_TIMEOUT_S = 5.0  # for a result of a few hundred bytes
JOIN_TIMEOUT_S, REPEAT_AFTER_S = 20.0, 60.0  # without a worker: until the message, and between two messages
RESTART_TIMEOUT_S = 30.0  # for a worker to end and start again
FIRST_BATCH_LIMIT_S = 600.0  # of a worker's first batch, for which it compiles
QUIET_SCHEDULER_OPTIONS: dict[str, Any] = {
    "dashboard": False,
    "dashboard_address": "localhost:0",
}  # where no port is taken
QUIET_CLUSTER: dict[str, Any] = {"scheduler_kwargs": QUIET_SCHEDULER_OPTIONS, "silence_logs": logging.CRITICAL}


def _dask(module: str, kind: str) -> Any:
    """Import a module of Dask with its loggers silenced. Raises `InputError` where it is not installed."""
    try:
        import dask.config

        dask.config.set({"distributed.logging": {"distributed": "critical", "distributed.client": "critical"}})
        return import_module(module)
    except ImportError:
        raise InputError(f"cluster = {kind} needs the extra `cluster`: pip install 'insect-sweep[cluster]'") from None


def _check_job(script: str) -> None:
    """Raise `InputError` where sbatch would refuse the job. Dask would submit it again and again."""
    try:
        asked = subprocess.run(["sbatch", "--test-only"], input=script, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        raise InputError("cluster = slurm needs Slurm's sbatch on the PATH") from None
    if asked.returncode:
        lines = [line.partition("error: ")[2] for line in asked.stderr.splitlines() if "error: " in line]
        raise InputError(f"cluster = slurm is not allowed: sbatch refuses the job: {'; '.join(lines)}")


def _ignore_interrupt() -> None:
    """Ignore Ctrl-C in a worker: a terminal sends it to all processes, and the main process ends the workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def explain_scheduler_warning(text: str) -> str:
    """Shorten a warning of a Dask scheduler to one line, such as a refused worker with the reason."""
    line = " ".join(text.split())
    if found := re.search(r"TLS handshake failed with remote '?(?:\w+://)?([^\s']+?)'?: (.*)", line):
        return (
            f"it refused the worker at {found[1]}, which has other TLS keys or none; workers need the keys of this "
            f"scheduler ({found[2]})"
        )
    return f"its last warning is: {line}"


def _security() -> Any:
    """Make temporary TLS keys for one scheduler and its workers."""
    from distributed.security import Security

    try:
        return Security.temporary()
    except ImportError:
        raise InputError("cluster needs the package cryptography: pip install 'insect-sweep[cluster]'") from None


def _distribute(client: Any, status: WorkerStatus, work: BatchFunction, batches: Iterable[int]) -> Iterator[Any]:
    """Run batches on the workers and yield their results.

    Raises `Fault` if the scheduler is lost, or after all other batches if workers kept dying over some of them.
    """
    address = client.scheduler.address
    try:
        yield from _collect_results(client, status, work, batches)
    except (Exception, CancelledError) as error:
        if isinstance(error, InputError | Fault) or client.status == "running":
            raise
        raise Fault(f"the scheduler {address} is lost") from None


def _collect_results(client: Any, status: WorkerStatus, work: BatchFunction, batches: Iterable[int]) -> Iterator[Any]:
    """Run batches on the workers and yield their results, see `_distribute`."""
    from distributed import KilledWorker, as_completed

    tasks = [(client.submit(_timed, work, number, pure=False), number) for number in batches]
    watch = _WorkerWatch(client, status, {future.key: number for future, number in tasks}, client.scheduler.address)
    ready, lost = as_completed([future for future, _ in tasks]), []
    del tasks  # nothing but `ready` refers to the futures: a finished one that a dying worker holds is not done again
    while ready.count():
        if not ready.has_ready():
            watch.poll()
            time.sleep(POLL_PERIOD_S)
            continue
        future = next(ready)
        try:
            seconds, result = future.result(timeout=FETCH_TIMEOUT_S)
        except TimeoutError:  # it is on a worker that hangs over another batch
            ready.add(future)
            watch.restart_worker_with_unsent_result(future)
            watch.poll()
            continue
        except KilledWorker as error:
            lost.append(error.task)
        else:
            watch.durations_s.append(seconds)
            yield result
        future.release()
    if lost:
        raise Fault(f"{len(lost)} batches repeatedly lost their worker; it may have too little memory")


def _timed(work: BatchFunction, number: int) -> tuple[float, Any]:
    """Return the duration of `work` in s, and its result."""
    start = time.monotonic()
    result = work(number)
    return time.monotonic() - start, result


@dataclass
class _WorkerWatch:
    """Restarts workers that take too long for a batch, so that other workers get their batches."""

    client: Any
    status: WorkerStatus
    numbers: Mapping[str, int]  # of batches, by the key of their task
    address: str  # of the scheduler
    durations_s: list[float] = field(default_factory=list)  # of finished batches
    tasks: dict[str, set[str]] = field(default_factory=dict)  # keys of the tasks that each worker has
    started_s: dict[str, float] = field(default_factory=dict)  # when each worker's running task began
    warm_workers: set[str] = field(default_factory=set)  # those that have finished a batch, and so have compiled
    first_asked_s: dict[str, float] = field(default_factory=dict)  # time of the first failed fetch of a result, by task
    last_poll_s: float = -math.inf  # time of the last poll
    no_worker_since_s: float | None = None  # None while there are workers
    no_scheduler_since_s: float | None = None  # None while the scheduler answers

    def poll(self) -> None:
        """Check all workers, at most once a second, and restart those over their time limit."""
        now = time.monotonic()
        if now < self.last_poll_s + 1:
            return
        self.last_poll_s = now
        try:
            tasks = {worker: set(keys) for worker, keys in self.client.processing().items()}
            self.status.workers = len(tasks)
            self.report_missing_workers(bool(tasks), now)
        except (OSError, TimeoutError):  # which Dask tries to mend
            self.no_scheduler_since_s = self.no_scheduler_since_s or now
            if now - self.no_scheduler_since_s > RESTART_TIMEOUT_S:
                raise Fault(f"the scheduler {self.address} is lost") from None
            return
        self.no_scheduler_since_s = None
        for worker, keys in tasks.items():
            before = self.tasks.get(worker, set())
            if not before <= keys:
                self.warm_workers.add(worker)
            if not before or not before <= keys:
                self.started_s[worker] = now
            if keys and now - self.started_s[worker] > self.batch_time_limit_s(worker):
                self.restart_worker(worker, min(self.numbers[key] for key in keys), now - self.started_s[worker])
        self.tasks = tasks

    def report_missing_workers(self, is_any: bool, now_s: float) -> None:
        """Print that no worker has joined, with the scheduler's last warning, after `JOIN_TIMEOUT_S` and then every
        minute.

        Args:
            is_any: whether there is a worker.
            now_s: time, in s.
        """
        self.no_worker_since_s = None if is_any else self.no_worker_since_s or now_s
        if self.no_worker_since_s is None or now_s - self.no_worker_since_s < JOIN_TIMEOUT_S:
            return
        warned = [text for level, text in self.client.get_scheduler_logs() if level in ("WARNING", "ERROR", "CRITICAL")]
        why = explain_scheduler_warning(warned[-1]) if warned else "its log has no warning"
        self.status.on_message(f"no worker has joined the scheduler {self.address} for {JOIN_TIMEOUT_S:.0f} s: {why}")
        self.no_worker_since_s = now_s + REPEAT_AFTER_S - JOIN_TIMEOUT_S

    def restart_worker_with_unsent_result(self, future: Any) -> None:
        """Restart a worker that holds a result but does not send it."""
        now = time.monotonic()
        waited_s = now - self.first_asked_s.setdefault(future.key, now)
        if waited_s > MIN_TIME_LIMIT_S:
            for worker in self.client.who_has([future])[future.key]:
                self.restart_worker(worker, self.numbers[future.key], waited_s)

    def restart_worker(self, worker: str, number: int, waited_s: float) -> None:
        """Restart a worker, so that its batches are sent to other workers.

        Args:
            worker: Address of the worker.
            number: Number of the batch that it has had for too long.
            waited_s: How long it has had this batch.
        """
        self.status.on_message(
            f"batch {number} has occupied worker {worker} for {waited_s:.0f} s: it is given to another worker"
        )
        self.client.restart_workers([worker], timeout=RESTART_TIMEOUT_S, raise_for_error=False)
        self.started_s[worker] = time.monotonic()

    def batch_time_limit_s(self, worker: str) -> float:
        """Return the time limit (s) of a worker for one batch."""
        usual = MEDIANS_PER_LIMIT * statistics.median(self.durations_s) if self.durations_s else 0.0
        return max(usual, MIN_TIME_LIMIT_S if worker in self.warm_workers else FIRST_BATCH_LIMIT_S)
