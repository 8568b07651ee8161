"""A PostgreSQL server and an object store, started once; without them, tests are skipped with instructions."""

import importlib.util
import pathlib
import signal
import sys

import pytest

from tests.services.servers import object_store, postgres, postgres_programs


@pytest.fixture(scope="session", autouse=True)
def servers_end_with_the_tests():
    """Turn SIGTERM into an exception, so that fixtures stop their servers."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    yield
    signal.signal(signal.SIGTERM, before)


@pytest.fixture(scope="session")
def database():
    if importlib.util.find_spec("psycopg2") is None:
        pytest.skip("run `make services-test`, which installs the requirements")
    if postgres_programs() is None:
        pytest.skip("PostgreSQL is not installed (Debian and Ubuntu: apt install postgresql)")
    with postgres() as server:
        yield server


@pytest.fixture(scope="session")
def s3():
    if not pathlib.Path(sys.executable).with_name("weed").is_file() or importlib.util.find_spec("s3fs") is None:
        pytest.skip("run `make services-test`, which installs the requirements")
    with object_store() as store:
        yield store
