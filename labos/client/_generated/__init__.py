"""The operations of the API as methods: written by tests/docs/client_code.py."""
