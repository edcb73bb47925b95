"""Certificates of a lab's bus: who may speak there, and under which name.

``_party`` says who there is, ``_signing`` makes certificates, ``_authority`` keeps a folder of them, and
``_credentials`` is what one party has of it, ``_lists`` how lists of members are kept where the authority is
not.
"""

from labos.pki._authority import CA_KEY, Authority
from labos.pki._credentials import KEY, MEMBERS, Credentials, read_members
from labos.pki._lists import NUMBER, ReceivedList
from labos.pki._party import KINDS, PROCESS_NAME, CertificateEntry, Kind, Members, PartyIdentity, folder_name

__all__ = [
    "CA_KEY",
    "KEY",
    "KINDS",
    "MEMBERS",
    "NUMBER",
    "PROCESS_NAME",
    "Authority",
    "CertificateEntry",
    "Credentials",
    "Kind",
    "Members",
    "PartyIdentity",
    "ReceivedList",
    "folder_name",
    "read_members",
]
