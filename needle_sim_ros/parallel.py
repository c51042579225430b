# SPDX-License-Identifier: Apache-2.0
"""Work on several processes, here or on a Dask cluster, behind one interface.

Whoever has work to share takes a ``concurrent.futures.Executor`` and knows no more. Tasks
are functions of modules with arguments that can be pickled; what a worker should keep from
one task to the next (a factorised tissue) it keeps in its own process.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager
from importlib.util import find_spec
from multiprocessing import get_context, parent_process
from multiprocessing.connection import wait
from typing import Any, ParamSpec, TypeVar

from needle_sim_ros.errors import NeedleSimError

P = ParamSpec("P")
T = TypeVar("T")

# What limits the threads of the linear algebra libraries; read when they are loaded.
_THREADS = (
    "OPENBLAS_NUM_THREADS",
    "OMP_NUM_THREADS",
    "MKL_NUM_THREADS",
    "BLIS_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "NUMEXPR_NUM_THREADS",
)


class SerialExecutor(Executor):
    """Runs each task at once in the calling thread: nothing to start, nothing to pickle."""

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Run the task; return a future that is done."""
        future: Future[T] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


# tasks of one process share what it keeps, and a factorised tissue is not for two threads
_process = threading.Lock()


class _OneAtATime(Executor):
    """Hands tasks to an executor whose workers may have several threads: one runs at a time."""

    def __init__(self, inner: Executor) -> None:
        self._inner = inner

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        return self._inner.submit(_alone, fn, *args, **kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        self._inner.shutdown(wait=wait)


def _alone(fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> T:
    with _process:
        return fn(*args, **kwargs)


@contextmanager
def executor(workers: int | None = None, dask: str | None = None) -> Iterator[Executor]:
    """Give an executor for the time of a ``with`` block.

    Parameters
    ----------
    workers : int, optional
        Local processes, each with one thread of linear algebra; by default one per core
        that this process may use. 1 means no other process at all.
    dask : str, optional
        Address of a Dask scheduler, e.g. ``tcp://host:8786``; its workers must have this
        package, and run one task a process at a time, whatever their threads. `workers` is
        then not used.

    Yields
    ------
    concurrent.futures.Executor
        Shut down at the end of the block; tasks not begun by then are cancelled.

    Raises
    ------
    NeedleSimError
        When `workers` is below 1, or the cluster cannot be reached.
    """
    if dask is not None:
        with _dask(dask) as found:
            yield found
        return
    count = available_cores() if workers is None else workers
    if count < 1:
        raise NeedleSimError(f"workers = {count}: must be at least 1")
    if count == 1:
        yield SerialExecutor()
        return
    with one_thread_each():
        # spawned, not forked: a fork copies the locks of threads that it does not copy
        pool = ProcessPoolExecutor(
            count, mp_context=get_context("spawn"), initializer=end_with_parent
        )
        try:
            yield pool
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def available_cores() -> int:
    """Return the number of cores that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on every system
        return os.cpu_count() or 1


def end_with_parent() -> None:
    """End this process, which another one started, as soon as that one has ended.

    However it ended: one that was killed cannot tell its children. A signal at the parent's
    death would come from the thread that started this process, too early.
    """
    parent = parent_process()
    if parent is None:
        return
    sentinel = parent.sentinel

    def watch() -> None:
        wait([sentinel])
        os._exit(1)

    threading.Thread(target=watch, name="parent", daemon=True).start()


@contextmanager
def one_thread_each() -> Iterator[None]:
    """Have processes started from here use one thread of linear algebra."""
    before = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextmanager
def _dask(address: str) -> Iterator[Executor]:
    try:
        from distributed import Client
    except ImportError:
        raise NeedleSimError(
            "--dask needs the package distributed: pip install 'needle_sim_ros[dask]'"
        ) from None
    try:
        client: Any = Client(address, timeout=10)
    except (OSError, ValueError, TypeError) as error:
        words = " ".join(str(error).split())
        raise NeedleSimError(f"no Dask scheduler at {address}: {words}") from error
    try:
        _check_cluster(client, address)
        found = _OneAtATime(client.get_executor(pure=False))
        yield found
        found.shutdown(wait=True)
    finally:
        client.close()


def _check_cluster(client: Any, address: str) -> None:
    """Refuse a cluster on which tasks would wait for ever: what cannot be read is not answered."""
    package = __name__.partition(".")[0]
    workers = client.run(find_spec, package)  # of the standard library: anybody can read it
    if not workers:
        raise NeedleSimError(f"the Dask cluster at {address} has no workers")
    without = [worker for worker, spec in workers.items() if spec is None]
    if client.run_on_scheduler(find_spec, package) is None:
        without.append("its scheduler")
    if without:
        raise NeedleSimError(
            f"the Dask cluster at {address} lacks the package {package} on {', '.join(without)}"
        )
