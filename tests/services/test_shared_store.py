"""The shared store on file systems without a server: atomic, verified, and nothing uploaded twice."""

import pickle
import threading

import dagster as dg
import pytest

from deltasafe.errors import DataError, SettingsError
from pipelines.home import DATASETS
from pipelines.resources import StoreResource
from pipelines.storage import shared_store
from pipelines.storage.io_manager import FolderPointers
from pipelines.storage.shared_store import (
    STORE_VARIABLE,
    ObjectError,
    SharedStore,
    StoreAwayError,
    store_from_environment,
)

pytest.importorskip("tenacity", reason="run `make services-test`, which installs it")

KEY = dg.AssetKey("made")


@pytest.fixture(params=["memory", "file"])
def store(request, tmp_path, monkeypatch):
    address = f"memory://{tmp_path.name}-{id(tmp_path)}" if request.param == "memory" else f"file://{tmp_path / 'team'}"
    monkeypatch.setenv(STORE_VARIABLE, address)
    monkeypatch.setattr(shared_store, "_FIRST_WAIT_S", 0.001)
    return store_from_environment()


def folder_of(home, version, files=3):
    """Write a folder whose files contain its version."""
    folder = home / "store" / "made" / version
    (folder / "part" / "empty").mkdir(parents=True)
    for number in range(files):
        (folder / "part" / f"{number}.txt").write_text(f"{version} {number}")
    return folder


def version_in(folder):
    texts = {path.read_text() for path in folder.rglob("*.txt")}
    versions = {text.partition(" ")[0] for text in texts}
    assert len(versions) == 1
    assert len(texts) == 3
    return versions.pop()


def pointers(home):
    return FolderPointers(home=str(home))


def objects(store):
    return sorted(store._files.find(store._root))


def damage(store, data):
    """Replace the bytes of the last blob."""
    blob = [name for name in objects(store) if "/blobs/" in name][-1]
    store._files.pipe_file(blob, data)
    return blob


def test_another_home_reads_all_files_of_the_latest_version(store, tmp_path):
    one, other = tmp_path / "one", tmp_path / "other"
    made = folder_of(one, "first")
    pointers(one).point(KEY, made)
    read = pointers(other).folder(KEY)
    assert read == other / "store" / "made" / "first"
    assert version_in(read) == "first"
    assert (read / "part" / "empty").is_dir()
    pointers(one).point(KEY, folder_of(one, "second"))
    assert version_in(pointers(other).folder(KEY)) == "second"


def test_existing_folders_are_neither_downloaded_nor_uploaded_again(store, tmp_path, monkeypatch):
    one, other = tmp_path / "one", tmp_path / "other"
    pointers(one).point(KEY, folder_of(one, "first"))
    pointers(other).folder(KEY)
    transfers = []
    upload, download = SharedStore._put, SharedStore._download
    monkeypatch.setattr(SharedStore, "_put", lambda *a: (transfers.append(a), upload(*a)))
    monkeypatch.setattr(SharedStore, "_download", lambda *a: (transfers.append(a), download(*a)))
    assert version_in(pointers(one).folder(KEY)) == "first"
    assert version_in(pointers(other).folder(KEY)) == "first"
    pointers(other).point(KEY, other / "store" / "made" / "first")
    assert transfers == []


def test_a_changed_or_removed_folder_is_downloaded_again(store, tmp_path):
    made = folder_of(tmp_path, "first")
    pointers(tmp_path).point(KEY, made)
    (made / "part" / "1.txt").write_text("torn")
    assert version_in(pointers(tmp_path).folder(KEY)) == "first"
    (made / "part" / "1.txt").unlink()
    assert version_in(pointers(tmp_path).folder(KEY)) == "first"


