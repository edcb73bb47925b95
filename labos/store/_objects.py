"""Large payloads in an object store, such as S3, through fsspec."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from labos.core.canonical import digest
from labos.errors import BadInput, NotFound, StoreUnavailable
from labos.store._blobs import DIGEST, FolderBlobs, check_name, verify_blob

REMEDY = "Check the address (LABOS_BLOBS), the credentials and that the bucket exists."


class ObjectBlobs:
    """Blobs as objects below a URL that fsspec knows (``s3://bucket/lab``); implements
    ``labos.ports.BlobStore``. An object store has complete objects only, and has them on disk when it
    confirms a write. For other stores, the digest shows an incomplete object. Raises BadInput if the URL
    cannot be used.
    """

    def __init__(self, url: str) -> None:
        try:
            from fsspec.core import url_to_fs
        except ImportError:
            raise BadInput(
                f"The blobs at {url} need fsspec.", remedy="Install the extra `s3` of labos-sdl."
            ) from None
        self.url = url.rstrip("/")
        try:
            # Other processes write there too, so an earlier listing may be outdated.
            found = url_to_fs(self.url, use_listings_cache=False, skip_instance_cache=True)
        except (ImportError, ValueError) as error:
            raise BadInput(f"Blobs cannot be stored at {url}: {error}.", remedy=REMEDY) from None
        self._files: Any = found[0]
        self._root = str(found[1]).rstrip("/")

    def put(self, data: bytes) -> str:
        """Store bytes and return their SHA-256. Storing the same bytes again changes nothing, but repairs a
        damaged object. Raises StoreUnavailable."""
        name = digest(data)
        try:
            self._files.pipe_file(self._name_object(name), data)
        except Exception as error:  # each kind of store raises its own errors
            raise self._make_unavailable_error(error) from error
        return name

    def get(self, digest: str) -> bytes:
        """The bytes of a blob. Raises NotFound if there is none, LogDamaged (position 0) if its bytes
        changed, StoreUnavailable if it cannot be read."""
        check_name(digest)
        try:
            data: bytes = self._files.cat_file(self._name_object(digest))
        except FileNotFoundError:
            raise NotFound(f"There is no blob {digest} at {self.url}.", remedy=REMEDY) from None
        except Exception as error:
            raise self._make_unavailable_error(error) from error
        verify_blob(self.url, digest, data)
        return data

    def names(self) -> Iterator[str]:
        """The digests of all blobs. Raises StoreUnavailable."""
        try:
            found = self._files.find(self._root)
        except FileNotFoundError:
            return
        except Exception as error:
            raise self._make_unavailable_error(error) from error
        for path in sorted(str(each) for each in found):
            name = path.rpartition("/")[2]
            if DIGEST.fullmatch(name):
                yield name

    def tidy(self) -> None:
        """An object store needs no cleaning up."""

    def _name_object(self, name: str) -> str:
        return f"{self._root}/{name[:2]}/{name[2:4]}/{name}"

    def _make_unavailable_error(self, error: Exception) -> StoreUnavailable:
        return StoreUnavailable(f"The blobs at {self.url} are not available: {error}.", remedy=REMEDY)


Blobs = FolderBlobs | ObjectBlobs


def open_blobs(where: str | Path) -> Blobs:
    """The blobs in a local folder, or below a URL. Raises BadInput."""
    return ObjectBlobs(where) if isinstance(where, str) and "://" in where else FolderBlobs(where)
