"""Worker processes for the runs of a study: on the cores of this machine, or of a Dask cluster."""

from __future__ import annotations

import logging
import math
import multiprocessing
import os
import signal
import sys
import time as clock
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import resource_tracker
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Thread
from typing import TYPE_CHECKING, Any, Final, TypeVar, cast, final

from multicell.errors import ClusterError, ExitCode
from multicell.host.extras import needs, quiet
from multicell.host.interrupts import WHOLE_STEP
from multicell.results.folder import file_errors, versions
from multicell.studies.limits import check_cores
from multicell.studies.runs import MODEL_VERSION

if TYPE_CHECKING:
    from distributed import Client

Result = TypeVar("Result")

ANSWER: Final = 5.0  # time in s within which a scheduler must answer
_SILENCE: Final = 60.0  # time in s after which one that has answered before counts as gone

_STARTS: Final = 3  # attempts to start worker processes
_SET_BY_DASK: Final = ("PYTHONHASHSEED", "__DASK_PARENT_PID", "PYTHONSAFEPATH")
_QUIET: Final = ("asyncio", "distributed", "tornado")  # loggers
_SETTINGS: Final[dict[str, Any]] = {
    # runs hold the interpreter for whole coupling steps, so nothing may be concluded from silence
    "distributed.scheduler.worker-ttl": None,
    "distributed.worker.preload": [__name__],
    # one thread a worker. Dask would also have the C library give memory back at once, which makes
    # all larger arrays cost page faults
    "distributed.nanny.pre-spawn-environ": {
        "OMP_NUM_THREADS": "1",
        "MKL_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
    },
    # a worker holds no data; only what takes the memory of the others is ended
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
    # what looks at workers while they work takes their time
    "distributed.worker.profile.enabled": False,
    "distributed.scheduler.active-memory-manager.start": False,
    "distributed.worker.memory.monitor-interval": "500ms",
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "5s",
    # Dask's pages ask nobody who they are: what listens for a moment has nothing to show
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
    # processes that start again while the study ends have no message for the user
    "logging": dict.fromkeys((*_QUIET, "distributed.client", "tornado.application"), "critical"),
}


@contextmanager
def workers(cores: int | None, scheduler: Any) -> Iterator[Client]:
    """Yield a Dask client whose workers can run scenes.

    Workers on this machine talk to this process alone: each connection is encrypted and asks for a
    certificate that is made for this call and kept in memory and in folders of this user.

    - ``cores``: number of worker processes on this machine, by default one for each core that this
      process may use; each has one thread. Not for a ``scheduler``, which has its own workers.
    - ``scheduler``: address of the scheduler of a cluster, such as ``"tls://10.0.0.7:8786"``, or a
      cluster of Dask's (as of dask-jobqueue), whose certificates are used too

    Raises SceneError for a number of cores that is none or more than a machine has; MissingPackage
    if Dask is not installed; ClusterError if the scheduler does not answer, has no workers, or some
    of them cannot run the scenes as this process would: without multicell, with other versions, or
    several threads to a process.
    """
    check_cores(cores)
    needs("dask", "distributed", *(("cryptography",) if scheduler is None else ()))
    import dask

    with ExitStack() as stack:
        if scheduler is None:
            stack.enter_context(dask.config.set(_SETTINGS))
        stack.enter_context(quiet(*_QUIET))
        place = stack.enter_context(_local_cluster(cores)) if scheduler is None else scheduler
        address = getattr(scheduler, "scheduler_address", scheduler)
        security = None if scheduler is None else getattr(scheduler, "security", None)
        client = _client(place if scheduler is None else address, security, scheduler is None)
        stack.callback(_close, client)
        if scheduler is not None:
            check_workers(client, address)
        yield client


def bounded(call: Callable[[], Result], seconds: float = _SILENCE) -> Result:
    """Return the result of a call of Dask, which waits for a scheduler that may be silent.

    Ctrl-C ends the wait. The call itself is left to its thread, which ends with this process.

    Raises TimeoutError after so many seconds, and what the call raises.
    """
    answers: SimpleQueue[tuple[Result | None, BaseException | None]] = SimpleQueue()

    def ask() -> None:
        try:
            answers.put((call(), None))
        except BaseException as error:  # raised where it is waited for
            answers.put((None, error))

    Thread(target=ask, daemon=True).start()
    end = clock.monotonic() + seconds
    while True:
        WHOLE_STEP.deliver()
        try:
            found, error = answers.get(timeout=0.1)
        except Empty:
            if clock.monotonic() > end:
                raise TimeoutError(f"no answer for {seconds:g} s") from None
            continue
        if error is not None:
            raise error
        return cast("Result", found)


@contextmanager
def _local_cluster(cores: int | None) -> Iterator[Any]:
    """Yield a cluster of processes of this machine, which end with this one."""
    environment = dict(os.environ)
    with _without_main():
        os.environ["PYTHONSAFEPATH"] = "1"  # or they would begin with modules of this folder
        cluster = _start_cluster(cores or own_cores())
        try:
            yield cluster
        finally:
            with suppress(TimeoutError):  # what does not end by itself is killed with this process
                cluster.close(timeout=10.0)
            # Dask sets in this process what it sets for those that it starts
            for name in (*_SETTINGS["distributed.nanny.pre-spawn-environ"], *_SET_BY_DASK):
                os.environ.pop(name, None)
                if name in environment:
                    os.environ[name] = environment[name]


