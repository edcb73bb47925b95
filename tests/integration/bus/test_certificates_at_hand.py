"""Which certificate a kernel, a bus and a node use, and what is said if there is none that fits."""

from __future__ import annotations

import shutil
import socket
from pathlib import Path

import pytest

from labos.bootstrap import Guard
from labos.bootstrap._node_security import check_lab, read_node_security
from labos.bus import Security
from labos.bus._security import check_endpoints
from labos.errors import BadInput, NotFound, Refused
from labos.pki import Authority, PartyIdentity
from labos.settings import KernelInfo, Settings, announce

LAB, MODULE = "lab-1", "rpl/sealer"
KERNEL, BUS, NODE = PartyIdentity("kernel", lab=LAB), PartyIdentity("bus"), PartyIdentity("node", MODULE, LAB)
TLS = ("tls/127.0.0.1:7447",)


@pytest.fixture
def settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Settings:
    monkeypatch.delenv("LABOS_PKI", raising=False)
    return Settings(tmp_path / "lab", "", addresses=("lab.example.org",))


def node(settings: Settings, certificate: Path | None, *, lab: str = LAB) -> tuple[Security | None, str]:
    return read_node_security(settings, MODULE, lab, TLS, certificate, secure=False)


def test_who_runs_the_bus_makes_an_authority_and_a_certificate(settings: Settings) -> None:
    security = Guard(BUS, settings, runs_bus=True).prepare()
    (entry,) = security.members
    assert {"127.0.0.1", "localhost", socket.gethostname(), "lab.example.org"} == set(entry.addresses)
    kernel = Guard(KERNEL, settings, runs_bus=False)
    assert kernel.prepare([MODULE]).members == ()
    assert len(kernel.members().admitted) == 3
    found, lab = node(settings, None)
    assert found == Security(Authority(settings.pki).credentials(NODE))
    assert lab == LAB
    assert kernel.find_node_folder(MODULE) == found.credentials.folder


def test_a_kernel_on_the_bus_of_another_makes_no_authority(settings: Settings) -> None:
    """Nobody there would know its certificates."""
    with pytest.raises(NotFound, match="no certificate for the kernel"):
        Guard(KERNEL, settings, runs_bus=False).prepare()
    assert not settings.pki.exists()


def test_an_authority_that_is_gone_is_not_replaced_by_another(settings: Settings) -> None:
    """All nodes would be refused, and nobody would know why."""
    announce(settings.home, KernelInfo(0, "http://127.0.0.1:1", TLS[0], LAB, "sqlite:///x"))
    with pytest.raises(NotFound, match="is missing"):
        Guard(KERNEL, settings, runs_bus=True).prepare()
    guard = Guard(BUS, Settings(settings.home / "other", ""), runs_bus=True)
    guard.prepare()
    shutil.rmtree(guard.authority.folder)
    with pytest.raises(NotFound):
        guard._renew([])
    assert not guard.authority.exists


def test_a_kernel_uses_the_folder_that_was_made_for_it(settings: Settings, tmp_path: Path) -> None:
    authority = Authority(tmp_path / "pki")
    authority.init("elsewhere")
    for identity in (KERNEL, NODE, PartyIdentity("kernel", lab="lab-2")):
        authority.issue(identity)
    own = authority.credentials(KERNEL).folder
    security = Guard(KERNEL, settings, runs_bus=True, own=own).prepare([MODULE])
    assert len(security.members) == 3, "the list is in its folder"
    assert not settings.pki.exists()
    for wrong in (NODE, PartyIdentity("kernel", lab="lab-2")):
        with pytest.raises(BadInput, match=r"is that of the .*, not of the kernel of lab lab-1"):
            Guard(KERNEL, settings, runs_bus=False, own=authority.credentials(wrong).folder).prepare()


def test_a_kernel_of_a_site_waits_for_its_certificate(settings: Settings, tmp_path: Path) -> None:
    site = Authority(tmp_path / "site")
    site.init("the site")
    Authority(settings.pki).init("", site=site.folder / "ca.pem")
    with pytest.raises(Refused, match="the site issues"):
        Guard(KERNEL, settings, runs_bus=True).prepare([MODULE])


def test_a_node_is_told_which_certificate_it_needs(settings: Settings) -> None:
    assert read_node_security(settings, MODULE, LAB, ("tcp/127.0.0.1:7447",), None, secure=False) == (
        None,
        "",
    )
    with pytest.raises(NotFound, match="no certificate was given"):
        node(settings, None, lab="")
    with pytest.raises(NotFound, match="There is no"):
        node(settings, None)
    authority = Authority(settings.pki)
    authority.init("test")
    other = PartyIdentity("node", "rpl/peeler", LAB)
    authority.issue(other)
    with pytest.raises(BadInput, match="belongs to the node rpl/peeler, not to the node rpl/sealer"):
        node(settings, authority.credentials(other).folder)


def test_a_certificate_of_another_lab_is_refused_by_the_node_itself() -> None:
    check_lab(MODULE, LAB, LAB)
    check_lab(MODULE, LAB, "")  # the site's certificates tell of no lab
    with pytest.raises(BadInput, match="belongs to lab lab-1, but its certificate to lab lab-2"):
        check_lab(MODULE, LAB, "lab-2")


def test_a_secure_end_speaks_to_nobody_without_tls(settings: Settings) -> None:
    check_endpoints(TLS, secure=True)
    for endpoints, secure in ((TLS, False), (("tcp/127.0.0.1:1",), True)):
        with pytest.raises(BadInput, match="does not fit"):
            check_endpoints(endpoints, secure=secure)


def test_a_lab_that_was_secure_stays_so(settings: Settings) -> None:
    assert not settings.is_secure
    announce(settings.home, KernelInfo(0, "http://127.0.0.1:1", TLS[0], LAB, "sqlite:///x"))
    assert settings.is_secure
    assert not Settings(settings.home, "", secure=False).is_secure
    assert not Settings(settings.home, "", bus=("tcp/bus.lab:7447",)).is_secure
    assert Settings(settings.home / "other", "", bus=TLS).is_secure
