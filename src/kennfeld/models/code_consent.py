"""Consent of the user to run code of files, and to use addresses, that a project names.

Commands and the app ask once for each content of a file with all that its code loads, and once for each address. What
the user allowed is remembered by digests, in a file of the user's own folder.
"""

import json
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from hashlib import blake2b
from pathlib import Path
from typing import Literal

from kennfeld.base.atomic_files import write_whole
from kennfeld.base.consent_gate import Kind, address_gate
from kennfeld.base.errors import Finding, Location
from kennfeld.base.formatting import join_names
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.machine_code.code_cache import is_own
from kennfeld.graph.external_function import CodeNotRunError, ExternalFunction, code_gate
from kennfeld.graph.node import Node
from kennfeld.models.function_files import code_digest, companion_files

MAX_DIGESTS = 1000  # the oldest ones are forgotten
_allowed_here: set[str] = set()  # also if the file cannot be written


MAX_NAMES = 4  # of further files that a message lists
_NOWHERE = Location()
REMEDY = "Allow it if you trust who wrote it."


@dataclass(frozen=True)
class ConsentRequest:
    """A question to the user: code of a file to run, or an address to use.

    Attributes:
        kind: code of a file that runs, or an address that is used.
        file: the name of the file, or the address.
        digest: what is remembered; empty if it cannot be allowed, as a file that cannot be read.
        location: the key that names it.
        others: names of the other files that the code loads.
    """

    kind: Kind | Literal["code"]
    file: str
    digest: str
    location: Location = Location()
    others: tuple[str, ...] = ()

    @property
    def is_allowed(self) -> bool:
        """True if the user has allowed it before."""
        return is_allowed(self.digest)

    @property
    def text(self) -> str:
        """A sentence without a subject: `runs code of my.py with helper.py`."""
        match self.kind:
            case "code":
                loaded = f" with {join_names(self.others, MAX_NAMES, ' and ')}" if self.others else ""
                return f"runs code of {self.file}{loaded}"
            case "scheduler":
                return f"joins the scheduler {self.file}, which can run code here"
            case "store":
                return f"reads files from {self.file}"
            case "folder":
                return f"keeps prepared recordings in {self.file}, outside of its folder"

    @property
    def finding(self) -> Finding:
        """The error that it has not been allowed."""
        return Finding(self.location, f"{self.text}, and has not been allowed to", REMEDY)


def code_request(path: Path, location: Location = _NOWHERE) -> ConsentRequest | None:
    """Return the request to run code of a file; None if the file cannot be read, which its reader reports."""
    try:
        others = tuple(each.relative_to(path.resolve().parent).as_posix() for each in companion_files(path))
        return ConsentRequest("code", path.name, code_digest(path), location, others)
    except OSError:
        return None


def address_request(kind: Kind, name: str, location: Location = _NOWHERE) -> ConsentRequest:
    """Return the request to use an address."""
    # the kind is part of it: consent to read from an address is not consent to join it as a scheduler
    digest = blake2b(f"{kind} {name}".encode("utf-8", "surrogateescape"), digest_size=32).hexdigest()
    return ConsentRequest(kind, name, digest, location)


def consent_file() -> Path | None:
    """Return where the digests are kept; None if the user has no folder."""
    with suppress(RuntimeError):
        return Path.home() / ".kennfeld" / "allowed-code.json"
    return None


def content_digest(path: Path) -> str:
    """Return the digest of the contents of a file, and of all that its code loads. Raises `OSError`."""
    return code_digest(path)


def is_allowed(digest: str) -> bool:
    """Return if the user has allowed what has this digest."""
    return digest in _allowed_here or digest in _kept()


def allow(digest: str) -> None:
    """Remember that the user allows what has this digest."""
    _allowed_here.add(digest)
    path = consent_file()
    if path is None:
        return
    with suppress(OSError):
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        # moved to the end, as the first ones are forgotten
        others = [each for each in _kept() if each != digest]
        write_whole(path, json.dumps([*others, digest][-MAX_DIGESTS:]).encode())


@contextmanager
def allowed_only() -> Iterator[None]:
    """Refuse code and addresses in the block that the user has not allowed."""

    def require(request: ConsentRequest | None) -> None:
        if request is not None and not request.is_allowed:
            raise CodeNotRunError([request.finding])

    def require_code(function: ExternalFunction) -> None:
        require(None if function.file is None else code_request(function.file))

    with code_gate(require_code), address_gate(lambda kind, name: require(address_request(kind, name))):
        yield


def code_files(nodes: Iterable[Node]) -> tuple[Path, ...]:
    """Return the files whose code the nodes of a graph run."""
    files = (node.payload.function.file for node in nodes if node.op == "external")
    return tuple(dict.fromkeys(file for file in files if file is not None))


def _kept() -> list[str]:
    """Return the digests of the file; a damaged file, or one that others can write, has none."""
    path = consent_file()
    try:
        if path is None or not is_own(path.stat()):
            return []
        digests = json.loads(path.read_text(encoding="utf-8"))
    # RecursionError: JSON that is nested too deeply
    except (OSError, ValueError, RecursionError):
        return []
    return [each for each in digests if isinstance(each, str)] if isinstance(digests, list) else []
