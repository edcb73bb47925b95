"""What the process's log says, and where."""

from __future__ import annotations

from collections.abc import Iterator
from io import StringIO

import pytest
import structlog

from labos.telemetry.logs import ENVIRONMENT, configure_logs


@pytest.fixture(autouse=True)
def configuration(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.delenv(ENVIRONMENT, raising=False)
    before = structlog.get_config()
    yield
    structlog.configure(**before)


def test_a_logger_that_was_used_before_follows_a_new_configuration() -> None:
    log, first, second = structlog.get_logger("x"), StringIO(), StringIO()
    configure_logs("warning", first)
    log.warning("one")
    configure_logs("error", second)
    log.warning("two")
    log.error("three")
    assert "one" in first.getvalue()
    assert "two" not in first.getvalue()
    assert "three" in second.getvalue()
    assert "two" not in second.getvalue()
