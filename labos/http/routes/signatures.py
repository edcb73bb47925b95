"""Electronic signatures for runs, experiments and campaigns."""

from __future__ import annotations

from typing import Any

import msgspec

from labos.http.bodies import RunSignature
from labos.http.method import Method
from labos.http.operation import Call, Operation, list_operations
from labos.http.queries import OfCampaign, OfExperiment, OfRun
from labos.http.signing_runs import list_signatures_under, sign
from labos.services.signatures import Kind, Signature


class Signatures(msgspec.Struct, frozen=True):
    signatures: list[Signature]


_ASKED = {"meaning": "reviewed", "password": "four words of yours", "why": "checked"}
_SIGNATURE = {
    "subject": "R1",
    "kind": "run",
    "run": "R1",
    "by": "ada",
    "meaning": "reviewed",
    "why": "checked",
    "method": "password",
    "at": 1767225600000000000,
    "time": "2026-01-01T00:00:00.000000000Z",
    "position": 214,
    "runs": 0,
    "records": 37,
    "digest": "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08",
    "holds": True,
}
_EXPERIMENT = {**_SIGNATURE, "subject": "E1", "kind": "experiment", "run": "", "runs": 3, "records": 97}
_CAMPAIGN = {**_EXPERIMENT, "subject": "C1", "kind": "campaign"}


def _sign(kind: Kind, example: dict[str, Any]) -> Operation:
    """The operation that signs such a record."""
    return Operation(
        route=f"POST {_make_path(kind)}",
        client=Method(f"sign_{kind}", repeat=True),
        summary=f"Sign {_name_record(kind)} that has ended",
        tag=f"{kind}s",
        needs="viewer",
        secret=True,
        problems=("refused", "not_found", "too_many_tries"),
        example=_ASKED,
        example_answer=example,
    )


def _list(kind: Kind, signatures: str, example: dict[str, Any]) -> Operation:
    """The operation that lists the signatures for such a record; ``signatures`` is the client's method."""
    return Operation(
        route=f"GET {_make_path(kind)}",
        client=Method(signatures, take="signatures"),
        summary=f"List the signatures for {_name_record(kind)}",
        tag=f"{kind}s",
        needs="viewer",
        problems=("not_found",),
        example_answer={"signatures": [example]},
    )


def _make_path(kind: Kind) -> str:
    return f"/{kind}s/{{{kind}}}/signatures"


def _name_record(kind: Kind) -> str:
    return f"the record of {'an' if kind == 'experiment' else 'a'} {kind}"


@_sign("run", _SIGNATURE)
async def sign_run(call: Call, path: OfRun, body: RunSignature) -> Signature:
    """The signature is an event and covers all records of the run. The user has to give the password again,
    however they signed in."""
    return await sign(call, path.run, "run", body)


@_list("run", "signatures", _SIGNATURE)
async def list_signatures(call: Call, path: OfRun) -> Signatures:
    """They are in the order of the log. `holds`: the record is still the one that was signed."""
    return Signatures(await list_signatures_under(call, path.run, "run"))


@_sign("experiment", _EXPERIMENT)
async def sign_experiment(call: Call, path: OfExperiment, body: RunSignature) -> Signature:
    """It works as for a run. The signature covers all records of the experiment and of all its runs."""
    return await sign(call, path.experiment, "experiment", body)


@_list("experiment", "experiment_signatures", _EXPERIMENT)
async def list_experiment_signatures(call: Call, path: OfExperiment) -> Signatures:
    """They are in the order of the log. `holds`: the records are still those that were signed."""
    return Signatures(await list_signatures_under(call, path.experiment, "experiment"))


@_sign("campaign", _CAMPAIGN)
async def sign_campaign(call: Call, path: OfCampaign, body: RunSignature) -> Signature:
    """It works as for a run. The signature covers all records of the campaign and of all its runs."""
    return await sign(call, path.campaign, "campaign", body)


@_list("campaign", "campaign_signatures", _CAMPAIGN)
async def list_campaign_signatures(call: Call, path: OfCampaign) -> Signatures:
    """They are in the order of the log. `holds`: the records are still those that were signed."""
    return Signatures(await list_signatures_under(call, path.campaign, "campaign"))


OPERATIONS = list_operations(globals(), "runs")
