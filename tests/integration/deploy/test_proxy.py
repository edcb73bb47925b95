"""The proxy's example configuration: a real nginx with it, in front of a lab."""

from __future__ import annotations

import base64
import json
import os
import re
import shutil
import ssl
import subprocess
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from labos.settings import free_port
from tests.docs.markdown import ROOT
from tests.support.lab_process import PATIENCE_S, Up, labos, until

EXAMPLE = ROOT / "deploy" / "tls" / "nginx.conf"
NAME = "lab.example.org"
REQUIRED = "LABOS_REQUIRE_NGINX"
UPLOAD = 40 * 1024 * 1024

pytestmark = [pytest.mark.slow]


def need_nginx() -> str:
    found = shutil.which("nginx") or shutil.which("nginx", path="/usr/sbin")
    if found is None:
        assert not os.environ.get(REQUIRED), f"nginx is missing, and {REQUIRED} is set"
        pytest.skip("nginx is missing (Debian package nginx-light)")
    return found


class Proxy:
    """nginx with the example; only ports and places are others."""

    def __init__(self, folder: Path, lab_port: int) -> None:
        folder.mkdir()
        self.port, self.certificate = free_port(), folder / "lab.pem"
        subject = ("-subj", f"/CN={NAME}", "-addext", f"subjectAltName=DNS:{NAME}")
        key = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "1")
        to = ("-keyout", str(folder / "lab.key"), "-out", str(self.certificate))
        subprocess.run(["openssl", "req", "-x509", *key, *subject, *to], check=True, capture_output=True)
        text = EXAMPLE.read_text()
        for there, here in (
            ("listen 443 ssl", f"listen 127.0.0.1:{self.port} ssl"),
            ("listen 8443 ssl", f"listen 127.0.0.1:{free_port()} ssl"),
            ("/etc/ssl/labos", str(folder)),
            ("http://127.0.0.1:8720", f"http://127.0.0.1:{lab_port}"),
        ):
            assert there in text
            text = text.replace(there, here)
        places = "".join(
            f"{kind}_temp_path {folder}/{kind};\n"
            for kind in ("client_body", "proxy", "fastcgi", "uwsgi", "scgi")
        )
        config = folder / "nginx.conf"
        config.write_text(
            f"daemon off; pid {folder}/pid; error_log {folder}/error.log;\n"
            + ("user root;\n" if os.geteuid() == 0 else "")
            + f"events {{}}\nhttp {{ access_log off;\n{places}{text}\n}}\n"
        )
        command = [need_nginx(), "-c", str(config), "-e", str(folder / "error.log")]
        tested = subprocess.run([*command, "-t"], capture_output=True, text=True, check=False)
        assert tested.returncode == 0, tested.stderr
        assert "warn" not in tested.stderr
        self._process = subprocess.Popen(command, stdin=subprocess.DEVNULL)

    def client(self, token: str) -> httpx.Client:
        """Trusts the lab's certificate only, and checks that it is for the lab's name."""
        return httpx.Client(
            base_url=f"https://127.0.0.1:{self.port}",
            verify=ssl.create_default_context(cafile=str(self.certificate)),
            headers={"host": NAME, "authorization": f"Bearer {token}"},
            timeout=PATIENCE_S,
        )

    def close(self) -> None:
        self._process.terminate()  # it ends its workers
        self._process.wait(PATIENCE_S)


@pytest.fixture
def proxied(tmp_path: Path) -> Iterator[httpx.Client]:
    need_nginx()
    said = EXAMPLE.read_text()
    (options,) = re.findall(r"labos up … --http-port 8720 (.*)$", said, re.MULTILINE)
    port, password = free_port(), tmp_path / "password"
    password.write_text("correct horse battery")
    first = ("--first-user", "ada", "--first-password", str(password))
    lab = Up(tmp_path / "lab", "--simulate", "--no-nodes", "--http-port", str(port), *options.split(), *first)
    proxy = None
    try:
        lab.start("rpl")
        proxy = Proxy(tmp_path / "proxy", port)
        made = labos("token", "create", "test", "--for", "ada", "--json", "--home", str(lab.home))
        assert made.returncode == 0, made.stderr
        with proxy.client(json.loads(made.stdout)["secret"]) as client:
            until(lambda: answers(client), "the proxy answers")
            yield client
    finally:
        if proxy is not None:
            proxy.close()
        lab.clean_up()


def answers(client: httpx.Client) -> bool:
    try:
        return ask(client, "GET", "/health").status_code == 200
    except httpx.ConnectError:
        return False


def ask(client: httpx.Client, method: str, path: str, **options: object) -> httpx.Response:
    return client.request(method, path, extensions={"sni_hostname": NAME}, **options)  # type: ignore[arg-type]


def test_requests_streams_and_uploads_pass(proxied: httpx.Client) -> None:
    started = ask(proxied, "POST", "/api/v1/experiments", json={"name": "proxy"})
    assert started.status_code == 201, started.text
    files = f"/api/v1/experiments/{started.json()['experiment']}"
    # A stream shows what happens while it is open: the proxy keeps nothing back.
    with proxied.stream("GET", "/api/v1/events/stream?after=0", extensions={"sni_hostname": NAME}) as stream:
        assert stream.headers["content-type"].startswith("text/event-stream")
        lines = stream.iter_lines()
        next(line for line in lines if "experiment.started" in line)
        note = {"kind": "decision", "name": "said while it is open", "facts": {}}
        assert ask(proxied, "POST", f"{files}/notes", json=note).status_code == 201
        next(line for line in lines if "said while it is open" in line)
    content = os.urandom(UPLOAD)
    kept = ask(proxied, "POST", f"{files}/files", json={"content": base64.b64encode(content).decode()})
    assert kept.status_code == 201, kept.text
    assert ask(proxied, "GET", f"/api/v1/files/{kept.json()['sha256']}").content == content


def test_more_than_the_proxy_passes_is_refused(proxied: httpx.Client) -> None:
    refused = ask(proxied, "POST", "/api/v1/experiments", content=b" " * (101 * 1024 * 1024))
    assert refused.status_code == 413
