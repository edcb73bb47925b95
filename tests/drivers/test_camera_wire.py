"""The camera driver on pictures: of a simulated network camera, of files, of a recording; all by OpenCV."""

from __future__ import annotations

import asyncio
import os
import queue
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from labos.core.wells import parse_well
from labos.errors import DeviceError, HalfReply, LinkLost, NotConnected, WrongDevice
from labos.node import Attachment, World
from labos.node.node import Setup
from labos_drivers._onhttp import HttpEnd, Reply
from labos_drivers.camera import Camera, source, vision
from labos_drivers.camera.driver import read_views
from labos_drivers.camera.photo import project
from labos_drivers.camera.render import picture_of
from labos_drivers.camera.sketch import HEIGHT, WIDTH, centre_of
from labos_drivers.camera.wire import CameraOnWire
from tests.drivers.wires import at_port, power_on, run, setup_of

cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed (it is with the extra `camera`)")
numpy = pytest.importorskip("numpy")

EAN_LEFT = ["0001101", "0011001", "0010011", "0111101", "0100011", "0110001", "0101111", "0111011"]
EAN_LEFT += ["0110111", "0001011"]


@pytest.fixture
def eye(world: World) -> Iterator[CameraOnWire]:
    with power_on(CameraOnWire, "eye", world) as device:
        yield device


def camera(address: Any, **config: Any) -> Camera:
    return Camera(setup_of("eye", None, 1.0, config={"source": address, **config}))


def picture(result: Attachment | str) -> Any:
    assert isinstance(result, Attachment)
    assert isinstance(result.content, bytes)
    return vision.decode(result.content)


def color(shown: Any, well: str) -> tuple[float, float, float]:
    """Red, green and blue in the middle of a well of a rendered plate, wherever in its nest that lies."""
    x, y = project(centre_of(*parse_well(well)), (WIDTH, HEIGHT))
    here = shown[round(y) - 4 : round(y) + 4, round(x) - 4 : round(x) + 4]
    blue, green, red = numpy.median(here, axis=(0, 1))  # the lamp is seen in a part of it
    return red, green, blue


# -- a network camera --------------------------------------------------------------------------


def test_a_picture_shows_the_colours_of_what_was_pipetted(eye: CameraOnWire, world: World) -> None:
    world.stock("eye.plate_station", "plate96")
    world.work(
        "ot2", "pipette", "eye.plate_station", volumes={"color_A": [275.0], "color_C": [0.0]}, wells=["C5"]
    )

    async def body() -> None:
        node = camera(eye.address)
        await node.connect()
        result = await node.grab_image("plate.png", save_location="runs")
        assert isinstance(result, Attachment)
        assert result.name == "runs/plate.png"
        shown = picture(result)
        assert color(shown, "C5") == pytest.approx((190, 30, 46), abs=12)
        assert color(shown, "A1") == pytest.approx((215, 211, 204), abs=12)
        turned = picture(await node.grab_image(rotation=90))
        assert turned.shape[:2] == shown.shape[:2][::-1]
        with pytest.raises(DeviceError, match="cannot be set") as told:
            await node.grab_image(focus=30)
        assert told.value.effects == "none"
        with pytest.raises(DeviceError, match="no known file type for pictures"):
            await node.grab_image("plate.doc")
        await node.close()

    run(body)
    assert {motion.verb for motion in world.motions()} >= {"picture"}


def test_labels_are_read_from_the_picture(eye: CameraOnWire, world: World) -> None:
    async def body() -> None:
        node = camera(eye.address)
        await node.connect()
        assert await node.read_barcode() == {"barcode": ""}
        (plate,) = world.stock("eye.plate_station", "plate96")
        assert await node.read_barcode() == {"barcode": "LB000001"}
        for label in ("a longer label, 2026/17", "Probe-äöü", ""):
            world.label(plate, label)
            assert await node.read_barcode() == {"barcode": label}
        await node.close()

    run(body)


