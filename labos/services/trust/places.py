"""Places outside the database where checkpoints are kept: folders, and HTTP servers that take PUT."""

from __future__ import annotations

from pathlib import Path

import httpx

from labos.errors import BadInput, SystemFailed
from labos.private import make_folder, replace_file

TIMEOUT_S = 10.0


class Folder:
    def __init__(self, path: Path) -> None:
        self.path = path

    def __str__(self) -> str:
        return str(self.path)

    def put(self, name: str, data: bytes) -> None:
        """Store a small file under a name, as durably as the folder can guarantee. Raises SystemFailed."""
        target = self.path / name
        try:
            make_folder(self.path)
            replace_file(target, data)
        except OSError as error:
            raise SystemFailed(
                f"{target} cannot be written: {error.strerror or error}.",
                remedy="Check the folder and its rights.",
            ) from None


class HttpPlace:
    """A folder behind ``PUT url/name``, as WebDAV and many object stores accept it."""

    def __init__(self, url: str) -> None:
        self.url = url.rstrip("/")

    def __str__(self) -> str:
        return self.url

    def put(self, name: str, data: bytes) -> None:
        target = f"{self.url}/{name}"
        try:
            answer = httpx.put(
                target, content=data, headers={"content-type": "text/plain; charset=utf-8"}, timeout=TIMEOUT_S
            )
        except httpx.HTTPError as error:
            raise SystemFailed(f"{target} cannot be reached: {error}.", remedy="Is its server up?") from None
        if not answer.is_success:
            raise SystemFailed(
                f"{target} was refused: the server answers {answer.status_code}.",
                remedy="It has to allow PUT from here.",
            )


def place_of(text: str) -> Folder | HttpPlace:
    """A folder, or an ``http(s)`` URL. Raises BadInput for another kind of URL."""
    if text.startswith(("http://", "https://")):
        return HttpPlace(text)
    if "://" in text:
        raise BadInput(
            f"Checkpoints cannot be stored at {text}.", remedy="Name a folder, or a URL with http(s)."
        )
    return Folder(Path(text))


def name_checkpoint(size: int) -> str:
    """The name of the checkpoint of a size; names sort by size."""
    return f"{size:012d}.note"


def find_newest(folder: Path) -> Path | None:
    """The checkpoint of the largest size in a folder."""
    return max(folder.glob("[0-9]" * 12 + ".note"), default=None)
