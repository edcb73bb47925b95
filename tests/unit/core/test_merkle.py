"""The Merkle tree of RFC 6962: known roots, and every proof of small trees."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labos.core.merkle import (
    EMPTY_ROOT,
    Edge,
    Tree,
    compute_root,
    hash_leaf,
    is_consistent,
    is_included,
    list_consistency_ranges,
    list_inclusion_ranges,
    make_growth_proof,
    make_proof,
)

LEAVES = ["", "00", "10", "2021", "3031", "40414243", "5051525354555657", "606162636465666768696a6b6c6d6e6f"]
ROOTS = {
    1: "6e340b9cffb37a989ca544e6bb780a2c78901d3fb33738768511a30617afa01d",
    2: "fac54203e7cc696cf0dfcb42c92a1d9dbaf70ad9e621f4bd8d98662f00e3c125",
    3: "aeb6bcfe274b70a14fb067a5e5578264db0fa9b51af5e0ba159158f329e06e77",
    8: "5dc9da79a70659a9ad559cb701ded9a2ab9d823aad2f4960cfe370eff4604328",
}
"""Of the tests of Certificate Transparency."""


def tree_of(size: int) -> Tree:
    return Tree(hash_leaf(b"%d" % at) for at in range(size))


def edge_of(size: int) -> Edge:
    edge = Edge()
    for at in range(size):
        edge.add(hash_leaf(b"%d" % at))
    return edge


@pytest.mark.parametrize("size", ROOTS)
def test_roots_are_those_of_certificate_transparency(size: int) -> None:
    leaves = [hash_leaf(bytes.fromhex(each)) for each in LEAVES[:size]]
    assert compute_root(leaves).hex() == Tree(leaves).compute_root().hex() == ROOTS[size]


def test_an_empty_tree_has_a_root() -> None:
    assert compute_root([]) == Tree([]).compute_root() == Edge().compute_root() == EMPTY_ROOT


@pytest.mark.parametrize("size", range(1, 34))
def test_each_leaf_is_proven_and_no_other(size: int) -> None:
    tree = tree_of(size)
    for at in range(size):
        proof = make_proof(list_inclusion_ranges(at, size), tree.hash_of)
        leaf = hash_leaf(b"%d" % at)
        assert is_included(leaf, at, size, tree.compute_root(), proof)
        assert not is_included(hash_leaf(b"x"), at, size, tree.compute_root(), proof)
        assert not is_included(leaf, at, size, tree.compute_root(), [*proof, leaf])
        if size > 1:
            assert not is_included(leaf, (at + 1) % size, size, tree.compute_root(), proof)
            assert not is_included(leaf, at, size, tree.compute_root(), proof[:-1])


@pytest.mark.parametrize("size", range(1, 34))
def test_each_smaller_tree_is_proven_and_no_other(size: int) -> None:
    tree = tree_of(size)
    for old in range(size + 1):
        proof = make_proof(list_consistency_ranges(old, size), tree.hash_of)
        assert is_consistent(old, tree.compute_root(old), size, tree.compute_root(), proof)
        if 0 < old < size:
            assert not is_consistent(old, hash_leaf(b"x"), size, tree.compute_root(), proof)
            assert not is_consistent(old, tree.compute_root(old), size, hash_leaf(b"x"), proof)
            assert not is_consistent(old, tree.compute_root(old), size, tree.compute_root(), proof[:-1])
            assert (
                make_growth_proof(edge_of(old), [hash_leaf(b"%d" % at) for at in range(old, size)]) == proof
            )


@given(st.integers(1, 700), st.integers(0, 699), st.integers(0, 300))
def test_a_flipped_bit_of_a_proof_is_noticed(size: int, leaf: int, flip: int) -> None:
    at = leaf % size
    tree = tree_of(size)
    proof = make_proof(list_inclusion_ranges(at, size), tree.hash_of)
    if proof:
        number = flip % len(proof)
        proof[number] = bytes([proof[number][0] ^ 1, *proof[number][1:]])
        assert not is_included(hash_leaf(b"%d" % at), at, size, tree.compute_root(), proof)


def test_what_is_not_in_the_tree_has_no_proof() -> None:
    assert not is_included(b"", -1, 3, b"", [])
    assert not is_included(b"", 3, 3, b"", [])
    assert not is_consistent(4, b"", 3, b"", [])
    with pytest.raises(ValueError, match="no leaf 3"):
        list_inclusion_ranges(3, 3)
    with pytest.raises(ValueError, match="does not begin"):
        list_consistency_ranges(4, 3)
    with pytest.raises(ValueError, match="no such right edge"):
        Edge(3, [bytes(32)])
