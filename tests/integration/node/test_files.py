"""Files between node and lab, over a real bus: what arrives is what was pinned, or nothing."""

from __future__ import annotations

import asyncio
import random
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import msgspec
import pytest

from labos.bus import ZenohBus, open_bus
from labos.core.canonical import digest
from labos.errors import DeviceError
from labos.node.files import PIECE, Attachment, Files, hand_over
from labos.node.protocol import FileReply, KeepFile
from labos.runtime import files
from labos.runtime.files import FileDesk
from labos.settings import free_port
from labos.store import FolderBlobs

KEY = "labos/lab7/@files"
LARGE = random.Random(7).randbytes(2 * PIECE + 4711)


class Place:
    """A lab's side and a node's side of one bus."""

    def __init__(self, folder: Path, kernel: ZenohBus, node: ZenohBus) -> None:
        self.blobs = FolderBlobs(folder / "blobs")
        self.desk = FileDesk(self.blobs, folder / "arriving")
        self.folder, self.kernel, self.node = folder, kernel, node
        self.files = Files(node, KEY, folder / "node", timeout_s=5.0)


@asynccontextmanager
async def place(folder: Path) -> AsyncIterator[Place]:
    where = f"tcp/127.0.0.1:{free_port()}"
    kernel = await open_bus(mode="router", listen=[where])
    node = await open_bus(mode="client", connect=[where])
    try:
        yield Place(folder, kernel, node)
    finally:
        await node.close()
        await kernel.close()


def test_a_pinned_file_arrives_whole_and_is_fetched_once(tmp_path: Path) -> None:
    async def check() -> None:
        async with place(tmp_path) as lab:
            asked = []

            async def count(payload: bytes) -> bytes:
                asked.append(payload)
                return await lab.desk.on_request(payload)

            await lab.kernel.serve(KEY, count)
            name = lab.blobs.put(LARGE)
            path = await lab.files.fetch(name, "protocols/mix.yaml")
            assert path.name == "mix.yaml"
            assert path.read_bytes() == LARGE
            assert len(asked) == 3
            await lab.files.fetch(name, "protocols/mix.yaml")
            assert len(asked) == 3
            path.write_bytes(b"somebody changed it")
            assert (await lab.files.fetch(name, "protocols/mix.yaml")).read_bytes() == LARGE

    asyncio.run(check())


def test_a_file_that_the_lab_has_not_moves_nothing(tmp_path: Path) -> None:
    async def check() -> None:
        async with place(tmp_path) as lab:
            await lab.kernel.serve(KEY, lab.desk.on_request)
            with pytest.raises(DeviceError, match=r"mix\.yaml cannot be fetched") as raised:
                await lab.files.fetch("0" * 64, "mix.yaml")
            assert raised.value.effects == "none"
            damaged = lab.blobs.put(b"abc")
            (tmp_path / "blobs" / damaged[:2] / damaged[2:4] / damaged).write_bytes(b"abd")
            with pytest.raises(DeviceError, match="its bytes changed"):
                await lab.files.fetch(damaged, "mix.yaml")

    asyncio.run(check())


def test_names_do_not_lead_out_of_the_folder(tmp_path: Path) -> None:
    async def check() -> None:
        async with place(tmp_path) as lab:
            await lab.kernel.serve(KEY, lab.desk.on_request)
            name = lab.blobs.put(b"abc")
            for written in ("../../away", "..\\..\\away", "/etc/away", ".."):
                path = await lab.files.fetch(name, written)
                assert path.resolve().is_relative_to(tmp_path / "node")

    asyncio.run(check())


def test_a_file_that_is_left_is_with_the_lab_before_the_result(tmp_path: Path) -> None:
    picture = tmp_path / "picture.raw"
    picture.write_bytes(LARGE)

    async def check() -> None:
        async with place(tmp_path) as lab:
            await lab.kernel.serve(KEY, lab.desk.on_request)
            result = await hand_over(
                {"picture": Attachment("p.raw", picture), "notes": [Attachment("n.txt", b"")], "n": 1},
                lab.files,
            )
            assert result["picture"] == {"file": "p.raw", "sha256": digest(LARGE), "bytes": len(LARGE)}
            assert lab.blobs.get(digest(LARGE)) == LARGE
            assert lab.blobs.get(result["notes"][0]["sha256"]) == b""
            assert list((tmp_path / "arriving").iterdir()) == []

    asyncio.run(check())