def _start_cluster(count: int) -> Any:
    import distributed

    if multiprocessing.current_process().daemon:
        raise ClusterError(
            f"{count} worker processes cannot be started: this process is a worker of a pool, "
            "which may start no others",
            "Use cores=1 in it. Nothing has run",
        )
    local: Any = distributed.LocalCluster
    certificates: Any = distributed.Security
    for left in reversed(range(_STARTS)):
        try:
            with _without_interrupts():
                cluster = local(
                    n_workers=count,
                    threads_per_worker=1,
                    processes=True,
                    # other users of this machine must not have code run
                    security=certificates.temporary(),
                    dashboard_address="127.0.0.1:0",  # any free port, and no pages there
                    scheduler_kwargs={"dashboard": False},
                    scheduler_sync_interval=5,
                    silence_logs=logging.CRITICAL,
                )
                cluster.sync(_stop_pages, cluster.scheduler)
                return cluster
        except Exception as error:  # one of them may have been killed
            if not left:
                raise ClusterError(
                    f"{count} worker processes cannot be started on this machine ({error})",
                    "There may be too little memory for them: use fewer cores. Nothing has run",
                ) from error
    raise AssertionError("unreachable")


async def _stop_pages(server: Any) -> None:
    """Close the port of the pages of a scheduler or worker, which asks for no certificate."""
    server.http_server.stop()


@contextmanager
def _without_main() -> Iterator[None]:
    """Let processes that are started not run the script again that is being run.

    They would, up to where it starts them, as ``multiprocessing`` does on all systems that do not
    fork: a script would need a guard for it.
    """
    names: dict[str, Any] = vars(sys.modules["__main__"])
    hidden: dict[str, Any] = {
        name: names[name] for name in ("__spec__", "__file__") if name in names
    }
    names["__spec__"] = None
    names.pop("__file__", None)
    try:
        yield
    finally:
        names.update(hidden)


