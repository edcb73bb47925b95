"""System tests are slow but for a few; the Postgres server of the integration tests serves them too."""

import pytest

from tests.integration.conftest import own_postgres, postgres_server, postgres_url

__all__ = ["own_postgres", "postgres_server", "postgres_url"]


def pytest_itemcollected(item: pytest.Item) -> None:
    """Each starts labs in processes: they run in the gate, after the others."""
    if not any(item.get_closest_marker(name) for name in ("smoke", "full")):
        item.add_marker(pytest.mark.slow)
