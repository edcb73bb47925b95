"""Who rewrites a log or a bundle is found out, and where: the table in docs/security.md."""

from __future__ import annotations

import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest
from click.testing import CliRunner

from labos.core.envelope import Record
from labos.core.runs import RunCompleted
from labos.services.trust.checkpoints import parse_tree_head, sign_tree
from labos.services.trust.keys import SigningKeys
from labos.services.trust.notes import SIGNS, make_key, parse_note
from labos.services.trust.places import find_newest, name_checkpoint
from labos.services.trust.tree import TREE_FILE
from tests.integration.trust.conftest import NAME, Lab, chain_anew
from tests.unit.cli_queries.conftest import command_of
from tests.unit.services.logbook import two_users

RECORDS = two_users().records
HALF, END = len(RECORDS) // 2, len(RECORDS)


def alter(position: int) -> list[Record]:
    """Another actor at a position, and a chain that is right in itself."""
    records = list(RECORDS)
    changed = msgspec.structs.replace(records[position - 1].head, actor="mallory")
    records[position - 1] = msgspec.structs.replace(records[position - 1], head=changed)
    return chain_anew(records)


# -- the log ------------------------------------------------------------------------------------


def test_a_log_that_agrees_with_its_checkpoints(lab: Lab) -> None:
    said = lab.ask("verify", "--checkpoint", str(lab.safe), "--public-key", str(lab.public))
    assert f"It agrees with 2 signed checkpoints, up to position {END}." in said


ATTACKS = {
    "rewritten in its first half": (lambda: alter(7), f"positions 1 to {HALF} were rewritten"),
    "rewritten in its second half": (
        lambda: alter(HALF + 3),
        f"positions {HALF + 1} to {END} were rewritten",
    ),
    "its tail cut off": (lambda: RECORDS[:-4], f"ends at position {END - 4}"),
    "its tail cut off and written anew": (
        lambda: alter(END),
        f"positions {HALF + 1} to {END} were rewritten",
    ),
    "a run removed": (
        lambda: chain_anew([each for each in RECORDS if each.head.stream != "R2"]),
        "its tail was cut off",
    ),
}


@pytest.mark.parametrize("attack", ATTACKS)
def test_a_log_that_was_rewritten(lab: Lab, attack: str) -> None:
    make, said = ATTACKS[attack]
    lab.write(make())
    found = lab.ask("verify", "--checkpoint", str(lab.safe), code=1)
    assert said in found
    assert "The log is damaged" not in found, "its chain is right in itself"
    refused = lab.ask("checkpoint", code=1)
    assert "Nothing was signed." in refused


def test_somebody_who_makes_the_lab_forget_what_it_has_signed(lab: Lab) -> None:
    """The copies elsewhere still say it."""
    lab.write(alter(7))
    (lab.home / TREE_FILE).unlink()
    assert "Nothing was signed." in lab.ask("checkpoint", code=1)
    shutil.rmtree(lab.home / "checkpoints")
    lab.ask("checkpoint")
    assert "were rewritten" in lab.ask("verify", "--checkpoint", str(lab.safe), code=1)


def test_a_checkpoint_that_somebody_else_has_signed(lab: Lab) -> None:
    path = find_newest(lab.safe)
    assert path is not None
    head = parse_tree_head(parse_note(path.read_bytes()).text)
    path.write_bytes(sign_tree(head, make_key(NAME, SIGNS, bytes(32))).encode())
    said = lab.ask("verify", "--checkpoint", str(lab.safe), code=1)
    assert f"{path} is not signed by a known key." in said


def test_a_signed_checkpoint_is_not_moved_on_by_verify(lab: Lab) -> None:
    path = lab.safe / name_checkpoint(END)
    before = path.read_bytes()
    assert "labos checkpoint" in lab.ask("verify", "--checkpoint", str(path), "--export", code=2)
    assert path.read_bytes() == before


def test_a_checkpoint_of_the_older_kind_still_serves(lab: Lab, tmp_path: Path) -> None:
    file = str(tmp_path / "old.json")
    assert "was written" in lab.ask("verify", "--checkpoint", file)
    assert "It agrees with the checkpoint" in lab.ask("verify", "--checkpoint", file)
    lab.write(alter(7))
    assert "was rewritten" in lab.ask("verify", "--checkpoint", file, code=1)


# -- a bundle -----------------------------------------------------------------------------------

Files = dict[str, bytes]


def edit(path: Path, change: Callable[[Files], None]) -> None:
    with zipfile.ZipFile(path) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    change(files)
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in files.items():
            archive.writestr(name, data)


def lines(files: Files) -> list[bytes]:
    return files["events.jsonl"].splitlines(keepends=True)


def change_a_payload(files: Files) -> None:
    found = lines(files)
    found[5] = found[5].replace(b'"payload":{', b'"payload":{"x":1,', 1)
    files["events.jsonl"] = b"".join(found)


def change_an_envelope(files: Files) -> None:
    found = lines(files)
    found[5] = found[5].replace(b'"actor":"', b'"actor":"mallory', 1)
    files["events.jsonl"] = b"".join(found)


def leave_an_event_out(files: Files) -> None:
    files["events.jsonl"] = b"".join(line for at, line in enumerate(lines(files)) if at != 8)


def leave_the_end_out(files: Files) -> None:
    files["events.jsonl"] = b"".join(
        line for line in lines(files) if b'"type":"%b"' % RunCompleted.TYPE.encode() not in line
    )


def change_the_order(files: Files) -> None:
    found = lines(files)
    files["events.jsonl"] = b"".join([*found[:3], found[4], found[3], *found[5:]])