@pytest.mark.parametrize("data", [b"", b"first 9", b"another length altogether"])
def test_a_damaged_object_is_named_and_leaves_no_file(store, tmp_path, data):
    pointers(tmp_path / "one").point(KEY, folder_of(tmp_path / "one", "first"))
    blob = damage(store, data)
    with pytest.raises(ObjectError, match=r"is damaged; remove it, and restore it from a backup") as caught:
        pointers(tmp_path / "other").folder(KEY)
    assert caught.value.address.startswith(store.address)
    assert caught.value.address.endswith(blob.rpartition("/")[2])
    assert not [path for path in (tmp_path / "other").rglob("*") if path.suffix == ".txt"]
    assert str(pickle.loads(pickle.dumps(caught.value))) == str(caught.value)


def test_a_missing_object_and_a_damaged_manifest_are_named(store, tmp_path):
    pointers(tmp_path / "one").point(KEY, folder_of(tmp_path / "one", "first"))
    blob = next(name for name in objects(store) if "/blobs/" in name)
    store._files.rm_file(blob)
    with pytest.raises(ObjectError, match="is missing"):
        pointers(tmp_path / "other").folder(KEY)
    manifest = next(name for name in objects(store) if "/manifests/" in name)
    store._files.pipe_file(manifest, b"{}")
    with pytest.raises(ObjectError, match=r"manifests/.* is damaged"):
        pointers(tmp_path / "other").folder(KEY)
    pointer = next(name for name in objects(store) if "/pointers/" in name)
    store._files.pipe_file(pointer, b"{")
    with pytest.raises(ObjectError, match="is not valid JSON"):
        pointers(tmp_path / "other").folder(KEY)
    with pytest.raises(DataError, match="materialize never first"):
        pointers(tmp_path).folder(dg.AssetKey("never"))


def test_names_outside_the_folder_are_refused(store, tmp_path):
    for name in ("../outside", "/outside"):
        digest = shared_store.digest_of_manifest({"files": {}, "folders": [name]})
        store.write_json(f"manifests/{digest}.json", {"files": {}, "folders": [name]})
        with pytest.raises(DataError, match="outside its folder"):
            store.fetch(digest, tmp_path / "home" / "x")
    for elsewhere in ("../elsewhere", "incoming/hands", "store/../champion.json"):
        store.write_json("pointers/current/made.json", {"folder": elsewhere, "manifest": digest})
        with pytest.raises(ObjectError, match="where nothing is ever stored; materialize made again"):
            pointers(tmp_path / "home").folder(KEY)


def test_a_watched_folder_is_copied_and_not_changed(store, tmp_path):
    watched = tmp_path / "incoming" / "hands"
    watched.mkdir(parents=True)
    (watched / "1.png").write_bytes(b"1")
    pointers(tmp_path).point(KEY, watched)
    (watched / "2.png").write_bytes(b"arrived meanwhile")
    read = pointers(tmp_path).folder(KEY)
    assert read.parent == tmp_path / "inputs"
    assert [path.name for path in read.iterdir()] == ["1.png"]
    assert (watched / "2.png").read_bytes() == b"arrived meanwhile"


class Killed(BaseException):
    """Stands for SIGKILL: `except Exception` does not catch it."""


def test_after_a_kill_at_any_operation_the_old_version_is_read_and_a_retry_succeeds(store, tmp_path, monkeypatch):
    home, reader = tmp_path / "one", tmp_path / "reader"
    pointers(home).point(KEY, folder_of(home, "first"), run_id="a")
    made, done, survived = folder_of(home, "second"), [0], False
    originals = {name: getattr(SharedStore, name) for name in ("_put", "_write")}

    def counting(original, limit):
        def call(*arguments):
            with lock:
                done[0] += 1
                if done[0] > limit:
                    raise Killed
            return original(*arguments)

        return call

    lock = threading.Lock()
    for limit in range(20):
        done[0] = 0
        for name, original in originals.items():
            monkeypatch.setattr(SharedStore, name, counting(original, limit))
        try:
            pointers(home).point(KEY, made, run_id="b")
            survived = True
        except Killed:
            pass
        for name, original in originals.items():
            monkeypatch.setattr(SharedStore, name, original)
        current = version_in(pointers(reader).folder(KEY))
        assert version_in(pointers(reader).folder(KEY, run_id="b")) in (current, "second")
        if survived:
            assert current == "second"
            break
        assert current == "first"
    assert survived
    assert limit >= 4, "at least manifest, name and two pointers"


