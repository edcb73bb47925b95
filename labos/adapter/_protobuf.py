"""The messages of ``tcp_node.proto``, and their frames.

The schema is read from ``tcp_node.binpb``, which protoc made from the .proto file. Therefore there is no
generated code that would have to fit the installed protobuf package.
"""

from __future__ import annotations

import asyncio
import functools
from pathlib import Path
from typing import Any

from labos.adapter._channels import report_missing_package

SCHEMA = Path(__file__).with_name("tcp_node.binpb")
LARGEST = 64 * 1024 * 1024
"""Bytes of a message."""


@functools.cache
def make_schema() -> dict[str, Any]:
    """The classes of the messages, by name. Raises DeviceError."""
    try:
        from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
    except ImportError as error:
        raise report_missing_package(error, "protobuf") from error
    files = descriptor_pb2.FileDescriptorSet.FromString(SCHEMA.read_bytes())
    pool = descriptor_pool.DescriptorPool()
    for file in files.file:
        pool.Add(file)
    (file,) = files.file
    names = [message.name for message in file.message_type]
    found = {name: pool.FindMessageTypeByName(f"{file.package}.{name}") for name in names}
    return {name: message_factory.GetMessageClass(descriptor) for name, descriptor in found.items()}


def frame_message(message: Any) -> bytes:
    """A message in the form on the wire: its length as a varint, then its bytes."""
    data: bytes = message.SerializeToString()
    length, head = len(data), bytearray()
    while length > 0x7F:
        head.append(length & 0x7F | 0x80)
        length >>= 7
    head.append(length)
    return bytes(head) + data


async def read_message(reader: asyncio.StreamReader, kind: Any) -> Any:
    """Read a message. Raises OSError or EOFError if the connection ends before the message, ValueError if it
    is not a message."""
    length = shift = 0
    while True:
        (byte,) = await reader.readexactly(1)
        length |= (byte & 0x7F) << shift
        if byte < 0x80:
            break
        shift += 7
        if shift > 28:
            raise ValueError("the message does not start with a length")
    if length > LARGEST:
        raise ValueError(f"a message of {length} bytes is too long")
    data = await reader.readexactly(length)
    try:
        return kind.FromString(data)
    except Exception as error:  # DecodeError, of whatever implementation of protobuf
        raise ValueError(f"the message is not a {kind.DESCRIPTOR.name}") from error
