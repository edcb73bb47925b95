"""Certificates of a lab's bus: they define who may use it, and under which name. ``_party`` defines the kinds
of parties, ``_signing`` makes certificates, ``_authority`` manages a folder of them, ``_credentials`` is the
folder of one party, and ``_lists`` manages lists of members on computers without the authority.
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