def test_a_node_that_was_cut_off_goes_on_where_it_was(tmp_path: Path) -> None:
    async def check() -> None:
        async with place(tmp_path) as lab:
            sizes: list[int] = []

            async def cut_off_after_one_piece(payload: bytes) -> bytes:
                sizes.append(len(payload))
                if len(sizes) == 3:
                    serving.close()
                    again.set()
                    await asyncio.Event().wait()
                return await lab.desk.on_request(payload)

            again = asyncio.Event()
            serving = await lab.kernel.serve(KEY, cut_off_after_one_piece)
            lab.files._timeout_s = 0.5
            sending = asyncio.create_task(lab.files.send(Attachment("p.raw", LARGE)))
            await again.wait()
            await lab.kernel.serve(KEY, lab.desk.on_request)
            await sending
            assert lab.blobs.get(digest(LARGE)) == LARGE

    asyncio.run(check())


def test_bytes_that_are_not_what_their_name_says_are_refused(tmp_path: Path) -> None:
    async def check() -> None:
        async with place(tmp_path) as lab:

            async def garble(payload: bytes) -> bytes:
                return await lab.desk.on_request(payload.replace(digest(b"abc").encode(), b"0" * 64))

            await lab.kernel.serve(KEY, garble)
            with pytest.raises(DeviceError, match="does not match its SHA-256") as raised:
                await lab.files.send(Attachment("p.raw", b"abc"))
            assert raised.value.effects == "all"

    asyncio.run(check())


def test_what_cannot_be_a_request_is_told(tmp_path: Path) -> None:
    async def check() -> None:
        async with place(tmp_path) as lab:
            negative = KeepFile("0" * 64, -1)
            for wrong in (b"", b"{}", b'{"op":"fetch","digest":"../../x"}', msgspec.json.encode(negative)):
                reply = msgspec.json.decode(await lab.desk.on_request(wrong), type=FileReply)
                assert reply.problem

    asyncio.run(check())


def test_a_file_with_a_very_long_name_arrives(tmp_path: Path) -> None:
    async def check() -> None:
        async with place(tmp_path) as lab:
            await lab.kernel.serve(KEY, lab.desk.on_request)
            name = lab.blobs.put(b"steps")
            path = await lab.files.fetch(name, "protocols/" + "ä" * 300 + ".yaml")
            assert path.read_bytes() == b"steps"
            assert path.suffix == ".yaml"

    asyncio.run(check())


def test_a_file_that_cannot_be_kept_beside_the_node_moved_nothing(tmp_path: Path) -> None:
    async def check() -> None:
        async with place(tmp_path) as lab:
            await lab.kernel.serve(KEY, lab.desk.on_request)
            (tmp_path / "node").write_text("no folder")
            with pytest.raises(DeviceError, match="cannot be stored beside the node") as caught:
                await lab.files.fetch(lab.blobs.put(b"steps"), "mix.yaml")
            assert caught.value.effects == "none"

    asyncio.run(check())


def test_files_that_never_become_whole_do_not_fill_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def check() -> None:
        blobs = FolderBlobs(tmp_path / "blobs")
        arriving = tmp_path / "arriving"
        desk = FileDesk(blobs, arriving)

        async def send(name: str, data: bytes, size: int = 100, offset: int = 0) -> FileReply:
            answer = await desk.on_request(msgspec.json.encode(KeepFile(name, size, offset, data)))
            return msgspec.json.decode(answer, type=FileReply)

        whole = b"y" * 50
        assert (await send(digest(whole), whole[:20], 50)).received == 20
        for number in range(200):
            assert (await send(digest(str(number).encode()), b"x")).received == 1
            assert len(list(arriving.iterdir())) <= files.MOST_ARRIVING
        # The one that was cut off is told to begin anew, and arrives.
        assert (await send(digest(whole), whole[20:], 50, 20)).received == 0
        assert (await send(digest(whole), whole, 50)).received == 50
        assert blobs.get(digest(whole)) == whole
        assert "allowed" in (await send("1" * 64, b"x" * (PIECE + 1), 2 * PIECE)).problem
        # More than was announced is not kept.
        assert (await send("2" * 64, b"x" * 50, 10)).problem == files.WRONG_BYTES
        monkeypatch.setattr(files, "STALE_S", -1.0)
        await send("3" * 64, b"x")
        assert [path.name for path in arriving.iterdir()] == ["3" * 64]

    asyncio.run(check())
