"""``evidence.faults.digests`` with one other process."""

import pathlib

from evidence.faults.digests import compare, digests_of


def test_same_seed_gives_same_bytes_in_another_process_and_other_seed_does_not(tmp_path: pathlib.Path) -> None:
    for name in ("same", "other"):
        (tmp_path / name).mkdir()
    same, other = digests_of(0, tmp_path / "same"), digests_of(1, tmp_path / "other")
    assert {name: [digest] for name, digest in same.items()} == compare(0, 1)
    assert set(same) == {"dataset", "member", "plan", "execution"}
    for name, digest in same.items():
        assert other[name] != digest, name
