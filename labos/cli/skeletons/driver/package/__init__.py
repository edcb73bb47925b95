"""NAME for LabOS."""

from PACKAGE.interface import CLASS

__all__ = ["CLASS"]
