"""Nodes and kernels of other versions: those that fit work together, the others are told what to do."""

from __future__ import annotations

import asyncio
from pathlib import Path

import msgspec
import pytest

from labos.node.protocol import PROTOCOL, AboutReport, SetupReply, explain_skew
from labos.version import VERSION
from tests.integration.bus.contract import until
from tests.support.attacked import ARM, OTHER, Liar, start_attacked


def test_a_node_of_a_later_protocol_is_not_admitted_and_told_why(tmp_path: Path) -> None:
    async def main() -> None:
        async with start_attacked(tmp_path, nodes=(OTHER,)) as (lab, _):
            await Liar.show_itself(lab, protocol=PROTOCOL + 1, labos="7.0")
            await until(lambda: ARM in lab.registry.rejected, 10.0)
            why = lab.registry.rejected[ARM]
            assert why == (
                f"Its node (LabOS 7.0) speaks version {PROTOCOL + 1} of the node protocol; LabOS {VERSION} "
                f"here speaks version {PROTOCOL}. Install the same LabOS on both computers."
            )
            assert lab.module().status == "GONE"

    asyncio.run(main())


def test_a_node_of_another_release_and_the_same_protocol_is_admitted(tmp_path: Path) -> None:
    async def main() -> None:
        async with start_attacked(tmp_path, nodes=(OTHER,)) as (lab, _):
            await Liar.show_itself(lab, labos="7.0")
            await until(lambda: lab.module().status == "IDLE", 10.0)

    asyncio.run(main())


@pytest.mark.parametrize("kind", [AboutReport, SetupReply])
def test_who_says_no_version_speaks_the_first(kind: type[AboutReport | SetupReply]) -> None:
    said = b'{"module": "cell/arm", "journal": "j", "instance": "i", "digest": "d", "description": {}}'
    assert (msgspec.json.decode(said, type=kind).protocol, explain_skew(1, "Its node", "")) == (1, "")
