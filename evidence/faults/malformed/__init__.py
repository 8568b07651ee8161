"""Malformed inputs, one module per kind: valid inputs and the corruptions of them."""
