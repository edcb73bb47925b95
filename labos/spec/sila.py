"""``sila:`` of a module's config: data that are missing in the feature definitions of a SiLA 2 server.

Properties are named ``Feature.Property``, followed by the elements of the structure if the value is one.
Commands are named ``Feature.Command``.
"""

from __future__ import annotations

from labos.spec.signals import DeviceMapping


class SilaMapping(DeviceMapping):
    """``harmless`` are the identifiers of defined errors after which nothing has moved. ``intermediate``
    names the actions whose intermediate responses are kept. ``reset`` and ``stop`` are commands without
    parameters."""

    harmless: list[str] = []
    intermediate: list[str] = []
    reset: str = ""
    stop: str = ""

    @property
    def properties(self) -> set[str]:
        """All properties that the table names."""
        conditions = [*self.state.busy, *self.state.error, *self.labware.values()]
        names = {*self.resources.values(), *self.observe.values(), self.state.why}
        return {name for name in names | {condition.pv for condition in conditions} if name}
