"""Asks before a command runs code that a project names, or uses its addresses: once on a terminal, else refused."""

import os
import select
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import click

from kennfeld.base.consent_gate import Kind, address_gate
from kennfeld.base.errors import Finding, InputError, Location
from kennfeld.base.formatting import join_names
from kennfeld.graph.external_function import CodeNotRunError, ExternalFunction, code_gate
from kennfeld.graph.node import Node
from kennfeld.models.code_consent import ConsentRequest, address_request, allow, code_files, code_request
from kennfeld.project.consent import consent_requests, scheduler_request
from kennfeld.project.project import Project
from kennfeld.terminal.output import print_always

MAX_NAMES = 4
POLL_INTERVAL = 0.2  # s
UNASKED = "Look into it first. Then answer on a terminal, or add --trust."

Gate = Callable[[ExternalFunction], None]


class Consent:
    """Consent of the user while a command runs.

    Args:
        trust: allow everything without a question.
        joins: the address of a scheduler that the user has named on the command line.
    """

    def __init__(self, trust: bool, joins: str | None = None) -> None:
        self._trust, self._joins = trust, joins
        self._lock = threading.Lock()  # files are read by several threads

    def require_all(self, project: Project) -> None:
        """Ask for all that a project needs at once. Raises `InputError` if the user does not allow it."""
        scheduler = scheduler_request(project.file, project.cluster_address)
        self._require([*consent_requests(project.file), *([scheduler] if scheduler else [])])

    def require_code(self, function: ExternalFunction) -> None:
        """Ask for the code of a function; a gate of `code_gate`."""
        if function.file is not None and (request := code_request(function.file)) is not None:
            self._require([request])

    def require_address(self, kind: Kind, name: str) -> None:
        """Ask for an address; a gate of `address_gate`."""
        self._require([address_request(kind, name)])

    def _require(self, requests: Sequence[ConsentRequest]) -> None:
        with self._lock:
            new = [each for each in requests if not each.is_allowed and not self._is_named(each)]
            if not new:
                return
            if self._trust:
                for request in new:
                    print_always(_remark(request))
            elif not _is_terminal():
                raise _refusal(new, UNASKED)
            elif not _agrees(new):
                raise _refusal(new)
            for request in new:
                allow(request.digest)

    def _is_named(self, request: ConsentRequest) -> bool:
        return request.kind == "scheduler" and request.file == self._joins


def _remark(request: ConsentRequest) -> Finding:
    said = "Said once for each content of the file." if request.kind == "code" else "Said once for each address."
    return Finding(Location(), request.text, said, severity="remark")


def _refusal(requests: Sequence[ConsentRequest], remedy: str = "") -> InputError:
    findings = [Finding(each.location, each.finding.message, remedy) for each in requests]
    return CodeNotRunError(findings) if any(each.kind == "code" for each in requests) else InputError(findings)


def _is_terminal() -> bool:
    # the question is printed on stderr, so that stdout may be a file
    return sys.stdin is not None and sys.stdin.isatty() and sys.stderr.isatty()


def _agrees(requests: Sequence[ConsentRequest]) -> bool:
    for request in requests:
        print_always(Finding(Location(), f"The project {request.text}.", severity="remark"))
    question = "Allow it, with all your rights? Answer y only if you trust who wrote the project"
    click.echo(f"{question} [y/N]: ", nl=False, err=True)
    _wait_for_input()
    return click.confirm("", default=False, show_default=False, prompt_suffix="", err=True)


def _wait_for_input() -> None:
    """Wait for a line on a terminal, in short intervals, so that no signal is missed before the read that blocks."""
    if os.name == "posix" and sys.stdin.isatty():
        while not select.select([sys.stdin], [], [], POLL_INTERVAL)[0]:
            pass


@contextmanager
def asked_consent(consent: Consent) -> Iterator[None]:
    """Ask before code of a file runs in the block, or an address is used, that this user has not allowed before."""
    with code_gate(consent.require_code), address_gate(consent.require_address):
        yield


@contextmanager
def refused_code(consent: Consent) -> Iterator[None]:
    """Let no code of a file run in the block: what would run it raises `CodeNotRunError`; ask for addresses."""
    with code_gate(_refuse), address_gate(consent.require_address):
        yield


def unchecked_code(nodes: Iterable[Node], path: Path) -> Iterator[Finding]:
    """Yield a remark on the files of a project whose code was not run."""
    names = [file.name for file in code_files(nodes)]
    if names:
        message = f"not checked, because code of {join_names(names, MAX_NAMES, ' and ')} was not run: its values"
        yield Finding(Location(path.name), message, severity="remark")


def _refuse(function: ExternalFunction) -> None:
    if function.file is not None:
        raise CodeNotRunError([Finding(Location(function.file.name), "its code was not run")])
