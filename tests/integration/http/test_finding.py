"""The process that answers questions to the search index, and what becomes of it when the lab is closed."""

from __future__ import annotations

import asyncio
import gc
from pathlib import Path

import pytest

from labos.audit.find import SearchQuery
from labos.errors import Refused
from labos.http.finding import Finder
from tests.integration.bus.contract import until


@pytest.mark.slow
def test_a_lab_that_is_closed_leaves_no_search_behind(tmp_path: Path) -> None:
    """Neither the process of a question under way, nor one that a later question starts, nor their pipes."""

    async def body() -> None:
        finder = Finder(f"sqlite:///{tmp_path / 'labos.db'}", tmp_path / "blobs", tmp_path)
        asked = asyncio.create_task(finder.find(SearchQuery()))
        await until(lambda: finder._process is not None, 30.0)
        process = finder._process
        assert process is not None
        finder.close()
        with pytest.raises(Refused):
            await asked
        with pytest.raises(Refused, match="is closing"):
            await finder.find(SearchQuery())
        await finder.wait_closed()
        assert process.returncode is not None
        assert finder._process is None

    asyncio.run(body())
    gc.collect()  # what was left open says so when it is collected
