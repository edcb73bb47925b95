"""What Globus does for an experiment: computes, carries flows out, transfers files, and keeps a search index.

What is sent to Globus is sent once, also when an answer is lost or the program is killed: see
`SendingRecord`. The SDK of Globus (extra ``globus``) is imported when it is first needed.
"""

from labos.services.globus._asking import (
    GlobusAccess,
    GlobusError,
    GlobusFailed,
    GlobusRefused,
    GlobusTimes,
    GlobusUnreachable,
)
from labos.services.globus._compute import GlobusEndpoint
from labos.services.globus._flows import GlobusFlow, GlobusRun, run_once
from labos.services.globus._search import GlobusIndex, ingest_once
from labos.services.globus._transfer import GlobusCarrier, GlobusPlace, Moved, transfer_once

__all__ = [
    "GlobusAccess",
    "GlobusCarrier",
    "GlobusEndpoint",
    "GlobusError",
    "GlobusFailed",
    "GlobusFlow",
    "GlobusIndex",
    "GlobusPlace",
    "GlobusRefused",
    "GlobusRun",
    "GlobusTimes",
    "GlobusUnreachable",
    "Moved",
    "ingest_once",
    "run_once",
    "transfer_once",
]
