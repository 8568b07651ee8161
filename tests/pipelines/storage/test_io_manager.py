"""The I/O manager: pointers to folders, partitions, runs, and names of folders."""

import pathlib

import dagster as dg
import pytest

from assets.interfaces import Store
from deltasafe.errors import DataError, SettingsError
from pipelines.storage import artifact_store
from pipelines.storage.io_manager import FolderPointers

PARTS = dg.StaticPartitionsDefinition(["a", "b"])


@pytest.fixture
def home(tmp_path):
    return tmp_path / "home"


def materialize(home, assets, **options):
    return dg.materialize(assets, resources={"io_manager": FolderPointers(home=str(home))}, **options)


def maker(home, version):
    @dg.asset
    def made():
        folder = home / "store" / version
        folder.mkdir(parents=True)
        return folder

    return made


def test_a_consumer_reads_the_latest_folder(home):
    read = []

    @dg.asset
    def used(made):
        read.append(made)

    materialize(home, [maker(home, "one"), used])
    materialize(home, [maker(home, "two")])
    materialize(home, [maker(home, "three").to_source_assets()[0], used])
    assert [path.name for path in read] == ["one", "two"]


def test_a_home_can_be_moved(home, tmp_path):
    materialize(home, [maker(home, "one")])
    moved = home.rename(tmp_path / "elsewhere")
    assert FolderPointers(home=str(moved)).folder(dg.AssetKey("made")) == moved / "store" / "one"


def test_a_checkout_can_be_moved(home, tmp_path, monkeypatch):
    for place in ("here", "there"):
        (tmp_path / place / "hands").mkdir(parents=True)
    pointers = FolderPointers(home=str(home))
    monkeypatch.setattr(artifact_store, "DATASETS", tmp_path / "here")
    pointers.point(dg.AssetKey("made"), tmp_path / "here" / "hands")
    monkeypatch.setattr(artifact_store, "DATASETS", tmp_path / "there")
    assert pointers.folder(dg.AssetKey("made")) == tmp_path / "there" / "hands"


def test_partitions_of_one_or_several_runs_are_read_as_a_dictionary(home):
    @dg.asset(partitions_def=PARTS, backfill_policy=dg.BackfillPolicy.single_run())
    def parts(context: dg.AssetExecutionContext):
        folders = {key: home / "store" / key for key in context.partition_keys}
        for folder in folders.values():
            folder.mkdir(parents=True, exist_ok=True)
        return folders

    read = []

    @dg.asset
    def used(parts):
        read.append({key: path.name for key, path in parts.items()})

    whole = {"dagster/asset_partition_range_start": "a", "dagster/asset_partition_range_end": "b"}
    materialize(home, [parts], tags=whole)
    materialize(home, [parts], partition_key="b")
    materialize(home, [parts.to_source_assets()[0], used])
    assert read == [{"a": "a", "b": "b"}]


def test_a_partition_is_read_as_a_path_by_a_consumer_of_the_same_partition(home):
    @dg.asset(partitions_def=PARTS)
    def part(context: dg.AssetExecutionContext):
        folder = home / "store" / context.partition_key
        folder.mkdir(parents=True)
        return folder

    read = []

    @dg.asset(partitions_def=PARTS)
    def used(part: pathlib.Path):
        read.append(part.name)

    for key in PARTS.get_partition_keys():
        materialize(home, [part, used], partition_key=key)
    assert read == ["a", "b"]


def test_a_missing_or_removed_folder_is_named_with_the_remedy(home):
    pointers = FolderPointers(home=str(home))
    with pytest.raises(DataError, match="materialize made first"):
        pointers.folder(dg.AssetKey("made"))
    materialize(home, [maker(home, "one")])
    (home / "store" / "one").rmdir()
    with pytest.raises(DataError, match="materialize made again"):
        pointers.folder(dg.AssetKey("made"))


def test_a_run_reads_its_own_folders_despite_parallel_runs(home):
    read = []

    @dg.asset
    def made():
        folder = home / "store" / "mine"
        folder.mkdir(parents=True)
        return folder

    @dg.asset(deps=[made])
    def parallel_run():
        materialize(home, [maker(home, "theirs")])

    @dg.asset(deps=[parallel_run])
    def used(made):
        read.append(made.name)

    assert materialize(home, [made, parallel_run, used]).success
    assert read == ["mine"]
    assert FolderPointers(home=str(home)).folder(dg.AssetKey("made")).name == "theirs"


@pytest.mark.parametrize("name", ["", "..", ".", "../../elsewhere", "a/b", "/etc", "a\0b", "a\nb"])
def test_a_folder_name_cannot_lead_out_of_the_store(home, name):
    with pytest.raises(SettingsError, match="cannot be the name of a folder"):
        Store(home, home).folder("logged_scene", name)
    assert Store(home, home).folder("logged_scene", "scene_000-1").is_relative_to(home)