def say_an_event_twice(files: Files) -> None:
    found = lines(files)
    files["events.jsonl"] = b"".join([*found[:4], found[3], *found[4:]])


def give_another_run(files: Files) -> None:
    files["bundle.json"] = files["bundle.json"].replace(b'"R1"', b'"R2"')


def replace_a_blob(files: Files) -> None:
    name = next(name for name in files if name.startswith("blobs/"))
    files[name] += b" "


def leave_a_blob_out(files: Files) -> None:
    del files[next(name for name in files if name.startswith("blobs/"))]


def add_a_blob(files: Files) -> None:
    files["blobs/" + "0" * 64] = b"evidence"


def claim_a_larger_log(files: Files) -> None:
    files["checkpoint.note"] = files["checkpoint.note"].replace(b"\n%d\n" % END, b"\n%d\n" % (END + 1))


def swap_the_key(files: Files) -> None:
    head = parse_tree_head(parse_note(files["checkpoint.note"]).text)
    files["checkpoint.note"] = sign_tree(head, make_key(NAME, SIGNS, bytes(32))).encode()


BUNDLES = {
    change_a_payload: "the payload of action.requested was changed after it was recorded",
    change_an_envelope: "the event is not in the log that was signed",
    leave_an_event_out: "number 9 is missing",
    leave_the_end_out: "The end of R1 is missing",
    change_the_order: "The events are not in the order of the log",
    say_an_event_twice: "The events are not in the order of the log",
    give_another_run: "The submission of R2 is missing",
    replace_a_blob: "was changed after it was stored",
    leave_a_blob_out: "which is not in the bundle",
    add_a_blob: "which no event names",
    claim_a_larger_log: "the text or the signature was changed",
    swap_the_key: "No key that was given has signed the checkpoint",
}


def test_a_bundle_proves_its_run_on_a_machine_that_has_only_it(lab: Lab) -> None:
    path = lab.bundle()
    shutil.rmtree(lab.home)
    said = lab.ask("verify", "--bundle", str(path), "--public-key", str(lab.public))
    assert "The bundle proves the run R1 of the lab lab-1." in said
    assert not lab.home.exists()


def test_the_same_run_gives_the_same_bundle(lab: Lab) -> None:
    assert lab.bundle().read_bytes() == lab.bundle().read_bytes()


@pytest.mark.parametrize("attack", BUNDLES, ids=lambda attack: attack.__name__)
def test_a_bundle_that_was_changed(lab: Lab, attack: Callable[[Files], None]) -> None:
    path = lab.bundle()
    edit(path, attack)
    said = lab.ask("verify", "--bundle", str(path), "--public-key", str(lab.public), code=1)
    assert BUNDLES[attack] in said
    assert "does not prove" in said


def test_a_bundle_of_a_lab_whose_key_was_swapped(lab: Lab) -> None:
    """Somebody with the whole log but without the private key signs another story."""
    keys = lab.home / "keys"
    shutil.rmtree(keys)
    shutil.rmtree(lab.home / "checkpoints")
    (lab.home / TREE_FILE).unlink()
    lab.write(alter(END - 2))
    SigningKeys(lab.home).create(NAME)
    lab.publish()
    said = lab.ask("verify", "--bundle", str(lab.bundle()), "--public-key", str(lab.public), code=1)
    assert "No key that was given has signed the checkpoint" in said


def test_a_bundle_after_a_change_of_the_key(lab: Lab) -> None:
    (lab.home / "checkpoints" / name_checkpoint(END)).unlink()
    SigningKeys(lab.home).rotate(HALF, "2026-05-04T10:00:00Z")
    lab.publish()
    path = lab.bundle()
    said = lab.ask("verify", "--bundle", str(path), "--public-key", str(lab.public))
    assert "the successor of the key that was given" in said
    edit(path, lambda files: files.pop("rotation.notes") and None)
    assert "No key that was given" in lab.ask(
        "verify", "--bundle", str(path), "--public-key", str(lab.public), code=1
    )


@pytest.mark.parametrize("data", [b"", b"PK\x03\x04", b"PK\x05\x06" + bytes(18), b"no zip" * 100])
def test_what_is_no_bundle(lab: Lab, tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "x.zip"
    path.write_bytes(data)
    assert "is not a bundle" in lab.ask("verify", "--bundle", str(path), code=1)


def test_each_flipped_byte_of_a_bundle_is_noticed_or_changes_nothing(lab: Lab) -> None:
    """A zip file has fields that nobody reads; what is read is proven."""
    path = lab.bundle()
    whole = path.read_bytes()
    good = lab.ask("verify", "--bundle", str(path), "--public-key", str(lab.public))
    for at in range(0, len(whole), len(whole) // 60):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
        said = run_verify(lab, path)
        assert said == good or "is not a bundle" in said or "does not prove" in said, at


def run_verify(lab: Lab, path: Path) -> str:
    args = ["--bundle", str(path), "--public-key", str(lab.public), "--home", str(lab.home)]
    result = CliRunner().invoke(command_of("verify"), args)
    return result.output or str(result.exception)


def test_a_run_that_has_not_ended_has_no_bundle(lab: Lab, tmp_path: Path) -> None:
    assert "has not ended" in lab.ask("bundle", "R2", "-o", str(tmp_path / "x.zip"), code=1)
    assert "There is no run, experiment or campaign 'R9'" in lab.ask(
        "bundle", "R9", "-o", str(tmp_path / "x.zip"), code=1
    )
    assert not (tmp_path / "x.zip").exists()
