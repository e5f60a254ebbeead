"""Events that the page and the server survive: a restart, a dying worker, and an upload that breaks off."""

import json
import os
import signal
import socket
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from tests.app.app_processes import AppProcess
from tests.app.browser import READY, browser_page, started
from tests.app.serving import Served, served

pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning")


def type_value(page: Any, cell: str, value: str) -> None:
    page.click(f"[data-cell='{cell}']")
    page.keyboard.type(value)
    page.keyboard.press("Enter")
    page.wait_for_selector("small.dirty")
    page.wait_for_selector(READY)


def kill(process: AppProcess, page: Any) -> None:
    """End a server at once, as soon as its page has loaded the screens that are not shown yet."""
    page.wait_for_load_state("networkidle")
    process.kill()
    process.wait()


@pytest.mark.slow
def test_a_restarted_server_is_picked_up_with_unsaved_edits(torque: Path, tmp_path: Path) -> None:
    with started(torque, tmp_path) as (address, process), browser_page(address) as page:
        type_value(page, "1,1", "99")
        kill(process, page)
        page.wait_for_selector("text=does not answer")
        with started(torque, tmp_path) as (again, _):
            assert again.partition("?")[0] == address.partition("?")[0]
            page.wait_for_selector("text=Your unsaved edits are back")
            page.wait_for_selector("[data-cell='1,1']:has-text('99')")
            assert page.query_selector("#restarted") is None
            page.keyboard.press("Control+z")
            page.wait_for_selector("#unsaved:not(.dirty)")


@pytest.mark.slow
def test_the_project_of_the_page_is_opened_again(torque: Path, tmp_path: Path) -> None:
    with started(None, tmp_path) as (address, process), browser_page(address) as page:
        page.fill("[aria-label='Path of a project']", str(torque))
        page.keyboard.press("Enter")
        type_value(page, "0,2", "77")
        kill(process, page)
        with started(None, tmp_path):
            page.wait_for_selector("text=Your unsaved edits are back")
            page.wait_for_selector("[data-cell='0,2']:has-text('77')")


@pytest.mark.slow
def test_a_page_without_a_proof_shows_a_remedy(torque: Path, tmp_path: Path) -> None:
    with started(torque, tmp_path) as (address, process), browser_page(address) as page:
        page.wait_for_selector(READY)
        kill(process, page)
        for file in (tmp_path / ".kennfeld" / "servers").iterdir():
            file.write_text(file.read_text().replace('"key": "', '"key": "x'))
        with started(torque, tmp_path):
            page.wait_for_selector("#restarted")
            assert "Open the address" in page.inner_text("#restarted")


def children(pid: int) -> list[int]:
    """Return the processes that a process has started."""
    tasks = Path(f"/proc/{pid}/task").glob("*/children")
    return [int(each) for path in tasks for each in path.read_text().split()]


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="finds the worker in /proc")
def test_a_worker_that_dies_is_reported_and_the_next_run_works(torque: Path, tmp_path: Path) -> None:
    with started(torque, tmp_path) as (address, process), browser_page(address) as page:
        page.click("[data-screen=optimization]")
        page.fill("[aria-label=Starts]", "60")
        page.keyboard.press("Enter")
        page.wait_for_selector("small.dirty")
        page.wait_for_selector(READY)
        page.click("#run")
        page.wait_for_selector("#job-state.running")
        (worker, *_) = children(process.pid)
        os.kill(worker, signal.SIGKILL)
        page.wait_for_selector("#job-state.failed")
        assert "ended unexpectedly" in page.inner_text(".pl")
        page.keyboard.press("Control+z")
        page.wait_for_selector("#unsaved:not(.dirty)")
        page.click("#run")
        page.wait_for_selector("#job-state.converged", timeout=60_000)


@pytest.fixture
def server(torque: Path, tmp_path: Path) -> Any:
    with served(torque, tmp_path) as running:
        yield running


def begin_upload(server: Served, name: str) -> socket.socket:
    """Send the head and a part of an upload."""
    connection = socket.create_connection(("127.0.0.1", server.port))
    head = f"PUT /upload/{name} HTTP/1.1\r\nHost: {server.host}\r\nOrigin: http://{server.host}\r\n"
    head += f"Cookie: {server.cookie}\r\nContent-Length: 1000000\r\n\r\n"
    connection.sendall(head.encode() + b"x" * 1000)
    return connection


def wait_for(condition: Any) -> None:
    deadline = time.monotonic() + 20
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_an_interrupted_upload_leaves_no_file(server: Served, torque: Path) -> None:
    before = {path.name for path in torque.parent.iterdir()}
    connection = begin_upload(server, "new.csv")
    wait_for(lambda: list(torque.parent.glob("*.upload.part")))
    connection.close()
    wait_for(lambda: {path.name for path in torque.parent.iterdir()} == before)


