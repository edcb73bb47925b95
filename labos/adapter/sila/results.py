"""Converts the responses of a command to the result of an action."""

from __future__ import annotations

import json
from typing import Any

from labos.node.files import Attachment


def result_with_files(responses: dict[str, Any]) -> Any:
    """A result: values by the names of the responses, with references for files."""
    files = {name: Attachment(name, value) for name, value in responses.items() if isinstance(value, bytes)}
    plain = {name: value for name, value in responses.items() if name not in files}
    return with_files(plain or None, files) if files else plain or None


def with_files(result: Any, files: dict[str, Attachment]) -> dict[str, Any]:
    """A result with more files."""
    full = dict(result) if isinstance(result, dict) else {}
    return {**full, "files": {**full.get("files", {}), **files}}


def as_lines(responses: list[dict[str, Any]]) -> Attachment:
    """Values as lines of JSON."""
    lines = [json.dumps(values, default=lambda value: value.hex()) + "\n" for values in responses]
    return Attachment("intermediate.jsonl", "".join(lines).encode())
