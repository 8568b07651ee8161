"""Addresses in messages and links: without user name and password."""

import re

_CREDENTIALS = re.compile(r"(?<=://)[^/\s]+@")


def masked(text: object) -> str:
    """Remove user name and password from every address in a text."""
    return _CREDENTIALS.sub("", str(text))
