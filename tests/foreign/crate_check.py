"""Checks crates with foreign software: ``crate_check.py CACHE CRATE=PROFILE …`` prints a list in JSON.

`roc-validator` checks a crate against a profile and those that it extends. It would fetch the context of
RO-Crate 1.1; so that no network is needed, that is put into its cache first, from `rocrate` 0.13, which ships
it. `rocrate` reads the crate.
"""

from __future__ import annotations

import io
import json
import sys
from importlib.resources import files

import requests_cache
from requests.adapters import HTTPAdapter
from rocrate.rocrate import ROCrate
from rocrate_validator import services
from urllib3 import HTTPResponse

CONTEXT = "https://w3id.org/ro/crate/1.1/context"


class Shipped(HTTPAdapter):
    """Answers with the context that a package ships."""

    def send(self, request, **_):
        shipped = files("rocrate").joinpath("data/ro-crate.jsonld").read_bytes()
        answer = HTTPResponse(
            io.BytesIO(shipped),
            {"Content-Type": "application/ld+json"},
            200,
            preload_content=False,
            request_method="GET",
            request_url=request.url,
        )
        return self.build_response(request, answer)


def fill(cache: str) -> None:
    """What would be fetched, in the cache."""
    with requests_cache.CachedSession(cache, backend="sqlite") as session:
        session.mount("https://", Shipped())
        session.get(CONTEXT)


def findings(crate: str, profile: str, cache: str) -> list[str]:
    """What is required by a profile and not so."""
    settings = {
        "rocrate_uri": crate,
        "profile_identifier": profile,
        "requirement_severity": "REQUIRED",
        "offline": True,
        "cache_path": cache,
    }
    issues = services.validate(settings).get_issues()
    return [f"{issue.check.identifier} {issue.violatingEntity}: {issue.message}" for issue in issues]


def read_crate(crate: str) -> dict[str, object]:
    """What a reader of crates finds in it."""
    read = ROCrate(crate)
    return {
        "name": read.name,
        "main": read.mainEntity.id if read.mainEntity else None,
        "parts": sorted(part.id for part in read.root_dataset["hasPart"] if "File" in part.type),
        "actions": sorted(each.id for each in read.get_entities() if each.type == "CreateAction"),
    }


def main(cache: str, *wanted: str) -> None:
    fill(cache)
    answers = []
    for each in wanted:
        crate, _, profile = each.partition("=")
        answers.append({"wrong": findings(crate, profile, cache), **read_crate(crate)})
    print(json.dumps(answers))


if __name__ == "__main__":
    main(*sys.argv[1:])
