"""The proof by seeds: small labs on very bad days, thousands of them. See docs/proof.md."""
