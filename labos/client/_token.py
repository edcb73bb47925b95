"""What a program shows to the lab, where it is kept, and whose certificate is believed."""

from __future__ import annotations

import os
import ssl
import stat
from pathlib import Path

import msgspec

from labos.errors import BadInput
from labos.private import create_file, make_folder
from labos.settings import CA, HOME_KEY, TOKEN, TOKEN_FILE, last_kernel


def tokens_file() -> Path:
    """Where `labos login` keeps tokens: one for each lab."""
    folder = os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config"
    return Path(folder) / "labos" / "tokens.json"


def find_token(url: str, home: Path | None = None) -> str:
    """What to show to the lab at an address: LABOS_TOKEN, else what is in the file that LABOS_TOKEN_FILE
    names, else what `labos login` has kept for it, else the key in the lab's folder. Empty if there is
    nothing. Raises BadInput for a file that others can read."""
    if token := os.environ.get(TOKEN, "").strip():
        return token
    if named := os.environ.get(TOKEN_FILE, ""):
        return _private_text(Path(named)).strip()
    kept = find_kept_token(place_of(url, home))
    if kept or home is None:
        return kept
    key = home / HOME_KEY
    return _private_text(key).strip() if key.is_file() else ""


def place_of(url: str, home: Path | None) -> str:
    """How a lab is called in the file of tokens: by its folder, whose lab may change its port, else by its
    address."""
    return str(home) if home is not None else url


def find_kept_token(place: str) -> str:
    """What `labos login` has kept for a lab; empty if nothing."""
    return _read_kept().get(place, "")


def keep_token(place: str, token: str) -> None:
    """Keep a token for a lab; an empty one forgets it."""
    kept = {**_read_kept(), place: token}
    if not token:
        kept.pop(place, None)
    file = tokens_file()
    make_folder(file.parent)
    fresh = file.with_name(f".{file.name}.{os.getpid()}")
    with create_file(fresh) as opened:
        opened.write(msgspec.json.format(msgspec.json.encode(kept)) + b"\n")
    os.replace(fresh, file)


def _read_kept() -> dict[str, str]:
    file = tokens_file()
    if not file.is_file():
        return {}
    try:
        return msgspec.json.decode(_private_text(file), type=dict[str, str])
    except msgspec.MsgspecError:
        raise BadInput(
            f"The file {file} does not hold tokens.",
            remedy="Remove it, and sign in again with `labos login`.",
        ) from None


def _private_text(file: Path) -> str:
    """A file that only its owner can read. Raises BadInput."""
    try:
        with file.open(encoding="utf-8") as opened:
            mode = os.fstat(opened.fileno()).st_mode
            if os.name != "nt" and stat.S_IMODE(mode) & 0o077:
                raise BadInput(
                    f"Others than its owner can read the file {file}, which holds a token.",
                    remedy=f"Run: chmod 600 {file}. If others use this computer, revoke the token too.",
                )
            return opened.read(100_000)
    except FileNotFoundError:
        raise BadInput(f"There is no file {file}.", remedy=f"Correct {TOKEN_FILE}.") from None


def find_trusted(home: Path | None) -> ssl.SSLContext | None:
    """Which certificates are believed: those of the authority whose file LABOS_CA names; of a lab in a folder
    of this computer, the one that it shows by its own note. None for those that everybody believes."""
    if named := os.environ.get(CA, ""):
        try:
            return ssl.create_default_context(cafile=named)
        except (OSError, ssl.SSLError) as error:
            raise BadInput(
                f"The file {named} holds no certificate ({error}).", remedy=f"Correct {CA}: a PEM file."
            ) from None
    known = last_kernel(home) if home is not None else None
    if known is None or not known.certificate:
        return None
    context = ssl.create_default_context(cafile=known.certificate)
    # Exactly this certificate, by whatever name the lab is asked: it stands in the lab's own folder.
    context.verify_flags |= ssl.VERIFY_X509_PARTIAL_CHAIN
    context.check_hostname = False
    return context