def test_files_of_a_killed_server_are_removed_at_the_next_start(server: Served, torque: Path, tmp_path: Path) -> None:
    connection = begin_upload(server, "new.csv")
    wait_for(lambda: list(torque.parent.glob("*.upload.part")))
    server.process.kill()
    server.process.wait()
    connection.close()
    (part,) = torque.parent.glob("*.upload.part")
    os.utime(part, (time.time() - 3600,) * 2)
    with served(torque, tmp_path):
        wait_for(lambda: not part.exists())


def test_two_uploads_of_one_name_are_two_files(server: Served, torque: Path) -> None:
    headers = {"Cookie": server.cookie, "Origin": f"http://{server.host}"}
    for content in (b"a\n1\n", b"a\n2\n"):
        assert server.request("PUT", "/upload/new.csv", headers, content)[0] == 200
    assert (torque.parent / "new.csv").read_bytes() == b"a\n1\n"
    assert (torque.parent / "new-2.csv").read_bytes() == b"a\n2\n"


def test_a_slow_client_does_not_block_the_others(server: Served) -> None:
    slow = [begin_upload(server, f"slow{number}.csv") for number in range(20)]
    half = socket.create_connection(("127.0.0.1", server.port))
    half.sendall(b"GET / HTTP/1.1\r\nHost: ")
    with server.page() as page:
        assert "table" in page.ask("table", name="MapOptTorque")[0]
    assert server.request("GET", "/", {"Cookie": server.cookie})[0] == 200
    for connection in (*slow, half):
        connection.close()


def test_random_bytes_do_not_stop_the_server(server: Served) -> None:
    for content in (b"\x00" * 2000, b"GET\r\n\r\n", b"\xff\xfe" * 500, b"GET / HTTP/9.9\r\n\r\n", b"A" * 200_000):
        with socket.create_connection(("127.0.0.1", server.port)) as connection:
            connection.settimeout(10)
            try:
                connection.sendall(content)
                connection.shutdown(socket.SHUT_WR)
                answer = connection.recv(65536)
            except OSError:
                answer = b""
        assert b"Traceback" not in answer
        assert b"torque" not in answer
    assert server.request("GET", "/", {"Cookie": server.cookie})[0] == 200


def test_a_symbolic_link_out_of_the_folder_is_not_followed(server: Served, torque: Path, tmp_path: Path) -> None:
    (tmp_path / "secret.dcm").write_text("secret")
    (torque.parent / "link.dcm").symlink_to(tmp_path / "secret.dcm")
    (torque.parent / "folder").symlink_to(tmp_path)
    for name in ("link.dcm", "folder/secret.dcm", "..%2fsecret.dcm", "folder/../../secret.dcm", "%2e%2e/secret.dcm"):
        status, _, body = server.request("GET", f"/file/{name}", {"Cookie": server.cookie})
        assert status == 404
        assert b"secret" not in body.replace(name.encode(), b"").replace(b"secret.dcm", b"")
    with server.page() as page:
        for name in ("link.dcm", "folder/secret.dcm", "../secret.dcm"):
            head, _ = page.ask("contents", source={"from": "file", "file": name})
            assert "is outside of torque" in head["error"]
            assert "outside" in page.ask("add-files", files=[name])[0]["error"]
        names = [each["name"] for each in page.ask("calibrations")[0]["files"]]
    assert names == ["start.dcm"]
    archived = server.request("GET", "/project.zip", {"Cookie": server.cookie})[2]
    assert b"link.dcm" not in archived
    assert b"folder/" not in archived


def test_an_upload_that_is_too_large_is_refused_and_leaves_no_file(torque: Path, tmp_path: Path) -> None:
    before = {path.name for path in torque.parent.iterdir()} | {".kennfeld"}  # the cache of what is slow to read
    with served(torque, tmp_path, "import kennfeld.app.server.server as own; own.MAX_UPLOAD = 1000") as own:
        headers = {"Cookie": own.cookie, "Origin": f"http://{own.host}"}
        assert own.request("PUT", "/upload/large.csv", headers, b"x" * 1001)[0] == 413
        assert {path.name for path in torque.parent.iterdir()} <= before
        assert own.request("PUT", "/upload/small.csv", headers, b"x" * 1000)[0] == 200


def test_a_page_that_never_reads_is_closed_and_the_others_stay_open(server: Served) -> None:
    with server.page() as slow:
        slow.socket.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        question = {"id": 1, "ask": "table", "with": {"name": "MapOptTorque"}}
        for _ in range(3000):
            slow.socket.send(json.dumps(question))
        with server.page() as page:
            assert "table" in page.ask("table", name="MapOptTorque")[0]
