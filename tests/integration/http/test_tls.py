"""HTTP over TLS on an address that other computers reach: what it needs, and what it gives to whom."""

from __future__ import annotations

import os
import ssl
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address
from pathlib import Path

import httpx
import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec

from labos.bootstrap import LabThread
from labos.client import LabClient
from labos.client._lab import API, LabUnreachable
from labos.errors import BadInput
from labos.settings import Settings
from tests.integration.http.signed import PASSWORDS, lab_with_users, token_of

pytestmark = pytest.mark.slow


def certificate_for(folder: Path, name: str) -> tuple[Path, Path]:
    """A certificate that signs itself, and its key."""
    key = ec.generate_private_key(ec.SECP256R1())
    named = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, name)])
    now = datetime.now(UTC)
    names = [x509.DNSName(name), x509.IPAddress(ip_address("127.0.0.1"))]
    certificate = (
        x509.CertificateBuilder()
        .subject_name(named)
        .issuer_name(named)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - timedelta(hours=1))
        .not_valid_after(now + timedelta(days=1))
        .add_extension(x509.SubjectAlternativeName(names), critical=False)
        .sign(key, hashes.SHA256())
    )
    files = folder / "lab.pem", folder / "lab.key"
    files[0].write_bytes(certificate.public_bytes(serialization.Encoding.PEM))
    plain = serialization.NoEncryption()
    files[1].write_bytes(
        key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, plain)
    )
    return files


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("tls")


@pytest.fixture(scope="module")
def lab(folder: Path) -> Iterator[LabThread]:
    certificate, key = certificate_for(folder, "lab.example.org")
    with lab_with_users(folder):
        pass
    tls = {"tls_certificate": str(certificate), "tls_key": str(key), "names": ("lab.example.org",)}
    settings = Settings.make(folder / "lab", host="0.0.0.0", open_to_network=True, **tls)
    with LabThread(settings, nodes="none") as running:
        yield running


def at(lab: LabThread, folder: Path) -> httpx.Client:
    trusted = ssl.create_default_context(cafile=folder / "lab.pem")
    return httpx.Client(base_url=f"https://127.0.0.1:{lab.runtime.http.port}", verify=trusted, timeout=30)


def test_browsers_get_a_cookie_for_tls_and_this_host_only(lab: LabThread, folder: Path) -> None:
    with at(lab, folder) as browser:
        origin = str(browser.base_url).rstrip("/")
        body = {"user": "ada", "password": PASSWORDS["ada"]}
        answer = browser.post(f"{API}/login", json=body, headers={"origin": origin})
        said = answer.headers["set-cookie"]
        assert said.startswith("__Host-labos-session=labos_session_")
        assert {"Secure", "HttpOnly", "Path=/", "SameSite=strict"} <= set(said.split("; "))
        assert browser.get(f"{API}/whoami").json()["user"] == "ada"
        named = {"host": "lab.example.org", "origin": "https://lab.example.org"}
        assert browser.get(f"{API}/whoami", headers=named).status_code == 200
        assert browser.get(f"{API}/whoami", headers={"host": "evil.example"}).status_code == 403


def test_programs_believe_the_authority_that_they_are_told(
    lab: LabThread, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = f"https://127.0.0.1:{lab.runtime.http.port}"
    token = token_of(folder, "bob")  # by the folder, whose note says which certificate the lab has
    with LabClient(url, token=token, patience_s=0.2) as client, pytest.raises(LabUnreachable):
        client.health()
    monkeypatch.setenv("LABOS_CA", str(folder / "lab.pem"))
    with LabClient(url, token=token) as client:
        assert client.identity()["user"] == "bob"
        assert next(client.events())["position"] == 1


def test_followers_are_served_over_tls(lab: LabThread, folder: Path) -> None:
    shown = {"authorization": f"Bearer {token_of(folder, 'bob')}"}
    with at(lab, folder) as browser, browser.stream("GET", f"{API}/events/stream", headers=shown) as answer:
        assert next(line for line in answer.iter_lines() if line.startswith("id:")) == "id: 1"


def test_plain_http_is_not_understood(lab: LabThread) -> None:
    with pytest.raises(httpx.HTTPError):
        httpx.get(f"http://127.0.0.1:{lab.runtime.http.port}/health")


def test_files_that_are_no_certificate_are_named(tmp_path: Path) -> None:
    for name in ("a.pem", "a.key"):
        (tmp_path / name).write_text("nothing")
    settings = Settings.make(
        tmp_path / "lab",
        simulate=True,
        tls_certificate=str(tmp_path / "a.pem"),
        tls_key=str(tmp_path / "a.key"),
    )
    with pytest.raises(BadInput, match=r"a\.pem cannot be used"), LabThread(settings, nodes="none"):
        pass


def test_a_file_of_tokens_is_for_its_owner_alone(
    tmp_path: Path, lab: LabThread, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "token"
    file.write_text(token_of(folder, "bob") + "\n")
    os.chmod(file, 0o640)
    monkeypatch.setenv("LABOS_TOKEN_FILE", str(file))
    monkeypatch.setenv("LABOS_CA", str(folder / "lab.pem"))
    with LabClient(f"https://127.0.0.1:{lab.runtime.http.port}") as client:
        with pytest.raises(BadInput, match="Other users can read"):
            client.identity()
        os.chmod(file, 0o600)
        assert client.identity()["user"] == "bob"