@contextmanager
def _without_interrupts() -> Iterator[None]:
    """Let threads and processes that are started now, and all theirs, not hear Ctrl-C.

    A terminal sends it to workers too, but this process directs them.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # it would make the thread that starts it hear them again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _client(place: Any, security: Any, own: bool) -> Client:
    from distributed import Client

    client = Client.__new__(Client)

    def connect() -> None:
        client.__init__(  # type: ignore[misc]
            place, timeout=ANSWER, set_as_default=False, security=security
        )

    try:
        # one that accepts and is silent is waited for by Dask for minutes
        bounded(connect, math.inf if own else ANSWER)
        return client
    except Exception as error:
        # left to the garbage collector it would be closed at any moment, also while another one
        # holds the lock of Dask's loops, for which both would wait for ever
        _close(client, 1.0)
        client.status = "closed"  # what is closed is not closed once more
        said = " ".join(str(error).split()) or type(error).__name__
        raise ClusterError(
            f"the scheduler '{place}' does not answer within {ANSWER:g} s ({said[:200]})",
            "'dask scheduler' starts one and says its address, such as tcp://10.0.0.7:8786. "
            "Nothing has run",
        ) from error


def _close(client: Any, seconds: float = ANSWER) -> None:
    with suppress(Exception):  # it may have gone, and nothing depends on it any more
        bounded(lambda: client.close(timeout=seconds), 2.0 * seconds)


def check_workers(client: Any, scheduler: str) -> None:
    """Refuse a cluster whose workers would compute otherwise than this process."""
    try:
        threads = bounded(client.nthreads, ANSWER)
        answers = bounded(lambda: client.run(eval, _WHAT, on_error="return")) if threads else {}
    except TimeoutError as error:
        raise ClusterError(
            f"the scheduler '{scheduler}' or one of its workers does not answer ({error})",
            "Nothing has run",
        ) from error
    if not threads:
        raise ClusterError(
            f"the scheduler '{scheduler}' has no workers",
            f"'dask worker {scheduler} --nthreads 1 --nworkers auto' starts one process a core. "
            "Nothing has run",
        )
    many = [f"{address} has {count} threads" for address, count in threads.items() if count != 1]
    _refuse(many, "a run takes a process of its own", "Start workers with '--nthreads 1'")
    own, wrong = own_versions(), []
    # an expression, not a function of ours, which workers without multicell could not load
    for address, theirs in answers.items():
        if isinstance(theirs, ModuleNotFoundError):
            wrong.append(f"{address} has no multicell")
        elif isinstance(theirs, BaseException):
            said = f"{type(theirs).__name__}: {theirs}"
            wrong.append(f"{address} cannot load multicell ({said})")
        elif said := _difference(theirs, own):
            wrong.append(f"{address} {said}")
    _refuse(wrong, f"this process has {_listed(own)}", _SAME)


_WHAT: Final = (
    "{**__import__('multicell.results.folder', fromlist=['versions']).versions(),"
    " 'Python': '{}.{}'.format(*__import__('sys').version_info),"
    " 'model version': str(__import__('multicell.studies.runs', fromlist=['x']).MODEL_VERSION)}"
)
_SAME: Final = "Install the same packages where workers run as here"


def own_versions() -> dict[str, str]:
    """Return the versions of all that decides the numbers of this process."""
    python = "{}.{}".format(*sys.version_info)
    return {**versions(), "Python": python, "model version": str(MODEL_VERSION)}


def _difference(theirs: Mapping[str, str], own: Mapping[str, str]) -> str:
    """Return the first version that is another one in a worker, or nothing."""
    other = (name for name in own if theirs.get(name) != own[name])
    return next((f"has {name} {theirs.get(name)}" for name in other), "")


def _listed(own: Mapping[str, str]) -> str:
    return ", ".join(f"{name} {number}" for name, number in own.items())


@final
@dataclass(frozen=True)
class Refusal:
    """Answer of a worker that would not compute as the process that asks; it may join late."""

    worker: str
    said: str


def call_checked(wanted: Mapping[str, str], function: Callable[..., Any], *arguments: Any) -> Any:
    """Make a call on a worker if that has the versions that are wanted; else a :class:`Refusal`."""
    said = _difference(own_versions(), wanted)
    if said:
        from distributed import get_worker

        return Refusal(get_worker().address, said)
    return function(*arguments)


@final
class CheckedClient:
    """Client that submits calls to those workers that have the versions of this process.

    Workers may join at any time. One that answers with a refusal gets no further call.

    - ``client``: of Dask
    """

    def __init__(self, client: Any) -> None:
        self._client = client
        self._own = own_versions()
        self._refused: dict[str, str] = {}

    def threads(self) -> int:
        """Return how many threads the workers have that may be used."""
        return sum(self._known().values())

    def submit(self, function: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
        """Submit a call; its future comes to the result, or a refusal, as of ``call_checked``."""
        if self._refused:
            options |= {"workers": list(self._known()), "allow_other_workers": False}
        return self._client.submit(call_checked, self._own, function, *arguments, **options)

    def note(self, refusal: Refusal) -> None:
        """Do without a worker from now on; raises ClusterError if it was the last one."""
        self._refused[refusal.worker] = refusal.said
        if not self._known():
            raise ClusterError(
                f"worker {refusal.worker} {refusal.said}, but this process has "
                f"{_listed(self._own)}, and no other worker is left",
                f"{_SAME}. All that runs have saved is kept",
                exit_code=ExitCode.MACHINE,
            )

    def _known(self) -> dict[str, int]:
        threads = bounded(self._client.nthreads).items()
        return {address: count for address, count in threads if address not in self._refused}


def _refuse(wrong: list[str], right: str, hint: str) -> None:
    """Raise an error about workers if there are wrong ones."""
    if wrong:
        more = f" and {len(wrong) - 1} more" if len(wrong) > 1 else ""
        raise ClusterError(f"worker {wrong[0]}{more}, but {right}", f"{hint}. Nothing has run")


def check_folder(client: Client, folder: Path) -> None:
    """Refuse workers that do not see the folder of a study, or cannot write there.

    - ``folder``: an absolute path
    """
    import uuid

    mark = uuid.uuid4().hex
    path = folder / f".visible-{mark}"
    with file_errors("write", path):
        path.write_text(mark, encoding="ascii")
        try:
            seen = bounded(lambda: client.run(_sees, str(path)))
        finally:
            path.unlink()
    wrong = [f"{address} {said}" for address, said in seen.items() if said]
    _refuse(
        wrong,
        f"runs are written to '{folder}'",
        "All workers need the folder of the study under the same path, on a shared file system",
    )


def _sees(path: str) -> str:
    """Return why a worker cannot use the folder of a file, or nothing."""
    try:
        with open(path, encoding="ascii") as file:
            if file.read() != path.rpartition("-")[2]:
                return f"reads something else in '{path}'"
        beside = f"{path}.{os.getpid()}"
        with open(beside, "x"):
            os.unlink(beside)
    except OSError as error:
        return f"cannot use '{path}': {os.strerror(error.errno or 0)}"
    return ""


async def dask_setup(worker: Any) -> None:
    """Load in a worker what all runs need, and let it end with the process that started it.

    Dask calls this where the module is named as a preload.
    """
    if worker.security.require_encryption:
        await _stop_pages(worker)
    import multicell.results.writer
    import multicell.runner  # noqa: F401

    _end_with_parent()


def _end_with_parent() -> None:
    """Have this process killed when its parent has been.

    Dask ends it then, too, as soon as the interpreter is free: a run may hold it for long.
    """
    if sys.platform != "linux" or multiprocessing.parent_process() is None:
        return  # a shell that has started it may end
    import ctypes

    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(1, signal.SIGKILL, 0, 0, 0)  # PR_SET_PDEATHSIG


def own_cores() -> int:
    """Return how many cores this process may use; its group's limit is known where Dask is."""
    try:
        from dask.system import CPU_COUNT
    except ImportError:
        return os.cpu_count() or 1
    return int(CPU_COUNT)
