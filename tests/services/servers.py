"""A PostgreSQL server and an S3-compatible object store on loopback, in temporary folders."""

import contextlib
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import time

from tests.loopback import answers, free_ports

PASSWORD = "not-to-be-found-anywhere"
USER = "deltasafe"
KEY, SECRET = "team-key", "secret-not-to-be-found"


def postgres_programs():
    """Return the folder of initdb and pg_ctl; None if PostgreSQL is not installed."""
    found = shutil.which("initdb")
    folders = [pathlib.Path(found).parent] if found else sorted(pathlib.Path("/usr/lib/postgresql").glob("*/bin"))
    return next((folder for folder in reversed(folders) if (folder / "initdb").is_file()), None)


class Postgres:
    """A temporary PostgreSQL cluster."""

    def __init__(self, port):
        self.port = port

    def database(self, name):
        """Create an empty database; return its address."""
        import psycopg2

        address = f"postgresql://{USER}:{PASSWORD}@127.0.0.1:{self.port}/"
        with contextlib.closing(psycopg2.connect(address + "postgres")) as connection:
            connection.autocommit = True
            connection.cursor().execute(f'create database "{name}"')
        return f"postgresql+psycopg2://{USER}:{PASSWORD}@127.0.0.1:{self.port}/{name}"


@contextlib.contextmanager
def postgres():
    """Run the server inside a `with` block."""
    programs, (port,) = postgres_programs(), free_ports(1)
    folder = pathlib.Path(tempfile.mkdtemp(prefix="deltasafe-postgres-"))
    (folder / "password").write_text(PASSWORD)
    # initdb and pg_ctl refuse to run as root
    root = os.geteuid() == 0
    who = ["runuser", "-u", "postgres", "--"] if root else []
    if root:
        for path in (folder, folder / "password"):
            shutil.chown(path, "postgres")

    def run(program, *arguments):
        command = [*who, str(programs / program), "-D", str(folder / "data"), *arguments]
        finished = subprocess.run(
            command, cwd="/", stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False
        )
        assert finished.returncode == 0, finished.stdout

    try:
        run("initdb", "-U", USER, "--auth=scram-sha-256", f"--pwfile={folder / 'password'}", "--no-sync")
        options = f"-c listen_addresses=127.0.0.1 -c port={port} -c unix_socket_directories={folder} -c fsync=off"
        run("pg_ctl", "start", "-w", "-l", str(folder / "log"), "-o", options)
        try:
            yield Postgres(port)
        finally:
            run("pg_ctl", "stop", "-w", "-m", "immediate")
    finally:
        shutil.rmtree(folder, ignore_errors=True)


class ObjectStore:
    """SeaweedFS in one process. It can be stopped and started again with the same data."""

    def __init__(self, folder):
        self.folder = folder
        self.ports = free_ports(8)
        self.endpoint = f"http://127.0.0.1:{self.ports[0]}"
        self.environment = {
            "AWS_ENDPOINT_URL": self.endpoint,
            "AWS_ACCESS_KEY_ID": KEY,
            "AWS_SECRET_ACCESS_KEY": SECRET,
            "AWS_DEFAULT_REGION": "us-east-1",
        }
        self.process = None

    def start(self):
        """Start it on loopback without telemetry, and wait until it answers."""
        s3, s3_grpc, master, master_grpc, volume, volume_grpc, filer, filer_grpc = self.ports
        options = {
            "dir": self.folder / "data",
            "ip": "127.0.0.1",
            "ip.bind": "127.0.0.1",
            "master.telemetry": "false",
            "master.port": master,
            "master.port.grpc": master_grpc,
            "master.volumeSizeLimitMB": 64,
            "volume.port": volume,
            "volume.port.grpc": volume_grpc,
            "volume.max": 0,
            "filer": "true",
            "filer.port": filer,
            "filer.port.grpc": filer_grpc,
            "s3": "true",
            "s3.port": s3,
            "s3.port.grpc": s3_grpc,
            "s3.port.iceberg": 0,
            "s3.port.lance": 0,
        }
        (self.folder / "data").mkdir(exist_ok=True)
        weed = pathlib.Path(sys.executable).with_name("weed")
        command = [str(weed), "-logtostderr=true", "server", *(f"-{name}={value}" for name, value in options.items())]
        with (self.folder / "log").open("a") as log:
            environment = {**os.environ, **self.environment}  # with the keys of the administrator
            self.process = subprocess.Popen(command, cwd=self.folder, env=environment, stdout=log, stderr=log)
        while not answers(f"{self.endpoint}/healthz"):
            assert self.process.poll() is None, (self.folder / "log").read_text()[-4000:]
            time.sleep(0.1)

    def stop(self):
        """Kill it."""
        self.process.kill()
        self.process.wait()


@contextlib.contextmanager
def object_store():
    """Run the server inside a `with` block."""
    with tempfile.TemporaryDirectory(prefix="deltasafe-s3-", ignore_cleanup_errors=True) as name:
        store = ObjectStore(pathlib.Path(name))
        store.start()
        try:
            yield store
        finally:
            store.stop()