def test_transient_failures_are_retried_and_permanent_ones_reported(store, tmp_path, monkeypatch):
    failures, calls = [OSError("reset"), TimeoutError(), ConnectionError()], []
    write = type(store._files).cat_file

    def sometimes(self, path, *arguments, **options):
        calls.append(path)
        if failures:
            raise failures.pop()
        return write(self, path, *arguments, **options)

    store.write_json("x.json", 1)
    monkeypatch.setattr(type(store._files), "cat_file", sometimes)
    assert store.read_json("x.json") == 1
    assert len(calls) == 4

    def never(self, path, *arguments, **options):
        calls.append(path)
        raise ConnectionError("no answer")

    calls.clear()
    monkeypatch.setattr(type(store._files), "cat_file", never)
    with pytest.raises(StoreAwayError, match=r"x\.json cannot be reached \(ConnectionError: no answer\)"):
        store.read_json("x.json")
    assert len(calls) == 6

    def refused(self, path, *arguments, **options):
        calls.append(path)
        raise PermissionError("Access Denied")

    calls.clear()
    monkeypatch.setattr(type(store._files), "cat_file", refused)
    with pytest.raises(StoreAwayError, match="accepts the keys"):
        store.read_json("x.json")
    assert len(calls) == 1


def test_packaged_inputs_are_referenced_and_other_folders_copied(store, tmp_path, monkeypatch):
    one, other, mine = tmp_path / "one", tmp_path / "other", tmp_path / "mine"
    pointers(one).point(KEY, DATASETS / "hands" / "test")
    assert not [name for name in objects(store) if "/blobs/" in name]
    assert pointers(other).folder(KEY) == DATASETS / "hands" / "test"
    (mine / "images").mkdir(parents=True)
    (mine / "images" / "a.png").write_bytes(b"a")
    (mine / ".hidden").write_bytes(b"")
    pointers(one).point(KEY, mine)
    (mine / "images" / "a.png").write_bytes(b"changed meanwhile")
    read = pointers(other).folder(KEY)
    assert read.parent == other / "inputs"
    assert [path.read_bytes() for path in read.rglob("*.png")] == [b"a"]
    assert not (read / ".hidden").exists()
    (mine / "link").symlink_to(mine / "images")
    with pytest.raises(DataError, match="link to a folder"):
        pointers(one).point(KEY, mine)


def test_another_version_of_the_packaged_inputs_is_refused(store, tmp_path):
    pointers(tmp_path).point(KEY, DATASETS / "hands" / "test")
    entry = store.read_json("pointers/current/made.json")
    store.write_json("pointers/current/made.json", {**entry, "manifest": "0" * 64})
    with pytest.raises(DataError, match="use the same version"):
        pointers(tmp_path).folder(KEY)


def test_a_member_of_another_machine_is_restored(store, tmp_path):
    one, other = tmp_path / "one", tmp_path / "other"

    def found(home):
        resource = StoreResource(home=str(home), datasets=str(DATASETS))
        return resource.create_resource(dg.build_init_resource_context()).folder("made", "first")

    assert not found(other).exists()
    pointers(one).point(KEY, folder_of(one, "first"))
    assert version_in(found(other)) == "first"
    damage(store, b"")
    assert not found(tmp_path / "third").exists(), "a folder that cannot be downloaded is made again"


def test_an_unsupported_address_is_refused(monkeypatch):
    monkeypatch.setenv(STORE_VARIABLE, "nonsense://x")
    with pytest.raises(SettingsError, match=r"DELTASAFE_STORE=nonsense://x cannot be used .* make team"):
        store_from_environment()
    monkeypatch.delenv(STORE_VARIABLE)
    assert store_from_environment() is None
