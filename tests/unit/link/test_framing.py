"""Where messages end, and how bytes are written down."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labos.errors import BadInput
from labos.link import BadFrame, Checked, Framing, LengthPrefixed, Terminated, read_transcript
from labos.link.transcript import escape, unescape


def sum_of(message: bytes) -> bytes:
    return b"%02X" % (sum(message) % 256)


LINES = Terminated(b"\r\n")
STARS = Terminated(b"!", start=b"*")
PLAIN = st.binary(max_size=40).filter(lambda data: not set(data) & set(b"\r\n*!"))


@pytest.mark.parametrize("framing", [LINES, STARS, LengthPrefixed(2), Checked(STARS, sum_of, 2)])
@given(messages=st.lists(PLAIN, max_size=5), cut=st.integers(1, 7))
def test_what_is_packed_is_taken_out_whatever_the_pieces(
    framing: Framing, messages: list[bytes], cut: int
) -> None:
    stream = b"".join(map(framing.pack, messages))
    buffer, found = bytearray(), []
    for at in range(0, len(stream), cut):
        buffer += stream[at : at + cut]
        while (message := framing.take(buffer)) is not None:
            found.append(message)
    assert found == messages
    assert not buffer


def test_a_message_after_noise_is_still_found() -> None:
    buffer = bytearray(b"\r\x00\x13*T01!*Y00!")
    with pytest.raises(BadFrame, match="does not have the start"):
        STARS.take(buffer)
    assert [STARS.take(buffer), STARS.take(buffer), STARS.take(buffer)] == [b"T01", b"Y00", None]


def test_the_rest_of_a_message_is_noise() -> None:
    buffer = bytearray(b"88,000GD!\r*Y00!")
    with pytest.raises(BadFrame):
        STARS.take(buffer)
    assert STARS.take(buffer) == b"Y00"


def test_a_stream_without_ends_is_given_up() -> None:
    buffer = bytearray(b"x" * 101)
    with pytest.raises(BadFrame, match="without a terminator"):
        Terminated(limit=100).take(buffer)
    assert not buffer


def test_a_length_beyond_reason_is_noise() -> None:
    with pytest.raises(BadFrame, match="length field says"):
        LengthPrefixed(4, limit=100).take(bytearray(b"\xff\xff\xff\xffabc"))


@given(st.binary(max_size=60))
def test_bytes_are_written_as_text_and_read_again(data: bytes) -> None:
    text = escape(data)
    assert text.isprintable()
    assert unescape(text) == data


def test_a_damaged_transcript_names_its_line(tmp_path: Path) -> None:
    path = tmp_path / "talk.txt"
    path.write_text("# labos transcript 1\n0.1\tsealer\t>\t*GS\n0.2\tsealer\t?\tx\n")
    with pytest.raises(BadInput, match=r"talk.txt:3: .*'\?'"):
        read_transcript(path)
