"""A real server that speaks protobuf over TCP, as a process."""

from __future__ import annotations

from pathlib import Path

from tests.foreign.make import ROOT
from tests.support.foreign import ForeignProcess

PROTO = ROOT / "labos" / "adapter" / "tcp_node.proto"


class ProtobufProcess(ForeignProcess):
    """``forgetful``: it keeps no record, and answers an action at its end."""

    says_up = "the server is up"
    forgetful = False

    def command(self) -> list[Path | str]:
        return [self.python, ROOT / "tests" / "foreign" / "protobuf_node.py", str(self.port), PROTO]

    def environment(self) -> dict[str, str]:
        return {"FORGETFUL": "1" if self.forgetful else ""}
