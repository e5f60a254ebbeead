"""The built page: its files in memory, compressed if the browser can read that.

They are few and small. Threads that read them, as for downloads, would wait for the one that loads the application
while the page is opened.
"""

import gzip
import mimetypes
from collections.abc import Mapping
from hashlib import blake2b
from pathlib import Path

from starlette.datastructures import Headers
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from kennfeld.base.lazy_dataclass import dataclass

LEVEL = 6  # higher ones save less than 1 %
COMPRESSED = (".js", ".css", ".svg", ".html")
# not those of the system, which may know scripts by names that browsers do not run
_TYPES = {".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml", ".html": "text/html"}


@dataclass(frozen=True)
class _SentFile:
    """A file as it is sent: its content, its headers, and the tag by which a browser knows that it has it."""

    content: bytes
    headers: Mapping[str, str]
    tag: str


class StaticFiles:
    """Serves the files of a folder, which do not change."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._names = {path.name for path in folder.iterdir() if path.is_file()}
        self._read: dict[tuple[str, bool], _SentFile] = {}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        await self._response(scope)(scope, receive, send)

    def _response(self, scope: Scope) -> Response:
        if scope["method"] not in ("GET", "HEAD"):
            return Response("Method Not Allowed", 405)
        # a name of the folder, so that no path leads out of it
        name = scope["path"].rpartition("/static/")[2]
        if name not in self._names:
            return Response("Not Found", 404)
        headers = Headers(scope=scope)
        compressed = name.endswith(COMPRESSED) and "gzip" in headers.get("accept-encoding", "")
        file = self._file(name, compressed=compressed)
        if file.tag in headers.get("if-none-match", ""):
            return Response(status_code=304, headers=file.headers)
        return Response(file.content, headers=file.headers)

    def _file(self, name: str, *, compressed: bool) -> _SentFile:
        key = name, compressed
        if key not in self._read:
            content = (self._folder / name).read_bytes()
            if compressed:
                content = gzip.compress(content, LEVEL, mtime=0)
            self._read[key] = _SentFile(content, _headers(name, content, compressed=compressed), _tag(content))
        return self._read[key]


def _headers(name: str, content: bytes, *, compressed: bool) -> dict[str, str]:
    kind = _TYPES.get(Path(name).suffix) or mimetypes.guess_type(name)[0] or "application/octet-stream"
    charset = "; charset=utf-8" if kind.startswith("text/") else ""
    own = {"content-type": f"{kind}{charset}", "etag": _tag(content), "cache-control": "no-cache"}
    return own | {"vary": "accept-encoding"} | ({"content-encoding": "gzip"} if compressed else {})


def _tag(content: bytes) -> str:
    return f'"{blake2b(content, digest_size=12).hexdigest()}"'
