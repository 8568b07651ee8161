"""Every dialect of a list of SHA-256 digests gives the same digests by path."""

import hashlib
import pathlib
import shutil
import subprocess
import unicodedata

import pytest

from deltasafe.errors import DataError
from deltasafe.io.checksum_list import read_registry

NAMES = ("images/a.jpg", "images/b (1).png", "masks/hände.png")
DIGESTS = {unicodedata.normalize("NFC", name): hashlib.sha256(name.encode()).hexdigest() for name in NAMES}


def written(form: str) -> str:
    return "".join(form.format(digest=digest, name=name, upper=digest.upper()) for name, digest in DIGESTS.items())


DIALECTS = {
    "text": written("{digest}  {name}\n").encode(),
    "binary": written("{digest} *{name}\n").encode(),
    "upper case": written("{upper}  {name}\n").encode(),
    "from find": written("{digest}  ./{name}\n").encode(),
    "tagged": written("SHA256 ({name}) = {digest}\n").encode(),
    "openssl": written("SHA2-256({name})= {digest}\n").encode(),
    "windows": b"\xef\xbb\xbf" + written("{digest} *{name}\r\n").encode(),
    "powershell": ("\ufeff" + written("{digest}  {name}\r\n")).encode("utf-16-le"),
    "blank lines": b"\n" + written("{digest}  {name}\n\n").encode() + b"\n",
    "decomposed names": unicodedata.normalize("NFD", written("{digest}  {name}\n")).encode(),
}


@pytest.mark.parametrize("dialect", DIALECTS)
def test_dialects_are_read(tmp_path: pathlib.Path, dialect: str) -> None:
    (tmp_path / "list.sha256").write_bytes(DIALECTS[dialect])
    assert read_registry(tmp_path / "list.sha256") == DIGESTS


@pytest.mark.parametrize("options", [[], ["--binary"], ["--tag"]])
def test_lists_of_sha256sum_itself_are_read(tmp_path: pathlib.Path, options: list[str]) -> None:
    if shutil.which("sha256sum") is None:
        pytest.skip("this machine has no sha256sum")
    names = ["a b.jpg", "back\\slash.jpg", "two\nlines.jpg", "hände.png"]
    for name in names:
        (tmp_path / name).write_text(name)
    listed = subprocess.run(["sha256sum", *options, *names], cwd=tmp_path, capture_output=True, check=True).stdout
    (tmp_path / "list").write_bytes(listed)
    assert read_registry(tmp_path / "list") == {name: hashlib.sha256(name.encode()).hexdigest() for name in names}


def test_lines_that_are_no_digest_are_refused(tmp_path: pathlib.Path) -> None:
    path, line = tmp_path / "list", f"{'a' * 64}  x.jpg\n"
    cases = {
        f"{line}abc  y.jpg\n": r"line 2 is 'abc  y\.jpg', not a SHA-256",
        f"{'a' * 64}\n": "line 1 is",
        f"{line}{'b' * 64}  ./x.jpg\n": "line 2 has another digest for 'x.jpg'",
    }
    for text, message in cases.items():
        path.write_text(text)
        with pytest.raises(DataError, match=message):
            read_registry(path)
    path.write_bytes(b"\xff\x00\xfe")
    with pytest.raises(DataError, match=r"cannot be read .* names in UTF-8"):
        read_registry(path)
