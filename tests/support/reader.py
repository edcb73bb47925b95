"""A plate reader that measures, as the foreign nodes of WEI's TCP and ZeroMQ protocols have it."""

from __future__ import annotations

from pathlib import Path

from labos.core.model import ActionSpec, Arg, Description
from tests.foreign.make import ROOT
from tests.support.foreign import ForeignProcess

TIME = Arg(name="time_s", type="float", required=False, default=0.0)


def describe_reader(driver: str) -> Description:
    """What a lab would write down of it."""
    measure = ActionSpec(name="measure", args=(Arg(name="assay", type="str"), TIME), duration_s=0.1)
    return Description(driver=driver, version="", description="", actions=(measure,))


class ReaderProcess(ForeignProcess):
    """Reached by the protocol that its kind names: ``tcp`` or ``zmq``."""

    says_up = "the server is up"

    def command(self) -> list[Path | str]:
        return [self.python, ROOT / "tests" / "foreign" / f"{self.kind}_node.py", str(self.port)]

    def list_measured(self) -> list[str]:
        """Every measurement that was begun."""
        return [told["assay"] for told in self.truth("measure")]
