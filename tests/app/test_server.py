"""The server: who may talk to it, what it survives, and several pages on one project."""

import asyncio
import io
import json
import os
import re
import struct
import subprocess
import sys
import time
import zipfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from starlette.websockets import WebSocketDisconnect
from websockets.exceptions import ConnectionClosed, InvalidStatus

from kennfeld.app.answer import Answer
from kennfeld.app.server.server import OpenPage, packed
from kennfeld.project.demo import write
from tests.app.serving import Page, Served, served


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    path = write("torque", tmp_path_factory.mktemp("app") / "torque")
    with served(path) as running:
        yield running


def test_the_printed_address_opens_the_page(server: Served) -> None:
    status, headers, _ = server.request("GET", f"/?token={server.token}")
    assert (status, headers["location"]) == (303, "/")
    cookie = headers["set-cookie"]
    assert cookie == f"{server.cookie}; Path=/; HttpOnly; SameSite=Strict"
    status, headers, body = server.request("GET", "/", {"Cookie": server.cookie})
    assert status == 200
    assert b"/static/app.js" in body
    assert "default-src 'none'" in headers["content-security-policy"]
    assert headers["x-content-type-options"] == "nosniff"


@pytest.mark.parametrize(
    "path", ["/", "/?token=wrong", "/?token=", "/static/app.js", "/file/kennfeld.toml", "/nowhere"]
)
def test_nothing_is_served_without_the_token(server: Served, path: str) -> None:
    status, _, body = server.request("GET", path)
    assert status == 403
    assert b"torque" not in body


@pytest.mark.parametrize(
    "cookie", ["", "kennfeld-{port}=", "kennfeld-{port}=wrong", "other={token}", "kennfeld-{port}=\xff", "=;;,{{"]
)
def test_other_cookies_are_refused(server: Served, cookie: str) -> None:
    value = cookie.format(port=server.port, token=server.token)
    assert server.request("GET", "/static/app.js", {"Cookie": value})[0] == 403


@pytest.mark.parametrize("host", ["evil.example", "evil.example:{port}", "127.0.0.1", "localhost:1", ""])
def test_a_foreign_host_is_refused(server: Served, host: str) -> None:
    status, _, body = server.request("GET", "/", {"Host": host.format(port=server.port), "Cookie": server.cookie})
    assert status in (400, 421)
    assert b"Kennfeld" not in body


def test_localhost_is_the_same_server(server: Served) -> None:
    assert server.request("GET", "/", {"Host": f"localhost:{server.port}", "Cookie": server.cookie})[0] == 200


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "https://127.0.0.1", "http://127.0.0.1:1"])
def test_another_page_cannot_open_the_socket(server: Served, origin: str) -> None:
    with pytest.raises(InvalidStatus), server.page(Origin=origin):
        pass


def test_a_socket_without_the_cookie_is_refused(server: Served) -> None:
    with pytest.raises(InvalidStatus), server.page(Cookie="kennfeld-1=x"):
        pass


def test_uploads_of_other_pages_are_refused(server: Served) -> None:
    headers = {"Cookie": server.cookie, "Origin": "http://evil.example"}
    assert server.request("PUT", "/upload/a.csv", headers, b"x")[0] == 403
    assert server.request("PUT", "/upload/a.csv", {"Cookie": server.cookie}, b"x")[0] == 403


@pytest.mark.parametrize(
    "path", ["/file/../secret.txt", "/file/%2e%2e/secret.txt", "/file//etc/passwd", "/file/link/hosts"]
)
def test_files_outside_the_folder_are_not_served(server: Served, path: str) -> None:
    status, _, body = server.request("GET", path, {"Cookie": server.cookie})
    assert status in (400, 404)
    assert b"root:" not in body


MALFORMED = [
    "",
    "{",
    "[]",
    "null",
    '"x"',
    "1e999",
    '{"ask": "table"}',
    '{"id": 1}',
    '{"id": 1, "ask": 5}',
    '{"id": 1, "ask": "__class__"}',
    '{"id": 1, "ask": "table", "with": {"name": "nope"}}',
    '{"id": 1, "ask": "table", "with": 3}',
    '{"id": 1, "ask": "set-values", "with": {"name": "MapOptTorque", "cells": [99999], "values": [1], "title": "x"}}',
    '{"id": 1, "ask": "set-values", "with": {"name": "MapOptTorque", "cells": ["a"], "values": [1], "title": "x"}}',
    '{"id": 1, "ask": "strip", "with": {"dataset": 99, "signals": [], "begin": 0, "end": 1, "pixels": 10}}',
    '{"id": 1, "ask": "strip", "with": {"dataset": 0, "signals": [{}], "begin": 0, "end": 1, "pixels": 1}}',
    "[" * 100_000,
]


