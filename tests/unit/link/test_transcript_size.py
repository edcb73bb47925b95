"""A transcript that somebody has forgotten does not fill the disk."""

from __future__ import annotations

from pathlib import Path

import pytest

from labos.link import transcript
from labos.link.transcript import keep_transcript, note, read_transcript


def test_a_transcript_ends_when_it_is_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(transcript, "LARGEST", 100)
    file = tmp_path / "trace.txt"
    with keep_transcript(file):
        for _ in range(50):
            note("arm", ">", b"wherej")
    told = read_transcript(file)
    assert len(told) < 10
    assert (told[-1].mark, told[-1].data) == ("!", b"the transcript is full")