def test_it_tells_only_what_can_be_told_from_the_picture(world: World) -> None:
    async def body(address: str) -> None:
        node = camera(address, observes=["wc.shelf"], reads=True)
        await node.connect()

        async def observe() -> dict[str, Any]:
            return dict((await node.observe())["labware"])

        assert await observe() == {"plate_station": 0, "wc.shelf": 0}
        (plate,) = world.stock("wc.shelf", "plate96")
        assert await observe() == {"plate_station": 0, "wc.shelf": "LB000001"}
        world.label(plate, "")
        assert await observe() == {"plate_station": 0, "wc.shelf": 1}
        world.work("a4s", "seal", "wc.shelf")
        # Foil over the wells, and no label: it may be a plate or not.
        assert await observe() == {"plate_station": 0}
        await node.close()

    with power_on(CameraOnWire, "eye", world, told={"config": {"observes": ["wc.shelf"]}}) as device:
        run(lambda: body(device.address))


def test_pictures_that_show_nothing_or_the_past(eye: CameraOnWire, world: World) -> None:
    async def body() -> None:
        node = camera(eye.address)
        await node.connect()
        eye.is_dark = True
        with pytest.raises(DeviceError, match="is black"):
            await node.grab_image()
        with pytest.raises(DeviceError, match="is black"):
            await node.observe()
        eye.is_dark = False
        await node.grab_image()
        eye.is_frozen = True
        for look in (node.grab_image, node.observe):
            with pytest.raises(DeviceError, match="frozen"):
                await look()
        eye.is_frozen = False
        await node.grab_image()
        await node.stop()
        with pytest.raises(DeviceError, match="was stopped") as told:
            await node.grab_image()
        assert told.value.effects == "none"
        await node.reset()
        await node.grab_image()
        await node.close()

    run(body)


