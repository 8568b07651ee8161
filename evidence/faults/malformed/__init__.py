"""Malformed inputs by kind: each module makes sound inputs (a door) and many ways of spoiling them (cases)."""
