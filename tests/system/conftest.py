"""The Postgres server of the integration tests serves system tests too."""

from tests.integration.conftest import own_postgres, postgres_server, postgres_url

__all__ = ["own_postgres", "postgres_server", "postgres_url"]
