"""The files of the page: compressed for browsers that can read that, sent once, and no others."""

import gzip
from pathlib import Path

import pytest

from kennfeld.app.server.static_files import StaticFiles

SCRIPT = b"export const answer = 42;\n"


@pytest.fixture
def files(tmp_path: Path) -> StaticFiles:
    (tmp_path / "static").mkdir()
    (tmp_path / "secret").write_text("secret")
    (tmp_path / "static/app.js").write_bytes(SCRIPT)
    (tmp_path / "static/icon.svg").write_text("<svg/>")
    return StaticFiles(tmp_path / "static")


def request(files: StaticFiles, path: str, method: str = "GET", **headers: str) -> tuple[int, dict[str, str], bytes]:
    own = [(name.replace("_", "-").encode(), value.encode()) for name, value in headers.items()]
    sent = []

    async def send(message):  # type: ignore[no-untyped-def]
        sent.append(message)

    async def receive():  # type: ignore[no-untyped-def]
        raise AssertionError("a request for a file has no body")

    answer = files({"type": "http", "method": method, "path": path, "headers": own}, receive, send)
    with pytest.raises(StopIteration):  # the end of a coroutine that waits for nothing; no loop of events is needed
        answer.send(None)
    begin, *parts = sent
    known = {name.decode(): value.decode() for name, value in begin["headers"]}
    return begin["status"], known, b"".join(part["body"] for part in parts)


def test_a_browser_that_reads_gzip_gets_the_compressed_content(files: StaticFiles) -> None:
    status, headers, body = request(files, "/static/app.js", accept_encoding="gzip, deflate, br")
    assert (status, gzip.decompress(body)) == (200, SCRIPT)
    assert headers["content-encoding"] == "gzip"
    assert headers["content-type"] == "text/javascript; charset=utf-8"
    assert headers["content-length"] == str(len(body))


def test_other_programs_get_it_as_it_is(files: StaticFiles) -> None:
    status, headers, body = request(files, "/static/app.js")
    assert (status, body, headers["vary"]) == (200, SCRIPT, "accept-encoding")
    assert "content-encoding" not in headers
    assert request(files, "/static/icon.svg", accept_encoding="gzip")[1]["content-type"] == "image/svg+xml"


@pytest.mark.parametrize("encoding", ["", "gzip"])
def test_a_browser_that_has_a_file_does_not_get_it_again(files: StaticFiles, encoding: str) -> None:
    _, headers, _ = request(files, "/static/app.js", accept_encoding=encoding)
    status, again, body = request(files, "/static/app.js", accept_encoding=encoding, if_none_match=headers["etag"])
    assert (status, again["etag"], body) == (304, headers["etag"], b"")
    other = {"": "gzip", "gzip": ""}[encoding]
    assert request(files, "/static/app.js", accept_encoding=other, if_none_match=headers["etag"])[0] == 200


@pytest.mark.parametrize(
    "path", ["/static/", "/static/../secret", "/static/none.js", "/static/app.js.gz", "/static//etc/passwd"]
)
def test_nothing_else_is_served(files: StaticFiles, path: str) -> None:
    assert request(files, path)[::2] == (404, b"Not Found")


def test_files_are_read_only(files: StaticFiles) -> None:
    assert request(files, "/static/app.js", "POST")[0] == 405
