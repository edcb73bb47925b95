"""Pictures that steps have returned, fetched by the client, over HTTP in parts, and on the command line."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from click.testing import CliRunner, Result

from labos.bootstrap import LabThread, descriptions
from labos.cli.files import command
from labos.client import LabClient
from labos.client._lab import API
from labos.errors import BadInput, NotFound
from labos.settings import Settings
from labos.spec import parse_workcell
from labos.store import FolderBlobs

CELL = """
labos: 1
name: corner
modules: [{name: camera, model: camera}]
stock: {camera.plate_station: {plate96: 1}}
"""
LOOK = """
labos: 1
name: look
steps:
  - {name: Look, module: camera, action: grab_image, args: {file_name: pictures/plate.png}}
"""


class Lab:
    """A lab at work, with a picture in it."""

    def __init__(self, home: Path, lab: LabThread) -> None:
        self.home, self.url = home, lab.url
        self.client = LabClient(lab.url)
        self.run = self.client.submit({"text": LOOK}, user="ada")
        ended = self.client.wait(self.run, timeout_s=60)
        assert ended.status == "completed", ended
        self.picture: dict[str, Any] = ended.result("Look")

    def files(self, *argv: str, code: int = 0) -> Result:
        told = CliRunner().invoke(command, [*argv, "--home", str(self.home)])
        if told.exception is not None and not isinstance(told.exception, SystemExit):
            raise told.exception
        assert told.exit_code == code, told.output
        return told


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Lab]:
    home = tmp_path_factory.mktemp("files") / "lab"
    cell = parse_workcell(CELL, descriptions())
    with LabThread(Settings.make(home, speed=1000.0, simulate=True, wire=True), [cell]) as running:
        found = Lab(home, running)
        yield found
        found.client.close()


def test_the_client_gets_a_file_and_parts_of_it(lab: Lab) -> None:
    whole = lab.client.file(lab.picture)
    assert hashlib.sha256(whole).hexdigest() == lab.picture["sha256"]
    assert lab.client.file(lab.picture["sha256"], first=3, last=7) == whole[3:8]
    assert lab.client.file(lab.picture, first=len(whole) - 2) == whole[-2:]
    with pytest.raises(BadInput, match="has no bytes"):
        lab.client.file(lab.picture, first=len(whole))
    with pytest.raises(NotFound):
        lab.client.file("0" * 64)
    with pytest.raises(BadInput, match="is not a file"):
        lab.client.file({"file": "x"})


def test_a_picture_and_a_table_in_one_call(lab: Lab) -> None:
    image = lab.client.image(lab.picture)
    assert (image.format, image.mode, image.width) == ("PNG", "RGB", 800)
    with pytest.raises(BadInput, match=r"plate\.png is not a table"):
        lab.client.table(lab.picture)
    name = keep_file(lab, b"well;OD\r\nA1;0,25\r\nA2;1\r\n")
    assert lab.client.table(name) == [{"well": "A1", "OD": 0.25}, {"well": "A2", "OD": 1}]
    with pytest.raises(BadInput, match="is not a picture"):
        lab.client.image(name)
    with pytest.raises(NotFound):
        lab.client.table("0" * 64)


def keep_file(lab: Lab, content: bytes) -> str:
    """A file that the lab has, by its SHA-256."""
    return FolderBlobs(lab.home / "blobs").put(content)


def test_ranges_over_http(lab: Lab) -> None:
    size = lab.picture["bytes"]
    with httpx.Client(base_url=lab.url + API) as raw:
        path = f"/files/{lab.picture['sha256']}"
        whole = raw.get(path)
        assert (whole.status_code, len(whole.content)) == (200, size)
        end = raw.get(path, headers={"range": "bytes=-4"})
        assert (end.status_code, end.content) == (206, whole.content[-4:])
        assert end.headers["content-range"] == f"bytes {size - 4}-{size - 1}/{size}"
        beyond = raw.get(path, headers={"range": f"bytes={size}-"})
        assert (beyond.status_code, beyond.headers["content-range"]) == (416, f"bytes */{size}")
        several = raw.get(path, headers={"range": "bytes=0-1,4-5"})
        assert (several.status_code, several.content) == (200, whole.content)
        other = raw.get(path, headers={"range": "bytes=0-1", "if-range": '"another"'})
        assert other.status_code == 200
        assert raw.get(path, headers={"if-none-match": whole.headers["etag"]}).status_code == 304
        assert raw.get("/files/..%2Flabos.key").status_code == 404


def test_the_command_lists_and_fetches(lab: Lab, tmp_path: Path) -> None:
    assert "plate.png" in lab.files(lab.run).stdout
    (told,) = json.loads(lab.files("--json").stdout)
    assert (told["run"], told["step"], told["sha256"]) == (lab.run, "Look", lab.picture["sha256"])
    lab.files(lab.run, "--output", str(tmp_path / "all"))
    content = (tmp_path / "all" / "plate.png").read_bytes()
    assert content == lab.client.file(lab.picture)
    lab.files(lab.run, told["sha256"][:12], "--output", str(tmp_path / "mine.png"))
    assert (tmp_path / "mine.png").read_bytes() == content
    assert lab.files(lab.run, "plate.png", "--output", "-").stdout_bytes == content


def test_nothing_is_written_over(lab: Lab, tmp_path: Path) -> None:
    (tmp_path / "plate.png").write_bytes(b"mine")
    with pytest.raises(BadInput, match="already exists, and is another file"):
        lab.files(lab.run, "--output", str(tmp_path))
    assert (tmp_path / "plate.png").read_bytes() == b"mine"
    with pytest.raises(NotFound, match=r"has no file 'other\.png'"):
        lab.files(lab.run, "other.png", "--output", str(tmp_path))
    with pytest.raises(NotFound, match="There is no run 'R99'"):
        lab.files("R99")
