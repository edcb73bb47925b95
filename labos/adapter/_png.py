"""Converts raw images to PNG, without an image library."""

from __future__ import annotations

import struct
import zlib

from labos.errors import DeviceError

_CHANNELS = {"mono8": 1, "8UC1": 1, "rgb8": 3, "bgr8": 3, "8UC3": 3, "rgba8": 4, "bgra8": 4}
_COLOUR_TYPE = {1: 0, 3: 2, 4: 6}
"""PNG's numbers for grey, RGB and RGBA."""


def encode_png(raw: bytes, *, width: int, height: int, encoding: str, step: int) -> bytes:
    """An image of ``sensor_msgs/msg/Image`` (8 bits a channel) as a PNG file. Raises DeviceError."""
    channels = _CHANNELS.get(encoding)
    if channels is None or len(raw) < step * height or step < width * channels:
        raise DeviceError(
            f"A picture of {width} × {height} in {encoding!r} with {len(raw)} bytes cannot be read.",
            effects="none",
            remedy=f"Let the camera publish one of {', '.join(_CHANNELS)}.",
        )
    rows = bytearray()
    for y in range(height):
        row = bytearray(raw[y * step : y * step + width * channels])
        if encoding in ("bgr8", "bgra8", "8UC3"):  # OpenCV's order
            row[0::channels], row[2::channels] = row[2::channels], row[0::channels]
        rows += b"\0" + row
    header = struct.pack(">IIBBBBB", width, height, 8, _COLOUR_TYPE[channels], 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(bytes(rows))), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(_encode_chunk(name, data) for name, data in chunks)


def _encode_chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
