"""Who may talk to the lab over HTTP, and what is read and run because of what they say."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from labos.bootstrap import LabThread, descriptions
from labos.bootstrap._node_settings import with_own_settings
from labos.client import LabClient
from labos.client._lab import API
from labos.errors import BadInput, LabosError
from labos.http import server
from labos.node.protocol import SetupReply
from labos.settings import Settings
from labos.spec import find_spec, load_workcell
from labos.spec.onsite import list_on_site
from labos_drivers.plc.interface import HATCH

CELL = """
labos: 1
name: {name}
modules:
  - {{name: sealer, model: A4S_sealer, {more}}}
"""


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LabThread]:
    cell = load_workcell(find_spec("workcells", "rpl"), descriptions())
    settings = Settings.make(tmp_path_factory.mktemp("lab"), speed=5000.0, simulate=True)
    with LabThread(settings, [cell], nodes="none") as running:
        yield running


@pytest.fixture
def raw(lab: LabThread) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=lab.url + API, timeout=30) as found:
        yield found


def apply(raw: httpx.Client, text: str, **more: Any) -> httpx.Response:
    return raw.post("/workcells", json={"text": text, "by": "ada", "dry_run": True, **more})


# -- who asks --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "headers",
    [
        {"origin": "http://evil.example"},
        {"origin": "null"},
        {"origin": "http://localhost:3000"},
        {"host": "evil.example"},
        {"host": "evil.example:80", "origin": "http://evil.example:80"},
        {"sec-fetch-site": "cross-site"},
        {"sec-fetch-site": "same-site"},
    ],
)
def test_web_pages_of_others_are_refused(raw: httpx.Client, headers: dict[str, str]) -> None:
    for answer in (
        raw.get("/state", headers=headers),
        raw.post("/estop", json={"target": "*"}, headers=headers),
    ):
        assert (answer.status_code, answer.json()["code"]) == (403, "forbidden"), answer.text
        assert answer.json()["remedy"]


def test_own_pages_and_programs_are_let_in(lab: LabThread, raw: httpx.Client) -> None:
    port = lab.url.rpartition(":")[2]
    for headers in (
        {},
        {"origin": lab.url, "sec-fetch-site": "same-origin"},
        {"host": f"localhost:{port}", "origin": f"http://localhost:{port}"},
        {"host": "[::1]:9"},
        {"host": socket.gethostname()},
    ):
        assert raw.get("/health", headers=headers).status_code == 200, headers


@pytest.mark.parametrize(
    "kind", ["text/plain", "application/x-www-form-urlencoded", "multipart/form-data", ""]
)
def test_only_json_is_read(raw: httpx.Client, kind: str) -> None:
    body = b'{"target": "*", "by": "ada"}'
    answer = raw.post("/estop", content=body, headers={"content-type": kind} if kind else {})
    assert (answer.status_code, answer.json()["code"]) == (415, "unsupported_media_type")
    told = raw.post("/estop", content=body, headers={"content-type": "application/json; charset=utf-8"})
    assert told.status_code == 200


@pytest.mark.parametrize(
    ("said", "wrong", "remedy"),
    [
        ({}, "unencrypted", "--tls-cert"),
        ({"open_to_network": True}, "unencrypted", "--behind-proxy"),
        ({"behind_proxy": True}, "without certificates", "--open-to-network"),
        ({"behind_proxy": True, "open_to_network": True}, "has no users", "labos user add"),
    ],
)
def test_another_address_needs_users_and_tls(
    tmp_path: Path, said: dict[str, Any], wrong: str, remedy: str
) -> None:
    settings = Settings.make(tmp_path / "lab", simulate=True, host="0.0.0.0", **said)
    with pytest.raises(BadInput, match=wrong) as refused, LabThread(settings, nodes="none"):
        pass
    assert "Other computers reach 0.0.0.0" in refused.value.message or "0.0.0.0" in refused.value.message
    assert remedy in refused.value.remedy
    assert not (tmp_path / "lab" / "kernel.json").exists()


# -- what is read and run --------------------------------------------------------------------------


def test_no_file_of_the_server_is_read(raw: httpx.Client, tmp_path: Path) -> None:
    secret = tmp_path / "secret.yaml"
    secret.write_text("root: hunter2\n")
    for driver, key in (("plc", "plc"), ("axis", "axis")):
        text = (
            "labos: 1\nname: wall\nmodules:\n"
            f"  - {{name: m, driver: {driver}, config: {{{key}: {secret}, address: 10.0.0.1}}}}\n"
        )
        answer = apply(raw, text)
        assert answer.status_code == 422
        assert "was not sent along" in answer.json()["detail"]
        assert "hunter2" not in answer.text
    answer = apply(raw, CELL.format(name="c", more="active: true") + f"labware: [{secret}]\n")
    assert answer.status_code == 422
    assert "none was sent along" in answer.text


def test_a_table_that_was_sent_along_is_taken(lab: LabThread, raw: httpx.Client) -> None:
    text = (
        "labos: 1\nname: wall\nmodules:\n"
        "  - {name: hatch, driver: plc, config: {address: 10.0.0.1, plc: tables/hatch.yaml}}\n"
    )
    with LabClient(lab.url) as client:
        with pytest.raises(LabosError, match="was not sent along"):
            client.apply_workcell(text, "wall.yaml", "ada", dry_run=True)
        found = client.apply_workcell(
            text, "wall.yaml", "ada", dry_run=True, files={"tables/hatch.yaml": HATCH.read_bytes()}
        )
    assert found["modules"]["added"] == ["hatch"]


@pytest.mark.parametrize(
    "config",
    [
        "{rest_node_address: http://evil.example, rest_node_auth: /etc/shadow}",
        "{node_url: http://evil.example, node_auth: token}",
        "{sila_address: x, sila_certificate: some.pem}",
        "{ros_python: /bin/sh, ros: {}}",
        "{url: http://evil.example, user: a, password_env: LABOS_DATABASE_URL}",
        "{port: 'spy:///dev/ttyS0?file=/root/.bashrc'}",
        "{port: /dev/../root/.ssh/authorized_keys}",
        "{source: /home}",
        "{source: ~/pictures}",
        "{source: '../pictures'}",
        "{source: 'file:///etc/passwd'}",
        "{bus: {logfile: /tmp/x}}",
        "{own: [{deep: [/etc/passwd]}]}",
    ],
)
def test_files_programs_and_secrets_are_not_named_over_http(raw: httpx.Client, config: str) -> None:
    answer = apply(raw, CELL.format(name="rpl2", more=f"config: {config}"))
    assert answer.status_code == 400, answer.text
    assert "cannot be set over HTTP" in answer.json()["detail"]
    assert "nodes.yaml" in answer.json()["remedy"]


def test_addresses_of_devices_may_be_said() -> None:
    for config in (
        {"port": "/dev/serial/by-id/usb-sealer"},
        {"port": "COM3"},
        {"port": "socket://10.0.0.1:4000"},
        {"url": "http://10.0.0.1:80/x"},
        {"ros_node_address": "/std_ns/arm"},
        {"rest": {"action": {"path": "/jobs/{action}"}}, "rest_node_address": "http://10.0.0.1"},
        {"programs": [{"program": "/programs/grip.urp"}]},
        {"source": "rtsp://10.0.0.9/1"},
        {"waste": ["wc.trash"], "speed_percent": 30},
    ):
        assert list_on_site(config) == [], config


def test_what_the_lab_has_already_may_be_said_again(tmp_path: Path) -> None:
    file = tmp_path / "c.yaml"
    config = "config: {rest_node_address: http://10.0.0.1, rest_node_auth: /etc/labos/a.auth}"
    file.write_text(CELL.format(name="c", more=config))
    cell = load_workcell(file, descriptions())
    with (
        LabThread(Settings.make(tmp_path / "lab", simulate=True), [cell], nodes="none") as lab,
        httpx.Client(base_url=lab.url + API) as raw,
    ):
        same = apply(raw, file.read_text() + "  - {name: peeler, model: brooks_xpeel}\n")
        assert (same.status_code, same.json()["modules"]["added"]) == (200, ["peeler"])
        other = apply(raw, file.read_text().replace("10.0.0.1", "evil.example"))
        assert other.status_code == 400


def test_a_node_is_told_by_its_own_computer(tmp_path: Path) -> None:
    path = tmp_path / "nodes.yaml"
    told = SetupReply(config={"rest_node_address": "http://evil.example", "node_url": "x", "speed": 3})
    assert with_own_settings(told, path, "c/sealer") is told
    path.write_text("c/sealer: {rest_node_address: http://10.0.0.1, rest_node_auth: /etc/labos/a.auth}\n")
    own = with_own_settings(told, path, "c/sealer")
    assert own.config == {
        "rest_node_address": "http://10.0.0.1",
        "rest_node_auth": "/etc/labos/a.auth",
        "speed": 3,
    }
    assert with_own_settings(told, path, "c/peeler").config == told.config
    path.write_text("c/sealer: {rest_node_auth: /etc/labos/a.auth}\n")
    with pytest.raises(BadInput, match="but not the address to which it may be sent"):
        with_own_settings(told, path, "c/sealer")
    path.write_text("c/plc: {opcua_url: 'opc.tcp://plc/', opcua_password: /etc/labos/plc.password}\n")
    told = SetupReply(config={"opcua_url": "opc.tcp://evil.example/"})
    assert with_own_settings(told, path, "c/plc").config["opcua_url"] == "opc.tcp://plc/"


# -- slow and large requests -------------------------------------------------------------------------


def connect(lab: LabThread) -> socket.socket:
    host, _, port = lab.url.removeprefix("http://").partition(":")
    return socket.create_connection((host, int(port)), timeout=20)


def test_a_head_that_does_not_come_is_not_waited_for(lab: LabThread, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "HEAD_S", 0.3)
    for begun in (b"", b"GET /health HTTP/1.1\r\nhost: localhost\r\nx: "):
        with connect(lab) as slow:
            slow.sendall(begun)
            assert slow.recv(100) == b""
    with connect(lab) as patient:  # also after an answered request
        patient.sendall(b"GET /health HTTP/1.1\r\nhost: localhost\r\n\r\n")
        assert b"200 OK" in patient.recv(4000)
        patient.sendall(b"GET /health HTT")
        while patient.recv(4000):
            pass


def test_a_body_that_does_not_come_is_not_waited_for(lab: LabThread, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("labos.http.wire.FIRST_S", 0.3)
    head = b"POST /api/v1/estop HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/json\r\n"
    with connect(lab) as slow:
        slow.sendall(head + b'content-length: 100\r\n\r\n{"tar')
        assert b"408" in slow.recv(4000).splitlines()[0]


@pytest.mark.parametrize("chunked", [False, True])
def test_a_body_counts_while_it_comes(lab: LabThread, chunked: bool) -> None:
    how = b"transfer-encoding: chunked" if chunked else b"content-length: 100000000000"
    with connect(lab) as endless:
        endless.sendall(
            b"POST /api/v1/estop HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/json\r\n"
            + how
            + b"\r\n\r\n"
        )
        sent, began = 0, time.monotonic()
        piece = b"10000\r\n" + b" " * 65536 + b"\r\n"
        answer, left = b"", b""
        endless.setblocking(False)
        while time.monotonic() - began < 20 and not answer:
            try:
                left = left or piece
                taken = endless.send(left) if chunked else 0
                sent, left = sent + taken, left[taken:]
            except BlockingIOError:
                pass
            except OSError:
                break
            try:
                answer = endless.recv(4000)
            except BlockingIOError:
                continue
            except OSError:
                break
    assert b" 413 " in answer.splitlines()[0] if answer else sent, answer
    assert sent < 32 * 1024 * 1024


def test_connections_have_an_end(lab: LabThread, raw: httpx.Client) -> None:
    protocol = lab.runtime.http._server.config.http_protocol_class
    before = protocol.most_connections
    held: list[socket.socket] = []
    try:
        protocol.most_connections = 5
        for _ in range(12):
            held.append(connect(lab))
        with connect(lab) as late:
            assert b"503" in late.recv(4000).splitlines()[0]
    finally:
        protocol.most_connections = before
        for one in held:
            one.close()
