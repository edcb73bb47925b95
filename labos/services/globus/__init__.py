"""Globus services for experiments: computation, flows, file transfer, and a search index.

Each request is carried out by Globus only once, also if an answer is lost or the program is killed: see
`SendingRecord`. The Globus SDK (extra ``globus``) is imported when it is first used.
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
