"""The Postgres server of the integration tests serves the migrations of golden logs too."""

from tests.integration.conftest import postgres_server, postgres_url

__all__ = ["postgres_server", "postgres_url"]