@pytest.mark.parametrize("message", MALFORMED)
def test_a_malformed_question_gets_an_answer_and_the_socket_stays_open(server: Served, message: str) -> None:
    with server.page() as page:
        page.socket.send(message)
        # news of what other pages did may come first
        error = next(head["error"] for head, _ in iter(page.receive, None) if "error" in head)
        assert error
        assert "Traceback" not in error
        assert "table" in page.ask("table", name="MapOptTorque")[0]


def test_an_oversized_message_closes_only_its_socket(server: Served) -> None:
    with server.page() as page:
        page.socket.send("x" * 5_000_000)
        with pytest.raises(ConnectionClosed):
            page.receive()
    with server.page() as page:
        assert page.state["project"]["name"] == "torque"


def test_a_page_that_does_not_read_does_not_stop_the_others(server: Served) -> None:
    with server.page() as slow, server.page() as page:
        for number in range(200):
            slow.socket.send(json.dumps({"id": number, "ask": "table", "with": {"name": "MapOptTorque"}}))
        assert "table" in page.ask("table", name="MapOptTorque")[0]


def test_all_pages_see_an_edit_and_its_undo(server: Served) -> None:
    with server.page() as first, server.page() as second:
        before = second.state["scores"][0]["rmse"]
        first.ask("set-values", name="MapOptTorque", cells=[0, 1], values=[150.0, 160.0], title="Typed")
        while second.state["undo"] != "Typed":  # another test may have left something to undo
            second.receive()
        assert second.state["scores"][0]["rmse"] != before
        assert second.ask("undo")[0]["title"] == "Typed"
        while first.state["undo"] == "Typed":
            first.receive()
        assert first.state["scores"][0]["rmse"] == before


def test_a_run_reports_its_course_and_ends(server: Served) -> None:
    with server.page() as page:
        page.ask("run")
        page.wait_for("converged")
        head, arrays = page.ask("progress")
        assert head["starts"][0]["state"] == "converged"
        assert arrays["rmse 1"][-1] < arrays["rmse 1"][0]
        assert page.state["scores"][0]["rmse"] < 2.0
        assert page.ask("trust")[0]["coupled"]


def test_an_uploaded_file_is_stored_beside_the_project(server: Served) -> None:
    headers = {"Cookie": server.cookie, "Origin": f"http://{server.host}"}
    status, _, body = server.request("PUT", "/upload/..%2Fnew%20run.csv", headers, b"a,b\n1,2\n")
    assert (status, json.loads(body)) == (200, {"file": "new run.csv"})
    assert server.request("GET", "/file/new%20run.csv", {"Cookie": server.cookie})[2] == b"a,b\n1,2\n"


def test_a_file_name_with_markup_stays_text(server: Served) -> None:
    headers = {"Cookie": server.cookie, "Origin": f"http://{server.host}"}
    name = "<script>alert(1)</script>.csv"
    status, answer, body = server.request(
        "PUT", "/upload/" + name.replace("<", "%3C").replace(">", "%3E"), headers, b"x"
    )
    assert status == 200
    assert "<" not in json.loads(body)["file"]
    assert answer["content-type"] == "application/json"


def test_the_folder_is_downloaded_without_recovery_files(server: Served) -> None:
    with server.page() as page:
        page.ask("set-values", name="MapOptTorque", cells=[0], values=[1.0], title="Typed")
        status, headers, body = server.request("GET", "/project.zip", {"Cookie": server.cookie})
        page.ask("undo")
    assert (status, headers["content-type"]) == (200, "application/zip")
    names = zipfile.ZipFile(io.BytesIO(body)).namelist()
    assert "torque/kennfeld.toml" in names
    assert not [name for name in names if ".kennfeld/" in name]
    assert server.request("GET", "/project.zip")[0] == 403


def test_a_port_that_is_taken_is_refused_in_one_line(server: Served, tmp_path: Path) -> None:
    from kennfeld.app.launch import launch
    from kennfeld.base.errors import InputError

    with pytest.raises(InputError, match=f"port {server.port} cannot be used"):
        launch(None, server.port, browser=False)


def test_a_run_may_report_after_the_server_has_ended() -> None:
    from kennfeld.app.server.server import Server
    from kennfeld.app.workspace import AppWorkspace

    server = Server(AppWorkspace())
    server._executor.shutdown()
    server._pump_from_thread("")