def test_a_picture_that_never_comes(eye: CameraOnWire, world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    usual_s = source.FRAME_S

    async def body() -> None:
        node = camera(eye.address)
        await node.connect()
        eye.is_silent = True
        monkeypatch.setattr(source, "FRAME_S", 0.3)
        with pytest.raises(DeviceError, match="does not answer"):
            await node.grab_image()
        eye.is_silent = False
        monkeypatch.setattr(source, "FRAME_S", usual_s)
        eye.end.spoil = lambda raw: raw[: len(raw) // 2]
        with pytest.raises(HalfReply):
            await node.grab_image()
        eye.end.spoil = lambda raw: raw
        eye.end.unplug()
        with pytest.raises(NotConnected) as told:
            await node.grab_image()
        assert told.value.effects == "none"
        await node.close()

    run(body)


def test_what_answers_is_no_camera() -> None:
    end = HttpEnd()

    def answer() -> None:
        while end.is_plugged:
            try:
                question = end.requests.get(timeout=0.05)
            except queue.Empty:
                continue
            kind = {"Content-Type": "text/html"}
            question.replies.put(Reply(401 if question.parts == ("locked",) else 200, b"", kind))

    thread = threading.Thread(target=answer)
    thread.start()
    try:
        with pytest.raises(WrongDevice, match="what answers 200 text"):
            run(lambda: camera(f"{end.address}/index.html").connect())
        with pytest.raises(NotConnected, match="does not know this user"):
            run(lambda: camera(f"{end.address}/locked").connect())
        with pytest.raises(DeviceError, match="is not set"):
            run(lambda: camera(f"{end.address}/locked", user="a", password_env="NO_SUCH").connect())
    finally:
        end.close()
        thread.join()


# -- files, recordings, devices ----------------------------------------------------------------


def test_pictures_of_a_folder_come_one_after_the_other(world: World, tmp_path: Path) -> None:
    world.stock("eye.plate_station", "plate96")
    for number in range(2):
        shown = picture_of(world, ["eye.plate_station"], number)
        (tmp_path / f"{number}.png").write_bytes(vision.encode(shown + number, f"{number}.png"))
    (tmp_path / "notes.txt").write_text("no picture")

    async def body() -> None:
        node = camera(str(tmp_path))
        await node.connect()
        first, second, again = [picture(await node.grab_image("a.png")) for _ in range(3)]
        assert (first == again).all()
        assert not (first == second).all()
        assert await node.read_barcode() == {"barcode": "LB000001"}
        (tmp_path / "0.png").write_bytes(b"\x89PNG nothing more")
        with pytest.raises(DeviceError, match="not a complete picture"):
            await node.grab_image()
        await node.close()
        one = camera(str(tmp_path / "1.png"))
        await one.connect()
        assert (picture(await one.grab_image("a.png")) == second).all()
        await one.close()

    run(body)
    with pytest.raises(NotConnected, match="no picture at"):
        run(lambda: camera(str(tmp_path / "none.jpg")).connect())


def _record(path: Path, frames: list[Any]) -> None:
    height, width = frames[0].shape[:2]
    film = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 30, (width, height))
    for frame in frames:
        film.write(frame)
    film.release()


def test_a_video_gives_a_frame_after_those_that_were_waiting(world: World, tmp_path: Path) -> None:
    """What OpenCV reads from a device it reads from a recording in the same way."""
    world.stock("eye.plate_station", "plate96")
    grey = numpy.full((HEIGHT, WIDTH, 3), 128, numpy.uint8)
    moving = [picture_of(world, ["eye.plate_station"], number) for number in range(3)]
    _record(tmp_path / "good.avi", [grey] * 4 + moving)
    _record(tmp_path / "frozen.avi", [*moving, *[grey] * 9])
    _record(tmp_path / "short.avi", moving)

    async def body(film: str) -> Any:
        node = camera(str(tmp_path / film))
        await node.connect()
        try:
            return await node.read_barcode(), picture(await node.grab_image())
        finally:
            await node.close()

    label, shown = run(lambda: body("good.avi"))
    assert label == {"barcode": "LB000001"}
    assert vision.has_wells(shown)
    with pytest.raises(DeviceError, match="frozen"):
        run(lambda: body("frozen.avi"))
    with pytest.raises(LinkLost, match="gives no picture") as told:
        run(lambda: body("short.avi"))
    assert told.value.effects == "none"


def test_there_is_no_such_camera() -> None:
    for address in (97, "97", "/dev/video97"):
        with pytest.raises(NotConnected, match="cannot be opened"):
            run(lambda address=address: camera(address).connect())  # type: ignore[misc]


def test_a_camera_that_hangs_is_not_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A pipe into which nobody writes: to open it never ends."""
    monkeypatch.setattr(source, "OPEN_S", 0.3)
    pipe = tmp_path / "stream.avi"
    os.mkfifo(pipe)
    with pytest.raises(NotConnected, match="has sent no picture"):
        run(camera(str(pipe)).connect)
    os.close(os.open(pipe, os.O_WRONLY))


# -- what is seen ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "degrees", [2.5, 270, *(pytest.param(turn, marks=pytest.mark.full) for turn in (0, 90, 183, 315))]
)
def test_a_plate_is_seen_however_it_lies(degrees: float, world: World) -> None:
    world.stock("eye.plate_station", "plate96")
    shown = vision.rotate(picture_of(world, ["eye.plate_station"], 7), degrees)
    assert vision.is_occupied(shown) is True
    assert vision.read_label(shown) == "LB000001"


# In pictures 106 and 545 circles are seen between the wells: a seventh of all neighbours are not of the grid.
@pytest.mark.parametrize(
    "chance", [106, 545, *(pytest.param(chance, marks=pytest.mark.full) for chance in range(1000, 1020))]
)
def test_a_plate_without_a_label_is_seen_in_every_picture(chance: int, world: World) -> None:
    (plate,) = world.stock("eye.plate_station", "plate96")
    world.label(plate, "")
    assert vision.is_occupied(picture_of(world, ["eye.plate_station"], chance)) is True


@pytest.mark.full
def test_darker_brighter_and_blurred(world: World) -> None:
    bare = picture_of(world, ["eye.plate_station"], 3)
    (plate,) = world.stock("eye.plate_station", "plate96")
    full = picture_of(world, ["eye.plate_station"], 3)
    for change in (
        lambda p: cv2.convertScaleAbs(p, alpha=0.5),
        lambda p: cv2.convertScaleAbs(p, alpha=1.1, beta=15),
        lambda p: cv2.GaussianBlur(p, (5, 5), 0),
        lambda p: cv2.resize(p, None, fx=2, fy=2),
    ):
        assert vision.is_occupied(change(full)) is True
        assert vision.is_occupied(change(bare)) is False
    # Half the plate in the picture, its label not: neither is told, nor the contrary.
    world.label(plate, "")
    rest = picture_of(world, ["eye.plate_station"], 3)[:, : WIDTH // 5]
    assert vision.is_occupied(rest) is not False


def test_a_clear_plate_over_a_marker_is_not_decided(world: World) -> None:
    bare = picture_of(world, ["eye.plate_station"], 3)
    world.stock("eye.plate_station", "plate96")
    both = numpy.hstack([bare, picture_of(world, ["eye.plate_station"], 3)])
    assert vision.is_occupied(both) is None
    assert vision.is_occupied(cv2.convertScaleAbs(bare, alpha=0.01)) is None


def test_noise_is_nothing() -> None:
    noise = numpy.random.default_rng(1).integers(0, 255, (480, 640, 3), dtype=numpy.uint8)
    assert vision.is_occupied(noise) is None
    assert vision.read_label(noise) == ""


def test_two_labels_in_one_view_are_none(world: World) -> None:
    world.stock("eye.a", "plate96")
    world.stock("eye.b", "plate96")
    assert vision.read_label(picture_of(world, ["eye.a", "eye.b"], 2)) == ""


def test_the_code_of_a_shop_is_read_too() -> None:
    digits = "4006381333931"
    odd = {"4": "LGLLGG"}[digits[0]]
    left = "".join(
        EAN_LEFT[int(d)] if kind == "L" else "".join("10"[int(bit)] for bit in EAN_LEFT[int(d)])[::-1]
        for kind, d in zip(odd, digits[1:7], strict=True)
    )
    right = "".join("".join("10"[int(bit)] for bit in EAN_LEFT[int(d)]) for d in digits[7:])
    bars = numpy.array([255 * (bit == "0") for bit in f"101{left}01010{right}101"], numpy.uint8)
    code = numpy.repeat(numpy.repeat(bars[None], 120, 0), 3, 1)
    page = cv2.copyMakeBorder(code, 120, 120, 160, 160, cv2.BORDER_CONSTANT, value=255)
    assert vision.read_label(cv2.cvtColor(page, cv2.COLOR_GRAY2BGR)) == digits


@pytest.mark.parametrize(
    ("views", "why"),
    [
        ({"wc.shelf": [0.5, 0, 0.4, 1]}, "not a part of a picture"),
        ({"wc.shelf": "left"}, "not a part of a picture"),
        ({}, "has no entry for wc.shelf"),
    ],
)
def test_views_that_are_none(views: Any, why: str) -> None:
    with pytest.raises(DeviceError, match=why):
        read_views(setup_of("eye", None, config={"observes": ["wc.shelf"], "views": views}))


def test_views_as_they_are_told() -> None:
    told = {"plate_station": [0, 0, 0.5, 1], "wc.shelf": [0.5, 0, 1, 1]}
    setup = setup_of("eye", None, config={"observes": ["wc.shelf"], "views": told})
    assert read_views(setup) == {"plate_station": (0, 0, 0.5, 1), "wc.shelf": (0.5, 0, 1, 1)}


def test_simulated_behind_its_wire(world: World) -> None:
    async def body() -> None:
        node = Camera(Setup(name="eye", workcell="rpl", world=world, pace=200, wire=True))
        await node.connect()
        world.stock("eye.plate_station", "plate96")
        assert await node.read_barcode() == {"barcode": "LB000001"}
        assert await node.observe() == {"labware": {"plate_station": 1}}
        await node.close()

    asyncio.run(body())


def test_without_opencv_it_says_what_to_install(eye: CameraOnWire, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cv2", None)
    with pytest.raises(NotConnected, match=r"labos-sdl\[camera\]"):
        run(camera(eye.address).connect)


def test_nothing_needs_opencv_before_there_is_a_picture() -> None:
    code = "import sys, labos.node, labos_drivers.camera; assert not {'cv2', 'numpy'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_camera_is_named(world: World) -> None:
    with pytest.raises(DeviceError, match="names no source"):
        run(at_port(Camera, "eye", "", key="other").connect)
