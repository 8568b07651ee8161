"""Addresses with a password or an in-house certificate: MLflow's own client decides, and no password is shown."""

import contextlib
import datetime
import http.server
import ssl
import threading

import pytest

from pipelines.addresses import masked
from pipelines.commands import registry as command
from pipelines.executors import ray_step_executor
from pipelines.home import TRACKING_VARIABLE, mlflow_ui
from pipelines.tracking.call_queue import CallQueue
from pipelines.tracking.mlflow_server import allow_names
from pipelines.tracking.tracker import MlflowTracker, is_reachable

SECRET = "s3cret"


class Handler(http.server.BaseHTTPRequestHandler):
    def do_GET(self):
        self.server.seen.append(self.headers.get("Authorization"))
        self.send_response(200 if self.headers.get("Authorization") else 401)
        self.end_headers()

    do_POST = do_GET  # noqa: N815

    def log_message(self, *_):
        pass


@contextlib.contextmanager
def serving(certificate=None):
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        server.seen = []
        if certificate:
            context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
            context.load_cert_chain(certificate)
            server.socket = context.wrap_socket(server.socket, server_side=True)
        threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True).start()
        yield server
        server.shutdown()


@pytest.fixture(scope="module")
def certificate(tmp_path_factory):
    """Return a PEM file with a self-signed certificate for 127.0.0.1 and its key."""
    import ipaddress

    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec

    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "in-house")])
    now = datetime.datetime.now(datetime.UTC)
    address = x509.SubjectAlternativeName([x509.IPAddress(ipaddress.ip_address("127.0.0.1"))])
    signed = (
        x509.CertificateBuilder(name, name, key.public_key(), x509.random_serial_number())
        .not_valid_before(now - datetime.timedelta(days=1))
        .not_valid_after(now + datetime.timedelta(days=1))
        .add_extension(address, critical=False)
        .sign(key, hashes.SHA256())
    )
    file = tmp_path_factory.mktemp("tls") / "server.pem"
    plain = (serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    file.write_bytes(signed.public_bytes(serialization.Encoding.PEM) + key.private_bytes(*plain))
    return file


def test_an_address_with_a_password_is_reachable_and_logs_in():
    with serving() as server:
        assert is_reachable(f"http://user:{SECRET}@127.0.0.1:{server.server_port}")
        assert server.seen[0].startswith("Basic ")


def test_user_name_and_token_of_the_environment_are_used(monkeypatch):
    with serving() as server:
        monkeypatch.setenv("MLFLOW_TRACKING_TOKEN", SECRET)
        assert is_reachable(f"http://127.0.0.1:{server.server_port}")
        assert server.seen == [f"Bearer {SECRET}"]


@pytest.mark.filterwarnings("ignore::urllib3.exceptions.InsecureRequestWarning")
def test_settings_for_certificates_apply(certificate, monkeypatch):
    with serving(certificate) as server:
        uri = f"https://127.0.0.1:{server.server_port}"
        assert not is_reachable(uri, timeout_s=1.0)
        monkeypatch.setenv("MLFLOW_TRACKING_INSECURE_TLS", "true")
        assert is_reachable(uri)
        monkeypatch.delenv("MLFLOW_TRACKING_INSECURE_TLS")
        monkeypatch.setenv("MLFLOW_TRACKING_SERVER_CERT_PATH", str(certificate))
        assert is_reachable(uri)


def test_no_message_shows_the_password(tmp_path, monkeypatch, capsys, caplog):
    monkeypatch.setenv(TRACKING_VARIABLE, f"http://user:{SECRET}@127.0.0.1:9")
    monkeypatch.setattr(command, "prepare_home", lambda: tmp_path)
    assert command.main(["list"]) == 1
    assert MlflowTracker(tmp_path).register("i" * 64, tmp_path) is None
    shown = capsys.readouterr()
    assert "127.0.0.1:9" in shown.err
    assert "127.0.0.1:9" in caplog.text
    assert SECRET not in shown.err + shown.out + caplog.text
    assert mlflow_ui(f"https://user:{SECRET}@host/mlflow") == "https://host/mlflow"


def test_errors_of_mlflow_show_no_password(tmp_path, monkeypatch):
    from mlflow import MlflowException

    monkeypatch.setenv(TRACKING_VARIABLE, f"http://user:{SECRET}@127.0.0.1:9")
    monkeypatch.setenv("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "0")
    with pytest.raises(MlflowException) as caught, MlflowTracker(tmp_path).records():
        pass
    assert SECRET not in f"{caught.value} {caught.value.message}"


def test_a_refused_login_keeps_the_call(tmp_path, monkeypatch):
    """A password that expired: nothing is refused for good."""
    monkeypatch.setenv("MLFLOW_HTTP_REQUEST_MAX_RETRIES", "0")
    with serving() as server:
        monkeypatch.setenv(TRACKING_VARIABLE, f"http://127.0.0.1:{server.server_port}")
        assert MlflowTracker(tmp_path).register("i" * 64, tmp_path) is None
    queue = CallQueue(tmp_path / "mlflow" / "pending")
    assert (len(queue.files()), queue.refused()) == (1, [])


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("http://user:a@b@host:5000/x and more", "http://host:5000/x and more"),
        ("postgresql://u:p@host/db, https://host/a?b=c@d", "postgresql://host/db, https://host/a?b=c@d"),
        ("file:///home/me@work/x", "file:///home/me@work/x"),
        ("s3://bucket/key", "s3://bucket/key"),
    ],
)
def test_user_name_and_password_are_removed(text, shown):
    assert masked(text) == shown


def test_steps_on_a_cluster_get_no_address_with_a_password():
    pytest.importorskip("dagster_ray")
    environment = {"DELTASAFE_STEPS": "ray", "DELTASAFE_EXECUTOR": "ray", TRACKING_VARIABLE: f"http://u:{SECRET}@host"}
    assert SECRET not in str(ray_step_executor(environment).__dict__)
    assert TRACKING_VARIABLE not in str(ray_step_executor(environment).__dict__)


@pytest.mark.parametrize("host", ["lab.example", "0.0.0.0", "192.168.1.5"])
def test_mlflow_answers_a_browser_that_calls_this_machine_by_name(monkeypatch, host):
    import socket

    from mlflow.server import security_utils as mlflow

    for name in ("MLFLOW_SERVER_ALLOWED_HOSTS", "MLFLOW_SERVER_CORS_ALLOWED_ORIGINS"):
        monkeypatch.setenv(name, "")
        monkeypatch.delenv(name)
    monkeypatch.setattr(socket, "gethostname", lambda: "this-machine")
    allow_names(host, "http://lab.example:5001")
    for name in {host, "this-machine", "lab.example", "127.0.0.1"} - {"0.0.0.0"}:
        assert mlflow.is_allowed_host_header(mlflow.get_allowed_hosts_from_env(), f"{name}:5001"), name
        origin = f"http://{name}:5001"
        assert not mlflow.should_block_cors_request(origin, "POST", mlflow.get_allowed_origins_from_env()), name
    assert not mlflow.is_allowed_host_header(mlflow.get_allowed_hosts_from_env(), "attacker.example:5001")
    assert mlflow.should_block_cors_request("http://attacker.example", "POST", mlflow.get_allowed_origins_from_env())
