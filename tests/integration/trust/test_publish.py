"""Checkpoints are brought to folders, servers, witnesses and time stamp authorities, real ones."""

from __future__ import annotations

import asyncio
import json
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

import msgspec
import pytest

from labos.core.ids import LabId
from labos.core.merkle import Edge, hash_leaf
from labos.errors import LogDamaged, NotFound, Refused
from labos.http.witness import serve_witness
from labos.services.trust.compare import CheckpointComparison, compare
from labos.services.trust.keys import SigningKeys
from labos.services.trust.notes import make_key, parse_note
from labos.services.trust.places import name_checkpoint
from labos.services.trust.publish import Targets, publish
from labos.services.trust.tree import TREE_FILE, grow, read_tree
from labos.services.trust.witness import Witness, encode_request, parse_request
from labos.store import open_store
from tests.integration.trust.conftest import NAME, Lab, chain_anew, run_openssl, serve_http
from tests.support.processes import run_process
from tests.unit.services.logbook import two_users

RECORDS = two_users().records
END = len(RECORDS)


@contextmanager
def run_witness(lab: Lab, folder: Path) -> Iterator[str]:
    """A witness that serves HTTP, in a thread."""
    keys = SigningKeys(folder)
    if not (folder / "keys").exists():
        keys.create("other.example.org/witness", witness=True)
    witness = Witness(
        folder / "witness", keys.read_signing_key(witness=True), SigningKeys(lab.home).list_public_keys()
    )
    loop = asyncio.new_event_loop()
    ready = threading.Event()
    urls: list[str] = []
    tasks: list[asyncio.Task[None]] = []

    def tell(url: str) -> None:
        urls.append(url)
        ready.set()

    async def serve() -> None:
        tasks.append(asyncio.ensure_future(serve_witness(witness, "127.0.0.1", 0, tell)))
        with suppress(asyncio.CancelledError):
            await tasks[0]

    def run() -> None:
        loop.run_until_complete(serve())
        loop.close()

    thread = threading.Thread(target=run)
    thread.start()
    assert ready.wait(10)
    try:
        yield urls[0]
    finally:
        loop.call_soon_threadsafe(tasks[0].cancel)
        thread.join()


# -- places -------------------------------------------------------------------------------------


def test_a_checkpoint_is_put_on_a_server(lab: Lab) -> None:
    kept: dict[str, bytes] = {}

    def take(method: str, path: str, body: bytes) -> tuple[int, str, bytes]:
        kept[path] = body
        return 201, "text/plain", b""

    with serve_http(take) as url:
        said = lab.ask("checkpoint", "--to", f"{url}/lab1")
    assert f"Kept in {url}/lab1" in said
    assert kept == {f"/lab1/{name_checkpoint(END)}": (lab.safe / name_checkpoint(END)).read_bytes()}


