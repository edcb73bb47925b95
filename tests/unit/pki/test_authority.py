"""A lab's own authority: what it issues, renews and revokes, and what it takes over from the site."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from cryptography import x509

from labos.bus import make_access_control
from labos.errors import BadInput, NotFound, Refused
from labos.pki import Authority, Credentials, PartyIdentity

LAB = "01a20fbf-d293-7267-ade9-190a714eeabf"
NODE = PartyIdentity("node", "rpl/ot2 (left)", LAB)
KERNEL = PartyIdentity("kernel", lab=LAB)
DAY = 86_400 * 10**9


class Clock:
    now = 1_800_000_000 * 10**9

    def now_ns(self) -> int:
        return self.now

    def monotonic(self) -> float:
        return 0.0


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def authority(tmp_path: Path, clock: Clock) -> Authority:
    made = Authority(tmp_path / "pki", clock)
    made.init("test")
    return made


def certificate(credentials: Credentials) -> x509.Certificate:
    return x509.load_pem_x509_certificate(credentials.certificate.read_bytes())


def test_a_certificate_says_whose_it_is(authority: Authority, clock: Clock) -> None:
    entry = authority.issue(NODE)
    credentials = authority.credentials(NODE)
    assert credentials.identity() == NODE
    assert credentials.entry() == entry
    credentials.check(clock.now)
    assert credentials.folder == authority.folder / "issued" / LAB / "rpl.ot2 (left)"
    assert len(authority.issue(PartyIdentity("node", "rpl/" + "x" * 100, LAB)).common_name) == 64


def test_only_a_kernel_and_a_bus_can_be_connected_to(authority: Authority) -> None:
    authority.issue(KERNEL, addresses=["127.0.0.1", "lab.example.org"])
    authority.issue(NODE, addresses=["lab.example.org"])
    for identity, serves in ((KERNEL, True), (NODE, False)):
        found = certificate(authority.credentials(identity)).extensions
        names = found.get_extension_for_class(x509.SubjectAlternativeName).value
        assert bool(names.get_values_for_type(x509.DNSName)) is serves
        usage = found.get_extension_for_class(x509.ExtendedKeyUsage).value
        assert (x509.ExtendedKeyUsageOID.SERVER_AUTH in usage) is serves


@pytest.mark.skipif(os.name == "nt", reason="Windows has no such rights")
def test_keys_are_private_whatever_the_umask(tmp_path: Path, clock: Clock) -> None:
    old = os.umask(0)
    try:
        authority = Authority(tmp_path / "pki", clock)
        authority.init("test")
        authority.issue(NODE)
    finally:
        os.umask(old)
    for path in [authority.folder, *authority.folder.rglob("*")]:
        assert path.stat().st_mode & 0o077 == 0, path
    assert authority.credentials(NODE).key in authority.list_private_files()
    key = authority.credentials(NODE).key
    key.chmod(0o640)
    with pytest.raises(BadInput, match="Others may read"):
        authority.credentials(NODE).check(clock.now)


def test_renewal_keeps_the_name_and_changes_the_key(authority: Authority, clock: Clock) -> None:
    entry = authority.issue(NODE, days=90)
    key = authority.credentials(NODE).key.read_bytes()
    stamp = authority.credentials(NODE).stamp()
    assert not entry.is_due(clock.now)
    clock.now += 61 * DAY
    assert entry.is_due(clock.now)
    assert authority.ensure(NODE) == authority.credentials(NODE)
    (renewed,) = authority.read_members().entries
    assert renewed.common_name == entry.common_name
    assert renewed.not_after == clock.now + 90 * DAY
    assert authority.credentials(NODE).key.read_bytes() != key
    assert authority.credentials(NODE).stamp() != stamp
    assert authority.ensure(NODE)
    assert authority.read_members().entries == (renewed,), "it is due no more"
    clock.now += 91 * DAY
    with pytest.raises(BadInput, match="has expired"):
        authority.credentials(NODE).check(clock.now)


def test_many_at_once_are_made_renewed_or_left_as_they_are(authority: Authority, clock: Clock) -> None:
    identities = [PartyIdentity("node", f"rpl/m{number}", LAB) for number in range(3)]
    authority.issue(identities[0], days=3000)
    authority.issue_all(identities[:2])
    before = authority.read_members()
    authority.issue_all(identities[:2])
    assert authority.read_members() == before
    authority.revoke(authority.find("rpl/m1"), "lost")
    clock.now += 300 * DAY
    authority.issue_all(identities)
    found = authority.read_members()
    assert found.find(identities[0]) == before.entries[0]
    assert {entry.identity for entry in found.admitted} == set(identities)
    assert len(found.entries) == 4


def test_another_address_is_added_to_a_certificate(authority: Authority) -> None:
    authority.issue(KERNEL, addresses=["127.0.0.1"])
    authority.ensure(KERNEL, addresses=["lab.example.org"])
    (entry,) = authority.read_members().entries
    assert set(entry.addresses) == {"127.0.0.1", "lab.example.org"}
    for number in range(40):
        authority.ensure(KERNEL, addresses=[f"host{number}", "127.0.0.1"])
    (entry,) = authority.read_members().entries
    assert len(entry.addresses) <= 32
    assert {"127.0.0.1", "host39"} <= set(entry.addresses)


def test_a_revoked_certificate_speaks_for_nobody_and_its_name_is_not_given_again(
    authority: Authority,
) -> None:
    entry = authority.issue(NODE)
    with pytest.raises(Refused, match="already a certificate for the node"):
        authority.issue(NODE)
    authority.revoke(authority.find("rpl/ot2 (left)"), "lost")
    assert authority.read_members().admitted == ()
    again = authority.issue(NODE)
    assert again.common_name != entry.common_name
    subjects = make_access_control(authority.read_members().entries)["subjects"]
    named = [subject["cert_common_names"] for subject in subjects if "cert_common_names" in subject]
    assert named == [[again.common_name]]
    listed = x509.load_pem_x509_crl((authority.folder / "crl.pem").read_bytes())
    assert [f"{revoked.serial_number:x}" for revoked in listed] == [entry.serial]
    issuer = x509.load_pem_x509_certificate((authority.folder / "ca.pem").read_bytes())
    assert listed.is_signature_valid(issuer.public_key())  # type: ignore[arg-type]
    with pytest.raises(Refused, match="is revoked"):
        authority.renew(authority.find(entry.common_name))


def test_a_bus_on_another_computer_has_the_list_in_its_folder(authority: Authority) -> None:
    authority.issue(PartyIdentity("bus"), addresses=["bus.example.org"])
    entry = authority.issue(NODE)
    folder = authority.credentials(PartyIdentity("bus")).folder
    assert entry.common_name in (folder / "members.json").read_text()
    authority.revoke(entry, "lost")
    assert (folder / "members.json").read_bytes() == authority.members_file.read_bytes()


def test_what_the_site_issues_is_taken_over(tmp_path: Path, clock: Clock) -> None:
    site = Authority(tmp_path / "site", clock)
    site.init("the site")
    theirs = [site.issue(PartyIdentity("viewer", name)) for name in ("one", "two")]
    files = [site.credentials(entry.identity) for entry in theirs]
    authority = Authority(tmp_path / "pki", clock)
    authority.init("", site=site.folder / "ca.pem")
    assert not authority.issues
    with pytest.raises(Refused, match="the site issues"):
        authority.issue(NODE)
    with pytest.raises(Refused, match="the site issues"):
        authority.ensure(NODE)
    with pytest.raises(BadInput, match="is not the key of"):
        authority.admit(NODE, files[0].certificate, files[1].key)
    entry = authority.admit(NODE, files[0].certificate, files[0].key)
    assert (entry.identity, entry.common_name, entry.own) == (NODE, theirs[0].common_name, False)
    authority.ensure(NODE)
    with pytest.raises(Refused, match="the CN of another certificate"):
        authority.admit(KERNEL, files[0].certificate, files[0].key)
    with pytest.raises(Refused, match="The site issued"):
        authority.renew(entry)
    authority.revoke(entry, "lost")
    with pytest.raises(Refused, match="is revoked"):
        authority.admit(NODE, files[0].certificate, files[0].key)
    assert authority.admit(NODE, files[1].certificate, files[1].key)
    other = Authority(tmp_path / "other", clock)
    other.init("somebody")
    other.issue(NODE)
    with pytest.raises(BadInput, match="was not issued by"):
        authority.admit(KERNEL, other.credentials(NODE).certificate, other.credentials(NODE).key)


def test_two_labs_may_share_an_authority(authority: Authority) -> None:
    """On one router, or on two: whose certificate is meant has to be said by its CN."""
    entry, other = authority.issue(NODE), authority.issue(PartyIdentity("node", NODE.name, "lab-2"))
    assert authority.credentials(NODE).folder != authority.credentials(other.identity).folder
    with pytest.raises(BadInput, match="Several certificates") as caught:
        authority.find(NODE.name)
    assert f"by its CN: {entry.common_name}, {other.common_name}" in str(caught.value)
    assert authority.find(other.common_name) == other


def test_what_is_not_there_is_said(tmp_path: Path, authority: Authority, clock: Clock) -> None:
    with pytest.raises(NotFound, match="members"):
        Authority(tmp_path / "none", clock).read_members()
    with pytest.raises(NotFound, match="No certificate is called"):
        authority.find("nobody")
    with pytest.raises(Refused, match="already an authority"):
        authority.init("again")
    with pytest.raises(NotFound, match="There is no "):
        authority.credentials(NODE).check(clock.now)
    authority.members_file.write_text("{")
    with pytest.raises(BadInput, match="cannot be read"):
        authority.read_members()


def test_nothing_is_allowed_that_no_rule_allows(authority: Authority) -> None:
    """A bus is no party; nobody's rule reaches another lab, and no node's another module."""
    authority.issue(PartyIdentity("bus"))
    for kind, name in (("kernel", ""), ("node", "rpl/a"), ("viewer", "v"), ("stop", "s"), ("api", "w")):
        authority.issue(PartyIdentity(kind, name, LAB))  # type: ignore[arg-type]
    found = make_access_control(authority.read_members().entries)
    assert found["default_permission"] == "deny"
    assert len(found["policies"]) == 6
    said = {
        key
        for rule in found["rules"]
        if "ingress" in rule["flows"] and {"put", "reply", "liveliness_token"} & set(rule["messages"])
        for key in rule["key_exprs"]
    }
    root = f"labos/{LAB}"
    assert said == {
        *(f"{root}/{key}" for key in ("rpl/a/**", "@alive/rpl/a/*", "@name/rpl/a/*/*")),
        *(f"{root}/{key}" for key in ("@setup/*/*", "@files", "@events/*", "@kernel", "@requests/*/*")),
        "labos/@members",
    }
    (of_all,) = [policy["rules"] for policy in found["policies"] if "all" in policy["subjects"]]
    assert [rule["key_exprs"] for rule in found["rules"] if rule["id"] in of_all] == [["labos/@members"]]


def test_the_name_of_an_api_process_is_one_part_of_a_key(authority: Authority) -> None:
    """Whatever its certificate says, it asks under no other name."""
    for name in ("*", "a/b", "**", "$*", "@x", ""):
        authority.issue(PartyIdentity("api", name, LAB))
    assert not [
        r for r in make_access_control(authority.read_members().entries)["rules"] if "query" in r["messages"]
    ]