def test_a_page_opened_during_the_reading_of_its_project_shows_the_activity(
    torque: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = torque.parent / "seen"
    prelude = (
        "import time; from kennfeld.app.workspace import AppWorkspace\n"
        "def read(self, path, own=AppWorkspace.open, time=time):\n"
        f"    self.say('Reading'); file = type(path)({str(seen)!r})\n"
        "    while not file.exists(): time.sleep(0.01)\n"
        "    return own(self, path)\n"
        "AppWorkspace.open = read"
    )
    receive = Page.receive

    def receive_and_go_on(self: Page) -> Any:
        frame = receive(self)
        if self.activities == ["Reading"]:
            seen.touch()
        return frame

    monkeypatch.setattr(Page, "receive", receive_and_go_on)
    with served(torque, prelude=prelude) as server:
        assert server.request("GET", "/static/app.js", {"Cookie": server.cookie})[0] == 200
        with server.page() as page:
            assert page.activities[0] == "Reading"
            assert page.state["project"]["path"] == str(torque)


def test_a_project_that_cannot_be_opened_ends_the_server(tmp_path: Path) -> None:
    from kennfeld.app.server.serving import serve
    from kennfeld.app.workspace import AppWorkspace
    from kennfeld.base.errors import InputError

    with ThreadPoolExecutor(1) as pool, pytest.raises(InputError, match="the project file does not exist"):
        pool.submit(serve, AppWorkspace(), 0, lambda _: None, tmp_path / "kennfeld.toml").result()


@pytest.mark.parametrize(("content", "message"), [(None, "does not exist"), (b"\xff", "is not text in UTF-8")])
def test_what_is_not_a_project_is_refused_before_the_browser_starts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, content: bytes | None, message: str
) -> None:
    from kennfeld.app import launch
    from kennfeld.base.errors import InputError

    monkeypatch.setattr(launch, "serve", lambda *_: pytest.fail("served"))
    path = tmp_path / "kennfeld.toml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=message):
        launch.launch(path, browser=False)


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals as POSIX has them")
def test_sigterm_during_a_run_prints_nothing(tmp_path: Path) -> None:
    path = write("exhaust", tmp_path / "exhaust")
    line = [sys.executable, "-m", "kennfeld", "app", str(path), "--no-browser"]
    environment = {**os.environ, "HOME": str(tmp_path)}
    process = subprocess.Popen(line, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    match = re.fullmatch(r"Kennfeld runs at http://127\.0\.0\.1:(\d+)/\?token=(\S+)\n", process.stdout.readline())
    assert match is not None
    server = Served(int(match[1]), match[2], process)  # type: ignore[arg-type]
    with server.page() as page:
        page.ask("set-keys", title="long", changes=[[["optimizer", "starts"], 50]])
        page.ask("run")
        time.sleep(1.0)
        process.terminate()
        _, err = process.communicate(timeout=60)
    assert err == ""


@pytest.mark.parametrize("head", [{"id": 7, "seen": np.bool_(True)}, {"id": 7, "rmse": float("nan")}])
def test_an_answer_that_cannot_be_sent_is_an_error_that_can(head: dict[str, Any]) -> None:
    frame = packed(Answer(head, {"x": np.zeros(2)}))
    (length,) = struct.unpack_from("<I", frame)
    said = json.loads(frame[4 : 4 + length])
    assert said["id"] == 7
    assert said["error"].startswith("The answer cannot be sent: ")
    assert said["arrays"] == []


def test_the_state_after_a_command_precedes_its_answer_and_only_the_newest_one_waits() -> None:
    sent: list[tuple[object, object]] = []

    class Socket:
        async def send_bytes(self, data: bytes) -> None:
            head = json.loads(data[4 : 4 + struct.unpack_from("<I", data)[0]])
            sent.append((head.get("push", "answer"), head["number"]))
            if len(sent) == 5:
                raise WebSocketDisconnect

        async def close(self) -> None:
            """Close nothing."""

    page = OpenPage(Socket())  # type: ignore[arg-type]
    for number, topic in enumerate(["", "state", "state", "", "state", "activity", "state"]):
        page.put(Answer({"number": number}), topic)
    with ThreadPoolExecutor(1) as pool:  # the browser of other tests has an event loop in this thread
        pool.submit(asyncio.run, page.send_all()).result()
    assert sent == [("answer", 0), ("state", 2), ("answer", 3), ("activity", 5), ("state", 6)]
