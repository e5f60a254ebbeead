"""Consent: code and clusters of a project run only if the user has allowed them."""

from kennfeld.base.dask_runner import ClusterAddress
from kennfeld.base.errors import InputError
from kennfeld.models.code_consent import ConsentRequest
from kennfeld.project import Project
from kennfeld.project.consent import consent_requests, scheduler_request
from kennfeld.project.schema import ProjectFile


def undecided_requests(project: Project, formula_text: str | None) -> tuple[ConsentRequest, ...]:
    """Return what the user has not allowed of the code that a project runs, and the addresses that it reads from."""
    requests = consent_requests(project.file, formula_text)
    return tuple(request for request in requests if not request.is_allowed)


def undecided_scheduler(file: ProjectFile, address: ClusterAddress | None) -> tuple[ConsentRequest, ...]:
    """Return the request for the scheduler of a project, which only runs join, unless the user has allowed it."""
    request = scheduler_request(file, address)
    return () if request is None or request.is_allowed else (request,)


def require_scheduler(file: ProjectFile, address: ClusterAddress | None) -> None:
    """Raise `InputError` if the user has not allowed the scheduler of a project."""
    if requests := undecided_scheduler(file, address):
        raise InputError(request.finding for request in requests)
