"""FMUs run in the process of the tests, as they do in a watched process; `test_isolation` has those that do not."""

import pytest

from kennfeld.base.watch_folder import FOLDER


@pytest.fixture(scope="session")
def folder_of_watcher(tmp_path_factory):
    return tmp_path_factory.mktemp("watch")


@pytest.fixture(autouse=True)
def watched(request, monkeypatch, folder_of_watcher):
    if request.module.__name__.rpartition(".")[2] != "test_isolation":
        monkeypatch.setenv(FOLDER, str(folder_of_watcher))
