"""What a connection is told to find out by itself."""

from __future__ import annotations

import socket

import pytest

from labos.adapter._keepalive import choose_timings, keep_alive, make_options


@pytest.mark.parametrize("limit_s", [0.5, 5, 8, 60, 120.0, 3600])
def test_a_dead_computer_is_noticed_in_time(limit_s: float) -> None:
    first, between, probes = choose_timings(limit_s)
    assert min(first, between, probes) >= 1
    assert first + between * probes == max(5, limit_s)


def test_a_connection_takes_what_its_system_has() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server, socket.socket() as wire:
        wire.connect(server.getsockname())
        keep_alive(wire, 120.0)
        options = make_options(120.0)
        assert options[0] == (socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for level, name, value in options:
            assert wire.getsockopt(level, name) == value


def test_what_a_system_has_no_name_for_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("TCP_KEEPIDLE", "TCP_KEEPALIVE", "TCP_KEEPINTVL", "TCP_KEEPCNT"):
        monkeypatch.delattr(socket, name, raising=False)
    assert make_options(120.0) == [(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)]
