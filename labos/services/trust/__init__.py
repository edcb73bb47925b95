"""Proofs that are valid outside the lab: keys, signed checkpoints, witnesses, time stamps, bundles of a run.

The formats are public, so that others can check them without LabOS: C2SP ``signed-note``,
``tlog-checkpoint``, ``tlog-cosignature`` and ``tlog-witness``, the Merkle tree of RFC 6962, RFC 3161.
"""
