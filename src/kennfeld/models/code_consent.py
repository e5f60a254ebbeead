"""Foreign code that the user knows to run, by the digests of its files, in a file of the user's own folder.

The command line says once for each content of a file that its code runs; the app asks before. Both remember here that
the user knows the content.
"""

import json
from collections.abc import Iterable
from contextlib import suppress
from hashlib import blake2b
from pathlib import Path

from kennfeld.atomic_files import write_whole
from kennfeld.graph.node import Node
from kennfeld.machine_code.code_cache import is_own

MAX_DIGESTS = 1000  # the oldest ones are forgotten
_allowed_here: set[str] = set()  # also if the file cannot be written


def consent_file() -> Path | None:
    """Return where the digests are kept; None if the user has no folder."""
    with suppress(RuntimeError):
        return Path.home() / ".kennfeld" / "allowed-code.json"
    return None


def content_digest(path: Path) -> str:
    """Return the digest of the contents of a file. Raises `OSError` if it cannot be read."""
    return blake2b(path.read_bytes(), digest_size=32).hexdigest()


def is_allowed(digest: str) -> bool:
    """Return if the user knows that a file with these contents runs."""
    return digest in _allowed_here or digest in _kept()


def allow(digest: str) -> None:
    """Keep that a file with these contents may run."""
    _allowed_here.add(digest)
    path = consent_file()
    if path is None:
        return
    with suppress(OSError):
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        others = [each for each in _kept() if each != digest]
        write_whole(path, json.dumps([*others, digest][-MAX_DIGESTS:]).encode())


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
    except (OSError, ValueError, RecursionError):
        return []
    return [each for each in digests if isinstance(each, str)] if isinstance(digests, list) else []
