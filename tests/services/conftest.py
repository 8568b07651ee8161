"""PostgreSQL and an object store for real, started once; whoever lacks them sees what to install."""

import importlib.util
import pathlib
import signal
import sys

import pytest

from tests.services.servers import object_store, postgres, postgres_programs


@pytest.fixture(scope="session", autouse=True)
def servers_end_with_the_tests():
    """Whoever stops the tests stops what they have started."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    yield
    signal.signal(signal.SIGTERM, before)


@pytest.fixture(scope="session")
def database():
    if importlib.util.find_spec("psycopg2") is None:
        pytest.skip("make services-test installs what this needs")
    if postgres_programs() is None:
        pytest.skip("PostgreSQL is not installed (Debian and Ubuntu: apt install postgresql)")
    with postgres() as server:
        yield server


@pytest.fixture(scope="session")
def s3():
    if not pathlib.Path(sys.executable).with_name("weed").is_file() or importlib.util.find_spec("s3fs") is None:
        pytest.skip("make services-test installs what this needs")
    with object_store() as store:
        yield store
