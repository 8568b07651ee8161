"""``python -m evidence.faults.digests`` against this process, and that another seed is another digest."""

import pathlib

from evidence.faults.digests import compare, digests_of


def test_another_process_makes_the_same_bytes_and_another_seed_others(tmp_path: pathlib.Path) -> None:
    for name in ("here", "other"):
        (tmp_path / name).mkdir()
    here, other = digests_of(0, tmp_path / "here"), digests_of(1, tmp_path / "other")
    assert {kind: [digest] for kind, digest in here.items()} == compare(0, 1)
    assert set(here) == {"dataset", "member", "plan", "execution"}
    for kind, digest in here.items():
        assert other[kind] != digest, kind
