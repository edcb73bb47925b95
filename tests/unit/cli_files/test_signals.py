"""Signals that end a command."""

from __future__ import annotations

import os
import signal

import pytest

from labos.cli._lab import end_in_order


def test_the_first_signal_ends_the_block_and_each_later_one_hurries() -> None:
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    hurried: list[int] = []
    with end_in_order(lambda: hurried.append(1)):
        try:
            with pytest.raises(KeyboardInterrupt):
                os.kill(os.getpid(), signal.SIGINT)
        finally:
            # Nothing catches an exception here, as between a message and the closing.
            os.kill(os.getpid(), signal.SIGINT)
            os.kill(os.getpid(), signal.SIGTERM)
    assert len(hurried) == 2
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before


def test_without_a_hurry_every_signal_interrupts() -> None:
    with end_in_order():
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGTERM):
            with pytest.raises(KeyboardInterrupt):
                os.kill(os.getpid(), number)


def test_a_lab_in_the_background_of_a_script_is_not_ended_by_its_ctrl_c() -> None:
    """A shell ignores Ctrl-C for what it starts with `&`."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    hurried: list[int] = []
    try:
        with end_in_order(lambda: hurried.append(1)):
            os.kill(os.getpid(), signal.SIGINT)
            assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)
    assert hurried == []
