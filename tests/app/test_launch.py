"""The page is opened without showing the token to other users of the machine."""

import os
import stat
from pathlib import Path

import pytest

from kennfeld.app import launch
from tests.app.browser import browser_page
from tests.app.serving import served


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(Path, "home", classmethod(lambda cls: tmp_path))
    return tmp_path


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return the addresses with which a browser is started."""
    addresses: list[str] = []
    monkeypatch.setattr(launch.webbrowser, "open", addresses.append)
    return addresses


def serve_at(address: str, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Let the server begin at an address and end; return the tickets that it takes, and what the file had."""
    contents: list[str] = []

    def serve(workspace: object, port: int, ready: object, project: object, ticket: str, prepare: object) -> None:
        ready(address)  # type: ignore[operator]
        [file] = launch.servers_folder().glob("*.html")
        contents.extend([ticket, file.read_text()])
        if os.name == "posix":
            assert stat.S_IMODE(file.stat().st_mode) == 0o600
            assert stat.S_IMODE(file.parent.stat().st_mode) == 0o700

    monkeypatch.setattr(launch, "serve", serve)
    return contents


def test_the_browser_gets_a_file_without_the_token(
    home: Path, opened: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    contents = serve_at("http://127.0.0.1:8765/?token=secret", monkeypatch)
    launch.launch(None)
    ticket, content = contents
    assert f"url=http://127.0.0.1:8765/?open={ticket}" in content
    assert "secret" not in content
    [address] = opened
    assert address == (home / ".kennfeld/servers/open-8765.html").as_uri()
    assert not list(launch.servers_folder().glob("*.html"))  # removed at the end
    assert capsys.readouterr().out == "Kennfeld runs at http://127.0.0.1:8765/?token=secret\n"


def test_without_a_folder_the_address_is_printed_and_no_browser_starts(
    home: Path, opened: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (home / ".kennfeld").write_text("")
    monkeypatch.setattr(launch, "serve", lambda workspace, port, ready, *others: ready("http://127.0.0.1:1/"))
    launch.launch(None)
    assert (opened, capsys.readouterr().out) == ([], "Kennfeld runs at http://127.0.0.1:1/\n")


PRELUDE = "import kennfeld.app.launch as module; module.new_token = lambda: 'a-ticket-for-this-test'"


def test_a_ticket_opens_one_page(torque: Path) -> None:
    with served(torque, prelude=PRELUDE) as server:
        assert server.request("GET", "/?open=wrong")[0] == 403
        status, headers, body = server.request("GET", "/?open=a-ticket-for-this-test")
        assert (status, headers["set-cookie"]) == (200, f"{server.cookie}; Path=/; HttpOnly; SameSite=Strict")
        assert b"url=/" in body
        assert server.request("GET", "/?open=a-ticket-for-this-test")[0] == 403
        assert server.request("GET", "/?open=")[0] == 403


@pytest.mark.slow
def test_a_browser_that_opens_the_file_shows_the_page(torque: Path, home: Path) -> None:
    with served(torque, prelude=PRELUDE) as server:
        address = f"http://127.0.0.1:{server.port}/?token=none"
        file = launch.write_redirect(address, "a-ticket-for-this-test")
        with browser_page(file.as_uri()) as page:
            assert page.url.partition("#")[0] == f"http://127.0.0.1:{server.port}/"
            assert page.locator("#export").count() == 1
