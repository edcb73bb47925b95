"""The error for a request that a device or driver declines."""

from __future__ import annotations

from labos.errors import DeviceError


def make_refusal(name: str, why: str, remedy: str = "") -> DeviceError:
    """The error of a module that declines a request: it has begun nothing, and nothing has moved."""
    return DeviceError(f"{name}: {why}.", effects="none", remedy=remedy)


class Refusing:
    """A device or a driver that may decline requests."""

    name: str

    def make_refusal(self, why: str, remedy: str = "") -> DeviceError:
        """The error for a declined request: nothing was begun, and nothing has moved."""
        return make_refusal(self.name, why, remedy)
