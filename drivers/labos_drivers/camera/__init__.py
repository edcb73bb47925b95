"""A USB camera that looks at a plate."""

from labos_drivers.camera.interface import Camera

__all__ = ["Camera"]
