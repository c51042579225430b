# SPDX-License-Identifier: Apache-2.0
"""Work on processes: results, errors, one thread of linear algebra, Dask."""

import os

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


def test_a_dask_cluster_is_an_executor_too():
    distributed = pytest.importorskip("distributed")
    options = {"n_workers": 1, "threads_per_worker": 1, "dashboard_address": None}
    with (
        distributed.LocalCluster(processes=False, **options) as cluster,
        executor(dask=cluster.scheduler_address) as pool,
    ):
        assert list(pool.map(abs, [-1, 2, -3])) == [1, 2, 3]


def test_an_address_without_scheduler_is_one_clear_message():
    pytest.importorskip("distributed")
    message = "no Dask scheduler at nonsense"
    with pytest.raises(NeedleSimError, match=message), executor(dask="nonsense://here"):
        pass
