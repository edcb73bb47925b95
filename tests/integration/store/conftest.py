"""The event store on both databases."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from labos.store import SqlEventStore, open_store

BACKENDS = [
    pytest.param("sqlite", id="sqlite"),
    pytest.param("postgres", id="postgres", marks=pytest.mark.postgres),
]


@pytest.fixture(params=BACKENDS)
def store_url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """An empty database of this test's own."""
    if request.param == "sqlite":
        return f"sqlite:///{tmp_path / 'lab.db'}"
    url: str = request.getfixturevalue("postgres_url")
    return url


@pytest.fixture
def opened(tmp_path: Path) -> Iterator[Callable[..., SqlEventStore]]:
    """``open_store`` whose stores are closed at the test's end; the test's folder is the lab's."""
    stores: list[SqlEventStore] = []

    def open_(url: str, **options: Any) -> SqlEventStore:
        store = open_store(url, **{"home": tmp_path, **options})
        stores.append(store)
        return store

    yield open_
    for store in stores:
        store.close()


@pytest.fixture
def store(store_url: str, opened: Callable[..., SqlEventStore]) -> SqlEventStore:
    """An open store on an empty log."""
    return opened(store_url)
