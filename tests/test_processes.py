"""Processes start as fresh interpreters on all systems, as Windows and macOS start them: none is a fork."""

import pytest

from tests.source_facts import FILES, facts_of


@pytest.mark.skipif(not FILES, reason="the sources are not part of an installed package")
def test_the_package_forks_no_process():
    used = {name for path in FILES for name in facts_of(path).uses}
    assert "subprocess" in used
    assert {name for name in used if name.partition(".")[0] == "multiprocessing"} == set()
    assert used.isdisjoint({"os.fork", "os.forkpty", "concurrent.futures.ProcessPoolExecutor"})


def test_workers_of_a_local_cluster_are_spawned():
    pytest.importorskip("distributed")
    dask = pytest.importorskip("dask")
    assert dask.config.get("distributed.worker.multiprocessing-method") == "spawn"
