import pytest

from tests.app.browser import close_browser
from tests.report.report_projects import PROJECTS, Page, Workshop


@pytest.fixture(scope="session", autouse=True)
def end_browser():
    yield
    close_browser()


@pytest.fixture
def shop(tmp_path):
    """A folder in which projects are written."""
    return Workshop(tmp_path)


@pytest.fixture(params=PROJECTS, ids=lambda build: build.__name__)
def project(request, shop):
    """Each of the projects that a report has to cope with."""
    return request.param(shop)


@pytest.fixture
def opened():
    """Takes a report apart."""
    return Page
