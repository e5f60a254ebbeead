"""Foreign code that the user has allowed to run, by the digests of its files, in a file of the user's own folder."""

import json
from contextlib import suppress
from hashlib import blake2b
from pathlib import Path

from kennfeld.atomic_files import write_whole

MAX_DIGESTS = 1000  # the oldest ones are forgotten
_allowed_here: set[str] = set()  # also if the file cannot be written


def consent_file() -> Path:
    """Return where the digests are kept."""
    return Path.home() / ".kennfeld" / "allowed-code.json"


def content_digest(path: Path) -> str:
    """Return the digest of the contents of a file. Raises `OSError` if it cannot be read."""
    return blake2b(path.read_bytes(), digest_size=32).hexdigest()


def is_allowed(digest: str) -> bool:
    """Return if the user has allowed to run a file with these contents."""
    return digest in _allowed_here or digest in _kept()


def allow(digest: str) -> None:
    """Keep that a file with these contents may run."""
    _allowed_here.add(digest)
    path = consent_file()
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        others = [each for each in _kept() if each != digest]
        write_whole(path, json.dumps([*others, digest][-MAX_DIGESTS:]).encode())


def _kept() -> list[str]:
    """Return the digests of the file; a damaged file has none."""
    try:
        digests = json.loads(consent_file().read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return []
    return [each for each in digests if isinstance(each, str)] if isinstance(digests, list) else []
