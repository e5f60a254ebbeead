"""A restarted server: its file, the proofs, and who is not let in."""

import hashlib
import hmac
import json
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from kennfeld.app.server import restart
from kennfeld.app.server.restart import Handshake, KnownServer, known_server, remember_server
from tests.app.serving import Served, served

KEY = "k" * 43
NONCE = "0123456789abcdef" * 2


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(Path, "home", classmethod(lambda cls: tmp_path))
    return tmp_path


def proof(key: str, side: str, port: int, text: str) -> str:
    return hmac.new(key.encode(), f"{side}:{port}:{text}".encode(), hashlib.sha256).hexdigest()


def test_a_server_is_known_again_by_its_project(tmp_path: Path) -> None:
    project = tmp_path / "kennfeld.toml"
    remember_server(project, KnownServer(4321, KEY))
    assert known_server(project) == KnownServer(4321, KEY)
    assert known_server(tmp_path / "other.toml") is None


@pytest.mark.skipif(os.name != "posix", reason="modes of files exist on POSIX")
def test_only_the_owner_can_read_the_file(tmp_path: Path) -> None:
    remember_server(tmp_path, KnownServer(4321, KEY))
    (file,) = restart.servers_folder().iterdir()
    assert file.stat().st_mode & 0o777 == 0o600
    for mode in (0o640, 0o604, 0o620):
        file.chmod(mode)
        assert known_server(tmp_path) is None
    file.chmod(0o600)
    other = file.rename(file.with_name("other"))
    file.symlink_to(other)
    assert known_server(tmp_path) is None


@pytest.mark.parametrize(
    "content", ["", "{", "[]", '{"port": 1}', '{"port": 4321, "key": "short", "time": 9e9}', '{"port": "x", "key": 1}']
)
def test_a_damaged_file_is_ignored(tmp_path: Path, content: str) -> None:
    remember_server(tmp_path, KnownServer(4321, KEY))
    (file,) = restart.servers_folder().iterdir()
    file.write_text(content)
    assert known_server(tmp_path) is None


def test_an_old_key_is_forgotten(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    remember_server(tmp_path, KnownServer(4321, KEY))
    monkeypatch.setattr(restart, "MAX_AGE", -1)
    assert known_server(tmp_path) is None


def test_only_the_last_servers_are_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(restart, "MAX_SERVERS", 3)
    for number in range(6):
        remember_server(tmp_path / str(number), KnownServer(4321, KEY))
    assert len(list(restart.servers_folder().iterdir())) == 3


def test_both_sides_prove_the_key() -> None:
    handshake = Handshake(4321, KEY)
    answer = handshake.challenge(NONCE)
    assert answer is not None
    assert answer["proof"] == proof(KEY, "server", 4321, NONCE)
    own = proof(KEY, "page", 4321, answer["challenge"])
    assert handshake.accepts(answer["challenge"], own)
    assert not handshake.accepts(answer["challenge"], own)  # each challenge counts once


@pytest.mark.parametrize(("key", "side", "port"), [("x" * 43, "page", 4321), (KEY, "server", 4321), (KEY, "page", 99)])
def test_a_proof_with_another_key_side_or_port_is_refused(key: str, side: str, port: int) -> None:
    handshake = Handshake(4321, KEY)
    answer = handshake.challenge(NONCE)
    assert answer is not None
    assert not handshake.accepts(answer["challenge"], proof(key, side, port, answer["challenge"]))
    assert not handshake.accepts("made up", proof(KEY, "page", 4321, "made up"))


@pytest.mark.parametrize("nonce", [None, 5, "", "short", "x" * 5000])
def test_a_malformed_nonce_is_refused(nonce: object) -> None:
    assert Handshake(4321, KEY).challenge(nonce) is None


def test_old_challenges_are_dropped() -> None:
    handshake = Handshake(4321, KEY)
    first = handshake.challenge(NONCE)
    for _ in range(restart.MAX_CHALLENGES):
        handshake.challenge(NONCE)
    assert first is not None
    assert not handshake.accepts(first["challenge"], proof(KEY, "page", 4321, first["challenge"]))


@pytest.fixture
def server(torque: Path, tmp_path: Path) -> Iterator[Served]:
    with served(torque, tmp_path) as running:
        yield running


def challenge(server: Served, text: str, **headers: str) -> str:
    """Send a question to the socket of the proofs without a cookie; return the answer, empty if it is closed."""
    origin = headers.pop("Origin", f"http://{server.host}")
    address = f"ws://{server.host}/again"
    with connect(address, origin=origin, additional_headers=headers, open_timeout=20) as socket:  # type: ignore[arg-type]
        socket.send(text)
        try:
            return str(socket.recv(timeout=20))
        except ConnectionClosed:
            return ""


def prove(server: Served, content: object, origin: str = "") -> tuple[int, dict[str, str], bytes]:
    body = content if isinstance(content, bytes) else json.dumps(content).encode()
    return server.request("POST", "/again", {"Origin": origin or f"http://{server.host}"}, body)


def test_a_page_gets_the_cookie_of_the_new_server(server: Served, torque: Path, tmp_path: Path) -> None:
    body = server.request("GET", "/", {"Cookie": server.cookie})[2].decode()
    key = body.partition('name="again" content="')[2].partition('"')[0]
    server.process.kill()
    server.process.wait()
    with served(torque, tmp_path) as again:
        assert again.port == server.port
        assert again.token != server.token
        assert again.request("GET", "/", {"Cookie": server.cookie})[0] == 403
        head = json.loads(challenge(again, json.dumps({"nonce": NONCE})))
        assert head["proof"] == proof(key, "server", again.port, NONCE)
        own = {"challenge": head["challenge"], "proof": proof(key, "page", again.port, head["challenge"])}
        status, headers, _ = prove(again, own)
        assert (status, headers["set-cookie"].partition(";")[0]) == (204, again.cookie)
        assert again.request("GET", "/", {"Cookie": again.cookie})[0] == 200
        assert prove(again, own)[0] == 403


PROOFS: list[object] = [
    *({}, [], b"{", b"", b"x" * 100_000, b"[" * 1900),
    *({"nonce": NONCE}, {"challenge": "a", "proof": "b"}, {"challenge": None}, {"proof": 5, "challenge": ["a"]}),
]
QUESTIONS = ["", "{", "[]", "null", '{"nonce": 1}', '{"nonce": "short"}', "[" * 1900, json.dumps({"nonce": "x" * 1900})]


def test_requests_without_a_proof_are_refused(server: Served) -> None:
    for content in PROOFS:
        status, headers, body = prove(server, content)
        assert (status, body) == (403, b"")
        assert "set-cookie" not in headers
    for text in QUESTIONS:
        assert challenge(server, text) == ""
    assert prove(server, {"challenge": "a", "proof": "b"}, "http://evil.example")[0] == 403
    assert server.request("POST", "/again", {}, b"{}")[0] == 403
    for headers in ({"Origin": "http://evil.example"}, {"Host": "evil.example"}):
        with pytest.raises(InvalidStatus):
            challenge(server, json.dumps({"nonce": NONCE}), **headers)
    assert server.request("GET", "/", {"Cookie": server.cookie})[0] == 200


def test_a_taken_port_gives_another_port_and_another_key(server: Served, torque: Path, tmp_path: Path) -> None:
    with served(torque, tmp_path) as other:
        assert other.port != server.port
        record = known_server(torque)
        assert record is not None
        assert record.port == other.port
        page = server.request("GET", "/", {"Cookie": server.cookie})[2].decode()
        assert record.key not in page