def test_a_place_that_takes_nothing_keeps_the_others_from_nothing(lab: Lab, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with serve_http(lambda *_: (403, "text/plain", b"")) as url:
        said = lab.ask(
            *("checkpoint", "--to", url, "--to", str(tmp_path / "file"), "--to", str(tmp_path / "good")),
            code=1,
        )
    assert "was refused: the server answers 403" in said
    assert "file" in said
    assert (tmp_path / "good" / name_checkpoint(END)).exists()


def test_a_server_that_is_not_there(lab: Lab) -> None:
    assert "cannot be reached" in lab.ask("checkpoint", "--to", "http://127.0.0.1:9", code=1)
    assert "cannot be stored at ftp://x" in lab.ask("checkpoint", "--to", "ftp://x", code=1)


def test_without_a_key_or_a_log_nothing_is_signed(tmp_path: Path) -> None:
    lab = Lab(tmp_path / "lab")
    lab.write(RECORDS[:3])
    with pytest.raises(NotFound, match="has no key"):
        lab.publish()
    SigningKeys(lab.home).create(NAME)
    open_store(f"sqlite:///{lab.home / 'x.db'}").close()
    empty = open_store(f"sqlite:///{lab.home / 'x.db'}", create=False, read_only=True)
    try:
        with pytest.raises(Refused, match="The log is empty"):
            publish(empty, lab.home, Targets())
    finally:
        empty.close()


def test_only_the_right_edge_is_kept(lab: Lab) -> None:
    """What is remembered of a log does not grow with it; going on from there gives the same tree."""
    kept = read_tree(lab.home)
    assert kept.size == END
    assert len(kept.edge) == END.bit_count()
    edge = Edge()
    for record in RECORDS:
        edge.add(hash_leaf(record.envelope))
    assert kept.edge == tuple(each.hex() for each in edge.hashes)
    (lab.home / TREE_FILE).unlink()
    assert lab.publish().note.encode() == (lab.safe / name_checkpoint(END)).read_bytes()


def test_a_damaged_record_is_not_signed(lab: Lab) -> None:
    """Whoever changes a payload leaves the chain's hash as it is: the tree does not see it, the reader
    does."""
    records = list(RECORDS)
    records[4] = msgspec.structs.replace(records[4], payload=b'{"x":1}')
    lab.write(records)
    (lab.home / TREE_FILE).unlink()
    store = open_store(f"sqlite:///{lab.home / 'labos.db'}", create=False, read_only=True)
    try:
        with pytest.raises(LogDamaged, match="Position 5: the payload is not the one"):
            grow(store, read_tree(lab.home))
    finally:
        store.close()


@pytest.mark.postgres
def test_a_log_on_postgres_is_signed_as_well(tmp_path: Path, postgres_url: str) -> None:
    home = tmp_path / "lab"
    SigningKeys(home).create(NAME)
    store = open_store(postgres_url, home=home)
    try:
        head = store.claim(LabId("lab-1"), "test", 30.0)
        for first in (0, END // 2):
            head = store.append(head, RECORDS[first : first + (END // 2 or END)])
            made = publish(store, home, Targets())
            assert made.head.size == head.position
            assert compare(store, [made.head]) == CheckpointComparison(1, head.position)
        store.release(head.epoch)
    finally:
        store.close()


# -- witnesses ----------------------------------------------------------------------------------


def test_a_witness_cosigns_what_continues(lab: Lab, tmp_path: Path) -> None:
    with run_witness(lab, tmp_path / "other") as url:
        lab.write(RECORDS[: END - 5])
        for file in (lab.home / TREE_FILE, *(lab.home / "checkpoints").iterdir()):
            file.unlink()
        first = lab.publish(url)
        assert first.faults == ()
        lab.write(RECORDS[: END - 2])
        lab.publish()  # the witness does not hear of this one
        lab.write(RECORDS)
        last = lab.publish(url)
        again = lab.publish(url)
    witness = SigningKeys(tmp_path / "other").read_signing_key(witness=True).public
    assert len(lab.publish().note.signatures) == 2, "what was cosigned stays so"
    for made in (first, last, again):
        assert made.faults == ()
        assert parse_note(made.note.encode()).find_signers([witness]) == [witness]
    (tmp_path / "witness.pub").write_text(witness.text)
    args = ("--public-key", str(lab.public), "--witness-key", str(tmp_path / "witness.pub"))
    said = lab.ask("verify", "--bundle", str(lab.bundle()), *args)
    assert "The witness other.example.org/witness cosigned it at" in said
    alone = make_key("nobody", 4, bytes(32)).public.text
    said = lab.ask("verify", "--bundle", str(lab.bundle()), *args[:2], "--witness-key", alone, code=1)
    assert "The witness nobody has not cosigned" in said


def test_a_witness_does_not_cosign_another_story(lab: Lab, tmp_path: Path) -> None:
    """The lab's own folder is made to forget everything; the witness, restarted meanwhile, does not."""
    with run_witness(lab, tmp_path / "other") as url:
        assert lab.publish(url).faults == ()
    head = msgspec.structs.replace(RECORDS[6].head, actor="mallory")
    forged = chain_anew([*RECORDS[:6], msgspec.structs.replace(RECORDS[6], head=head), *RECORDS[7:]])
    with run_witness(lab, tmp_path / "other") as url:
        for story, said in ((forged, "409"), (forged[:-3], "it was cut off"), (RECORDS, "")):
            lab.write(story)
            shutil.rmtree(lab.home / "checkpoints")
            (lab.home / TREE_FILE).unlink()
            made = lab.publish(url)
            assert said in "".join(made.faults)
            assert len(made.note.signatures) == (1 if said else 2)


def test_what_a_witness_answers(lab: Lab, tmp_path: Path) -> None:
    """By the words of C2SP tlog-witness."""
    other = make_key("w.example.org", 4, bytes(32))
    witness = Witness(tmp_path / "w", other, SigningKeys(lab.home).list_public_keys())
    note = lab.publish().note
    whole = encode_request(0, [], note)
    assert parse_request(whole) == (0, [], note)
    assert witness.add(b"old x\n\n" + note.encode(), 1).status == 400
    assert witness.add(b"", 1).status == 400
    assert witness.add(encode_request(END + 1, [], note), 1).status == 400
    stranger = make_key("else.example.org", 1, bytes(32))
    foreign = note.text.replace(NAME, stranger.name)
    unknown = msgspec.structs.replace(note, text=foreign, signatures=(stranger.sign(foreign),))
    assert witness.add(encode_request(0, [], unknown), 1).status == 404
    unsigned = msgspec.structs.replace(note, signatures=(stranger.sign(note.text),))
    assert witness.add(encode_request(0, [], unsigned), 1).status == 403
    forged = msgspec.structs.replace(note, text=note.text.replace(f"\n{END}\n", f"\n{END + 1}\n"))
    assert witness.add(encode_request(0, [], forged), 1).status == 403
    assert witness.add(encode_request(0, [bytes(32)], note), 1).status == 422
    conflict = witness.add(encode_request(5, [bytes(32)], note), 1)
    assert (conflict.status, conflict.text, conflict.type) == (409, "0\n", "text/x.tlog.size")
    assert witness.add(whole, 1).status == 200
    assert witness.add(whole, 1).status == 409
    assert witness.add(encode_request(END, [], note), 1).status == 200


@pytest.mark.slow
def test_a_witness_runs_as_a_command(lab: Lab, tmp_path: Path) -> None:
    home = tmp_path / "other"
    key = SigningKeys(home).create("w.example.org", witness=True)
    argv = [
        sys.executable,
        "-m",
        "labos",
        "witness",
        "--public-key",
        str(lab.public),
        "--port",
        "0",
        "--home",
        str(home),
    ]
    with run_process(argv, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        url = process.stdout.readline().split()[-1].rstrip(".")
        said = lab.ask("checkpoint", "--witness", url, "--witness-key", key.text, "--json")
        process.terminate()
        process.communicate(timeout=20)
    assert json.loads(said)["signatures"] == [NAME, "w.example.org"]
    assert process.returncode == 0


# -- time stamps --------------------------------------------------------------------------------

TSA = """\
[tsa]
default_tsa = here
[here]
serial = serial
signer_cert = tsa.pem
signer_key = tsa.key
signer_digest = sha256
default_policy = 1.2.3.4
digests = sha256,sha512
ess_cert_id_alg = sha256
[v3]
extendedKeyUsage = critical,timeStamping
keyUsage = critical,digitalSignature
"""


@contextmanager
def authority(folder: Path) -> Iterator[str]:
    """A time stamp authority made of openssl; its root is ``folder/root.pem``."""
    folder.mkdir()
    (folder / "tsa.cnf").write_text(TSA)
    (folder / "serial").write_text("01\n")
    new = ("req", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes")
    run_openssl(
        folder, *new, "-x509", "-days", "2", "-subj", "/CN=root", "-keyout", "root.key", "-out", "root.pem"
    )
    run_openssl(folder, *new, "-subj", "/CN=tsa", "-keyout", "tsa.key", "-out", "tsa.csr")
    sign = ("x509", "-req", "-in", "tsa.csr", "-CA", "root.pem", "-CAkey", "root.key", "-CAcreateserial")
    run_openssl(folder, *sign, "-days", "2", "-extfile", "tsa.cnf", "-extensions", "v3", "-out", "tsa.pem")

    def stamp(method: str, path: str, body: bytes) -> tuple[int, str, bytes]:
        (folder / "query.tsq").write_bytes(body)
        run_openssl(
            folder, *("ts", "-reply", "-config", "tsa.cnf", "-queryfile", "query.tsq", "-out", "r.tsr")
        )
        return 200, "application/timestamp-reply", (folder / "r.tsr").read_bytes()

    with serve_http(stamp) as url:
        yield url


def test_a_time_stamp_is_kept_and_checked(lab: Lab, tmp_path: Path) -> None:
    pytest.importorskip("rfc3161_client")
    with authority(tmp_path / "tsa") as url:
        made = lab.publish(stamp=url)
    assert made.faults == ()
    assert made.stamped
    stamp = lab.safe / f"{END:012d}.tsr"
    text = tmp_path / "text"
    text.write_text(made.note.text)
    root = tmp_path / "tsa" / "root.pem"
    run_openssl(tmp_path, "ts", "-verify", "-data", str(text), "-in", str(stamp), "-CAfile", str(root))
    path = lab.bundle()
    said = lab.ask("verify", "--bundle", str(path), "--public-key", str(lab.public), "--tsa", str(root))
    assert "the checkpoint existed at 20" in said
    assert "it was not checked" in lab.ask("verify", "--bundle", str(path), "--public-key", str(lab.public))
    with authority(tmp_path / "another"):
        other = str(tmp_path / "another" / "root.pem")
    said = lab.ask("verify", "--bundle", str(path), "--public-key", str(lab.public), "--tsa", other, code=1)
    assert "The time stamp is not valid" in said


def test_an_authority_that_gives_no_time_stamp(lab: Lab) -> None:
    pytest.importorskip("rfc3161_client")
    with serve_http(lambda *_: (200, "application/timestamp-reply", b"junk")) as url:
        made = lab.publish(stamp=url)
    assert "gave none" in made.faults[0]
    assert not made.stamped
    assert (lab.safe / name_checkpoint(END)).exists()


# -- the process that follows -------------------------------------------------------------------


@pytest.mark.slow
def test_a_checkpoint_follows_each_so_many_events(lab: Lab) -> None:
    """Its own process, on a log that grows meanwhile; it ends in order, and goes on where it was."""
    lab.write(RECORDS[: END - 6])
    shutil.rmtree(lab.safe)
    shutil.rmtree(lab.home / "checkpoints")
    (lab.home / TREE_FILE).unlink()
    argv = [sys.executable, "-m", "labos", "checkpoint", "--follow", "--every", "3", "--to", str(lab.safe)]
    argv += ["--home", str(lab.home), "--json"]
    with run_process(argv, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        sizes = [next_size(process.stdout)]
        store = open_store(f"sqlite:///{lab.home / 'labos.db'}", home=lab.home)
        try:
            head = store.claim(store.head().lab, "test", 30.0)
            for first in (END - 6, END - 3):
                head = store.append(head, RECORDS[first : first + 3])
                sizes.append(next_size(process.stdout))
            store.release(head.epoch)
        finally:
            store.close()
        process.terminate()
        process.communicate(timeout=20)
    assert process.returncode == 0
    assert sizes == [END - 6, END - 3, END]
    assert f"3 signed checkpoints, up to position {END}" in lab.ask("verify", "--checkpoint", str(lab.safe))


def next_size(lines: IO[str]) -> int:
    """The size of the next checkpoint that is told."""
    for line in lines:
        if line.strip().startswith('"size"'):
            return int(line.split()[-1].rstrip(","))
    raise AssertionError("it has ended")
