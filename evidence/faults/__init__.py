"""Fault injection, thousands of times: each module is a command, see `docs/reliability.md`."""
