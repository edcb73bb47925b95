"""Blobs in an object store: a real S3 server, and a whole lab whose pictures are kept there."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import fsspec
import httpx
import pytest

from labos.errors import BadInput, LogDamaged, NotFound, StoreUnavailable
from labos.settings import Settings, free_port
from labos.store import FolderBlobs, ObjectBlobs, open_blobs
from tests.support.foreign import python_of
from tests.support.lab_process import Up, labos

WORKFLOW = """\
labos: 1
name: look
workcell: corner
steps: [{name: look, module: camera, action: take_picture, args: {file_name: a.jpg}}]
"""
CELL = """\
labos: 1
name: corner
modules: [{name: camera, model: camera}]
stock: {camera.plate_station: {plate96: 1}}
"""


@pytest.fixture(scope="module")
def bucket() -> Iterator[str]:
    """``s3://labos`` on a server of its own; how it is reached and with which credentials is the business of
    the usual variables."""
    port = free_port()
    url = f"http://127.0.0.1:{port}"
    argv = [python_of("s3").with_name("moto_server"), "-H", "127.0.0.1", "-p", str(port)]
    quiet = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    server = subprocess.Popen(argv, **quiet)
    patch = pytest.MonkeyPatch()
    patch.setenv("AWS_ENDPOINT_URL", url)
    patch.setenv("AWS_ACCESS_KEY_ID", "labos")
    patch.setenv("AWS_SECRET_ACCESS_KEY", "secret")
    patch.setenv("AWS_DEFAULT_REGION", "us-east-1")
    keep_systems(patch)
    try:
        deadline = time.monotonic() + 30
        while True:
            try:
                httpx.get(url)
                break
            except httpx.TransportError:
                assert time.monotonic() < deadline, "the object store does not start"
                time.sleep(0.05)
        fsspec.filesystem("s3").mkdir("labos")
        yield "s3://labos"
    finally:
        patch.undo()
        close_sessions()
        server.kill()
        server.wait()


KEPT: list[object] = []


def keep_systems(patch: pytest.MonkeyPatch) -> None:
    """Keep the file systems that fsspec does not keep, until the process ends: the session of one that is
    thrown away in the middle of another test cannot be closed there, and complains."""
    systems = fsspec.get_filesystem_class("s3")
    begin = systems.__init__

    def begin_and_keep(self: object, *args: Any, **options: Any) -> None:
        begin(self, *args, **options)
        KEPT.append(self)

    patch.setattr(systems, "__init__", begin_and_keep)


def close_sessions() -> None:
    """Those that fsspec keeps for later: left open, they complain when they are thrown away."""
    systems = fsspec.get_filesystem_class("s3")
    for system in list(systems._cache.values()):
        systems.close_session(system.loop, system._s3)
    systems.clear_instance_cache()


def test_a_blob_comes_back(bucket: str) -> None:
    blobs = open_blobs(f"{bucket}/lab/")
    data = os.urandom(300_000)
    name = blobs.put(data)
    assert name == hashlib.sha256(data).hexdigest()
    assert blobs.put(data) == name
    empty = blobs.put(b"")
    assert (blobs.get(name), blobs.get(empty)) == (data, b"")
    assert list(ObjectBlobs(f"{bucket}/lab").names()) == sorted([name, empty])
    assert list(ObjectBlobs(f"{bucket}/other").names()) == []
    with pytest.raises(NotFound, match="There is no blob"):
        ObjectBlobs(f"{bucket}/other").get(name)
    with pytest.raises(NotFound, match="not the name of a blob"):
        blobs.get("../secret")


def test_a_changed_object_is_reported_and_mended(bucket: str) -> None:
    blobs = ObjectBlobs(f"{bucket}/damaged")
    name = blobs.put(b"abc")
    blobs._files.pipe_file(blobs._name_object(name), b"abd")
    with pytest.raises(LogDamaged, match=name):
        blobs.get(name)
    blobs.put(b"abc")
    assert blobs.get(name) == b"abc"


def test_no_bucket_no_server_no_such_kind(bucket: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(StoreUnavailable, match="not available"):
        ObjectBlobs("s3://nowhere/lab").put(b"abc")
    monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{free_port()}")
    monkeypatch.setenv("AWS_MAX_ATTEMPTS", "1")
    with pytest.raises(StoreUnavailable, match="s3://labos/gone"):
        ObjectBlobs("s3://labos/gone").put(b"abc")
    with pytest.raises(BadInput, match="Blobs cannot be stored at nix://labos"):
        open_blobs("nix://labos")


@pytest.mark.slow
def test_a_lab_keeps_its_pictures_there_and_its_backup_here(bucket: str, tmp_path: Path) -> None:
    (tmp_path / "corner.yaml").write_text(CELL)
    (tmp_path / "look.yaml").write_text(WORKFLOW)
    lab = Up(tmp_path / "lab", "--simulate", "--speed", "1000")
    lab.environment = {k: v for k, v in os.environ.items() if k.startswith("AWS_")}
    lab.environment["LABOS_BLOBS"] = f"{bucket}/pictures"
    try:
        lab.start(str(tmp_path / "corner.yaml"))
        with lab.client() as client:
            assert (
                client.wait(client.submit(tmp_path / "look.yaml", user="ada"), timeout_s=60).status
                == "completed"
            )
        assert lab.interrupt() == 0
    finally:
        lab.clean_up()
    kept = list(ObjectBlobs(f"{bucket}/pictures").names())
    assert len(kept) >= 1
    assert not (lab.home / "blobs").exists()
    assert Settings.make(lab.home).blobs == f"{bucket}/pictures", "the home remembers it"
    done = labos("backup", str(tmp_path / "safe"), "--home", str(lab.home), "--json")
    assert done.returncode == 0, done.stderr
    assert sorted(json.loads(done.stdout)["blobs"]) == sorted(kept)
    assert sorted(FolderBlobs(tmp_path / "safe" / "blobs").names()) == sorted(kept)
