"""A restarted server is picked up by the pages that were open before.

Port and a key are kept in a file of the user that nobody else can read, for each project. The same project takes the
same port again, if it is free. An open page knows the key, and both sides prove it to each other without sending it:

    page    opens the socket /again, and sends {"nonce": n}, a random text
    server  {"challenge": c, "proof": HMAC(key, "server:PORT:n")}
    page    POST /again {"challenge": c, "proof": HMAC(key, "page:PORT:c")}
    server  204 and the cookie of this start

A program that waits at the port in place of the server learns only a cookie that no server accepts any more, and cannot
relay the proofs to a server at another port. Tokens and cookies are new at every start.
"""

import hashlib
import hmac
import json
import os
import secrets
import stat
import time
from collections import deque
from contextlib import suppress
from pathlib import Path
from typing import Any

from kennfeld.base.atomic_files import write_whole
from kennfeld.base.lazy_dataclass import dataclass

MAX_AGE = 30 * 86_400  # s after which a key is forgotten
MAX_SERVERS = 50  # files that are kept
MAX_CHALLENGES = 16  # that wait for a proof
MAX_NONCE = 200  # characters


@dataclass(frozen=True)
class KnownServer:
    """Port and key of the last server of a project."""

    port: int
    key: str


def servers_folder() -> Path:
    """Return the folder of the files, one for each project."""
    return Path.home() / ".kennfeld" / "servers"


def _file(project: Path | None) -> Path:
    name = hashlib.sha256(str((project or Path.cwd()).resolve()).encode()).hexdigest()[:32]
    return servers_folder() / f"{name}.json"


def known_server(project: Path | None) -> KnownServer | None:
    """Return the last server of a project; None if there is none, or if others could have read or written its file."""
    try:
        content = _read_private(_file(project))
        known = KnownServer(int(content["port"]), str(content["key"]))
        age = time.time() - float(content["time"])
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return known if 0 < known.port < 65536 and len(known.key) >= 32 and 0 <= age < MAX_AGE else None


def _read_private(path: Path) -> dict[str, Any]:
    """Read a JSON file that belongs to the user and to nobody else. Raises `OSError` or `ValueError`."""
    # opened first, then checked by its handle: the file cannot be exchanged in between
    handle = os.open(path, os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0))
    with os.fdopen(handle, encoding="utf-8") as file:
        state = os.fstat(handle)
        if os.name == "posix" and (state.st_uid != os.getuid() or stat.S_IMODE(state.st_mode) & 0o077):
            raise PermissionError(f"{path} can be read by others")
        content: dict[str, Any] = json.loads(file.read(10_000))
    return content


def remember_server(project: Path | None, known: KnownServer) -> None:
    """Keep port and key of a server. A folder that cannot be written is not an error."""
    path = _file(project)
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        content = json.dumps({"port": known.port, "key": known.key, "time": time.time()})
        write_whole(path, content, private=True)
        files = sorted(path.parent.glob("*.json"), key=lambda each: each.stat().st_mtime)
        for old in files[:-MAX_SERVERS]:
            old.unlink(missing_ok=True)


class Handshake:
    """The server's side of the proofs.

    Args:
        port: port of the server.
        key: secret that the pages know.
    """

    def __init__(self, port: int, key: str) -> None:
        self._port, self._key = port, key
        # bounded, as anybody on this machine may ask for challenges
        self._challenges: deque[str] = deque(maxlen=MAX_CHALLENGES)

    def proof(self, side: str, text: str) -> str:
        """Return the proof of one side for a random text."""
        return hmac.new(self._key.encode(), f"{side}:{self._port}:{text}".encode(), "sha256").hexdigest()

    def challenge(self, nonce: object) -> dict[str, str] | None:
        """Return the proof of the server and a challenge for the page; None if the question is malformed."""
        if not isinstance(nonce, str) or not 16 <= len(nonce) <= MAX_NONCE:
            return None
        challenge = secrets.token_hex(32)
        self._challenges.append(challenge)
        return {"challenge": challenge, "proof": self.proof("server", nonce)}

    def accepts(self, challenge: object, proof: object) -> bool:
        """Check the proof of a page; each challenge counts once."""
        if not isinstance(challenge, str) or not isinstance(proof, str) or challenge not in self._challenges:
            return False
        # before the comparison, so that a challenge cannot be tried twice
        self._challenges.remove(challenge)
        return secrets.compare_digest(self.proof("page", challenge).encode(), proof.encode("utf-8", "replace"))
