"""The error for what a device is not asked to do."""

from __future__ import annotations

from labos.errors import DeviceError


def make_refusal(name: str, why: str, remedy: str = "") -> DeviceError:
    """The error of a module for what it does not begin: nothing has moved."""
    return DeviceError(f"{name}: {why}.", effects="none", remedy=remedy)


class Refusing:
    """A device, or a driver, that does not begin everything."""

    name: str

    def make_refusal(self, why: str, remedy: str = "") -> DeviceError:
        """The error for what it does not begin: nothing has moved."""
        return make_refusal(self.name, why, remedy)
