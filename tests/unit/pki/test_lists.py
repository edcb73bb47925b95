"""Lists of members are numbered and signed; where the authority is elsewhere an older one is never taken
back."""

from __future__ import annotations

import shutil
from pathlib import Path

import msgspec
import pytest

from labos.errors import BadInput
from labos.pki import MEMBERS, NUMBER, Authority, Members, PartyIdentity, ReceivedList

BUS, NODE = PartyIdentity("bus"), PartyIdentity("node", "rpl/sealer", "lab-1")


@pytest.fixture
def authority(tmp_path: Path) -> Authority:
    found = Authority(tmp_path / "pki")
    found.init("test")
    found.issue(BUS, addresses=["127.0.0.1"])
    return found


@pytest.fixture
def elsewhere(authority: Authority, tmp_path: Path) -> ReceivedList:
    shutil.copytree(authority.credentials(BUS).folder, tmp_path / "bus")
    return ReceivedList(tmp_path / "bus")


def read_list(authority: Authority) -> bytes:
    return authority.members_file.read_bytes()


def test_each_list_has_the_next_number_and_is_signed(authority: Authority, elsewhere: ReceivedList) -> None:
    first = elsewhere.read()
    assert first.number == authority.read_members().number > 0
    authority.issue(NODE)
    authority.revoke(authority.find("rpl/sealer"), "stolen")
    assert authority.read_members().number == first.number + 2
    assert elsewhere.offer(read_list(authority))
    assert elsewhere.read() == authority.read_members()
    assert elsewhere.read().admitted == first.admitted
    assert not elsewhere.offer(read_list(authority)), "it has that one"


def test_an_older_list_is_not_taken_back(authority: Authority, elsewhere: ReceivedList) -> None:
    authority.issue(NODE)
    older = read_list(authority)
    authority.revoke(authority.find("rpl/sealer"), "stolen")
    assert elsewhere.offer(read_list(authority))
    assert not elsewhere.offer(older)
    elsewhere.file.write_bytes(older)  # by hand
    with pytest.raises(BadInput, match="may allow certificates that were revoked"):
        elsewhere.read()
    assert not elsewhere.offer(older)
    elsewhere.file.unlink()
    assert not elsewhere.offer(older), "the number is remembered beside it"
    # The next one is a newer one for everybody.
    authority.issue(NODE)
    assert elsewhere.offer(read_list(authority))
    assert elsewhere.read() == authority.read_members()


def test_the_number_is_written_last(authority: Authority, elsewhere: ReceivedList) -> None:
    """A process that dies between the two has the newer list, and notes its number when it reads it."""
    elsewhere.read()
    authority.issue(NODE)
    elsewhere.file.write_bytes(read_list(authority))
    assert elsewhere.read().number == authority.read_members().number
    assert int((elsewhere.folder / NUMBER).read_text()) == authority.read_members().number


@pytest.mark.parametrize("change", ["entries", "number", "signature", "none", "another", "text"])
def test_what_the_authority_has_not_signed_is_not_kept(
    authority: Authority, elsewhere: ReceivedList, tmp_path: Path, change: str
) -> None:
    before = elsewhere.read()
    authority.issue(NODE)
    members = authority.read_members()
    evil = Authority(tmp_path / "evil")
    evil.init("test")
    for who in (
        BUS,
        NODE,
        PartyIdentity("node", "rpl/peeler", "lab-1"),
        PartyIdentity("kernel", lab="lab-1"),
    ):
        evil.issue(who)
    changed = {
        "entries": msgspec.structs.replace(members, entries=members.entries[:1]),
        "number": msgspec.structs.replace(members, number=members.number + 1),
        "signature": msgspec.structs.replace(members, signature="AAAA"),
        "none": msgspec.structs.replace(members, signature="", number=99),
        "another": evil.read_members(),
        "text": members,
    }[change]
    data = b"{" if change == "text" else msgspec.json.encode(changed)
    with pytest.raises(BadInput):
        elsewhere.offer(data)
    assert elsewhere.read() == before
    if change != "text":
        elsewhere.file.write_bytes(data)
        with pytest.raises(BadInput, match="not signed by the authority"):
            elsewhere.read()


def test_a_list_without_end_is_not_read(elsewhere: ReceivedList) -> None:
    with pytest.raises(BadInput, match="bytes was received"):
        elsewhere.offer(b" " * (9 * 1024 * 1024))


def test_lists_from_before_numbers_and_of_a_site_are_copied_by_hand(
    authority: Authority, elsewhere: ReceivedList
) -> None:
    unsigned = Members(authority.read_members().entries)
    elsewhere.file.write_bytes(msgspec.json.encode(unsigned))
    assert elsewhere.read() == unsigned
    with pytest.raises(BadInput):
        elsewhere.offer(msgspec.json.encode(msgspec.structs.replace(unsigned, number=7)))
    # With the first signed one that ends.
    assert elsewhere.offer(read_list(authority))
    elsewhere.file.write_bytes(msgspec.json.encode(msgspec.structs.replace(unsigned, number=7)))
    with pytest.raises(BadInput, match="not signed"):
        elsewhere.read()


def test_the_copy_in_the_folder_of_a_bus_is_the_list(authority: Authority) -> None:
    authority.issue(NODE)
    folder = authority.credentials(BUS).folder
    assert (folder / MEMBERS).read_bytes() == authority.members_file.read_bytes()
    assert ReceivedList(folder).read().number == authority.read_members().number
