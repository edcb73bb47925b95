"""The kernel as operations see it: in this process, in another one whose log is followed here, or as it was
before a repeated request."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

from labos.runtime.followed import FollowedKernel
from labos.runtime.kernel import Kernel

if TYPE_CHECKING:
    from labos.http.recorded import RecordedKernel

LabKernel: TypeAlias = "Kernel | FollowedKernel | RecordedKernel"
