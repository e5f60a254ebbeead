from functools import cache

import pytest

from tests.app.browser import close_browser
from tests.report.report_projects import PROJECTS, CalibratedProject, Page, Workshop


@pytest.fixture(scope="session", autouse=True)
def end_browser():
    yield
    close_browser()


@pytest.fixture
def shop(tmp_path):
    """A folder in which projects are written."""
    return Workshop(tmp_path)


@pytest.fixture(scope="session")
def calibrated(tmp_path_factory):
    """Return the calibrated project of a function that writes one, made once; nothing may change its folder."""
    return cache(lambda build: CalibratedProject(build(Workshop(tmp_path_factory.mktemp(build.__name__)))))


@pytest.fixture(params=PROJECTS, ids=lambda build: build.__name__)
def project(request, calibrated):
    """Each of the projects that a report has to cope with."""
    return calibrated(request.param)


@pytest.fixture
def opened():
    """Return the function that takes a report apart."""
    return Page
