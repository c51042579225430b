# SPDX-License-Identifier: Apache-2.0
"""Work on processes: results, errors, one thread of linear algebra, Dask."""

import os
import time

import pytest

from needle_sim_ros.errors import NeedleSimError, SceneError
from needle_sim_ros.parallel import SerialExecutor, executor
from needle_sim_ros.resources import find_scene


def test_one_worker_is_this_process():
    with executor(1) as pool:
        assert isinstance(pool, SerialExecutor)
        assert pool.submit(os.getpid).result() == os.getpid()
        with pytest.raises(SceneError, match="no_such_scene"):
            pool.submit(find_scene, "no_such_scene").result()


def test_workers_are_processes_with_one_thread_each(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    with executor(2) as pool:
        assert pool.submit(os.getpid).result() != os.getpid()
        assert pool.submit(os.getenv, "OMP_NUM_THREADS").result() == "1"
        with pytest.raises(SceneError, match="no_such_scene"):
            pool.submit(find_scene, "no_such_scene").result()
    assert os.environ["OMP_NUM_THREADS"] == "7"


def test_no_workers_are_refused():
    with pytest.raises(NeedleSimError, match="workers = 0: must be at least 1"), executor(0):
        pass


def test_a_dask_cluster_runs_one_task_a_process_at_a_time(dask_address):
    """What a process keeps is not for two threads, and a worker has as many as it likes."""

    def running(seconds):  # sent as it is: the worker does not know this file
        begin = time.monotonic()
        time.sleep(seconds)
        return begin, time.monotonic()

    with executor(dask=dask_address) as pool:
        assert list(pool.map(abs, [-1, 2, -3])) == [1, 2, 3]
        assert pool.submit(os.getpid).result() != os.getpid()
        (begin, end), (other_begin, other_end) = pool.map(running, [0.05, 0.05])
        assert end <= other_begin or other_end <= begin
        with pytest.raises(SceneError, match="no_such_scene"):
            pool.submit(find_scene, "no_such_scene").result()


def test_an_address_without_scheduler_is_one_clear_message():
    pytest.importorskip("distributed")
    message = "no Dask scheduler at nonsense"
    with pytest.raises(NeedleSimError, match=message), executor(dask="nonsense://here"):
        pass


def test_a_cluster_that_cannot_work_is_refused():
    """Tasks for it would wait without end."""
    distributed = pytest.importorskip("distributed")
    options = {"processes": False, "dashboard_address": None, "protocol": "tcp://"}
    with (
        distributed.LocalCluster(n_workers=0, **options) as cluster,
        pytest.raises(NeedleSimError, match="has no workers"),
        executor(dask=cluster.scheduler_address),
    ):
        pass
