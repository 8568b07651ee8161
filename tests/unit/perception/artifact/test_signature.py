import hashlib
import json
import pathlib
import shutil
import subprocess
import sys

import pytest

from deltasafe.cli import main
from deltasafe.errors import ArtifactError, DataError, SettingsError
from deltasafe.perception.artifact import signature
from deltasafe.perception.artifact.frozen_ensemble import verify_artifact
from deltasafe.perception.artifact.signature import sign_artifact, signature_of, verify_signature
from tests.ensembles import freeze_constant

pytest.importorskip("model_signing", reason="the extra `signing` is not installed")

from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec, rsa


def write_keys(folder: pathlib.Path, name: str, key) -> tuple[pathlib.Path, pathlib.Path]:
    private, public = folder / f"{name}.pem", folder / f"{name}.pub.pem"
    private.write_bytes(
        key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    )
    public.write_bytes(
        key.public_key().public_bytes(serialization.Encoding.PEM, serialization.PublicFormat.SubjectPublicKeyInfo)
    )
    return private, public


@pytest.fixture(scope="module")
def keys(tmp_path_factory):
    folder = tmp_path_factory.mktemp("keys")
    return {
        "ours": write_keys(folder, "ours", ec.generate_private_key(ec.SECP256R1())),
        "theirs": write_keys(folder, "theirs", ec.generate_private_key(ec.SECP256R1())),
        "rsa": write_keys(folder, "rsa", rsa.generate_private_key(65537, 2048)),
        "other curve": write_keys(folder, "koblitz", ec.generate_private_key(ec.SECP256K1())),
    }


@pytest.fixture(scope="module")
def signed(tmp_path_factory, keys):
    folder = freeze_constant(tmp_path_factory.mktemp("home"), -2.0)
    sign_artifact(folder, keys["ours"][0])
    return folder


@pytest.fixture
def copy(signed, tmp_path):
    """A copy of the signed ensemble that a test may change."""
    folder = shutil.copytree(signed, tmp_path / signed.name)
    shutil.copyfile(signature_of(signed), signature_of(folder))
    return folder


def test_signed_ensemble_is_verified_and_unchanged(copy, keys):
    verify_signature(copy, keys["ours"][1])
    verify_artifact(copy)
    assert signature_of(copy).parent == copy.parent


def test_other_key_is_refused(copy, keys):
    with pytest.raises(ArtifactError, match=r"is not a signature of ensemble-.* by .*theirs"):
        verify_signature(copy, keys["theirs"][1])


def test_signature_by_other_key_under_our_key_id_is_refused(copy, keys):
    """The bundle identifies its key by a digest, which is not signed."""
    ours = json.loads(signature_of(copy).read_text())["verificationMaterial"]
    sign_artifact(copy, keys["theirs"][0])
    forged = json.loads(signature_of(copy).read_text())
    assert forged["verificationMaterial"] != ours
    signature_of(copy).write_text(json.dumps({**forged, "verificationMaterial": ours}))
    with pytest.raises(ArtifactError, match="is not a signature"):
        verify_signature(copy, keys["ours"][1])


def test_altered_file_is_refused_before_and_after_updating_digests(copy, keys):
    """An attacker can make the digests consistent again, but not the signature."""
    card = copy / "model_card.md"
    card.write_text(card.read_text().replace("Limits", "No limits"))
    with pytest.raises(ArtifactError, match=r"model_card\.md: was altered"):
        verify_signature(copy, keys["ours"][1])
    manifest = json.loads((copy / "manifest.json").read_text())
    manifest["files"]["model_card.md"] = hashlib.sha256(card.read_bytes()).hexdigest()
    (copy / "manifest.json").write_text(json.dumps(manifest))
    digest = hashlib.sha256((copy / "manifest.json").read_bytes()).hexdigest()
    renamed = copy.rename(copy.with_name(f"ensemble-{digest[:16]}"))
    shutil.copyfile(signature_of(copy), signature_of(renamed))
    verify_artifact(renamed)
    with pytest.raises(ArtifactError, match="is not a signature"):
        verify_signature(renamed, keys["ours"][1])


def test_added_file_and_broken_or_missing_signature_are_refused(copy, keys):
    (copy / "extra.txt").write_text("unsigned")
    with pytest.raises(ArtifactError, match=r"extra\.txt"):
        verify_signature(copy, keys["ours"][1])
    (copy / "extra.txt").unlink()
    verify_signature(copy, keys["ours"][1])
    signature_of(copy).write_text("{}")
    with pytest.raises(ArtifactError, match="is not a signature"):
        verify_signature(copy, keys["ours"][1])
    signature_of(copy).unlink()
    with pytest.raises(ArtifactError, match=r"\.sig: is missing"):
        verify_signature(copy, keys["ours"][1])


def test_altered_ensemble_is_not_signed(copy, keys):
    (copy / "calibration.json").unlink()
    with pytest.raises(ArtifactError, match=r"calibration\.json: is missing"):
        sign_artifact(copy, keys["ours"][0])


@pytest.mark.parametrize("name", ["rsa", "other curve", "no key", "missing"])
def test_unusable_key_is_refused_by_path(copy, keys, tmp_path, name):
    no_key = tmp_path / "no_key.pem"
    no_key.write_text("nothing")
    private, public = {"no key": (no_key, no_key), "missing": (tmp_path / "a", tmp_path / "a")}.get(name) or keys[name]
    before = signature_of(copy).read_bytes()
    with pytest.raises(DataError, match="PEM") as refused:
        sign_artifact(copy, private)
    assert refused.value.path == private
    with pytest.raises(DataError, match="PEM") as refused:
        verify_signature(copy, public)
    assert refused.value.path == public
    assert signature_of(copy).read_bytes() == before


def test_missing_package_is_named(copy, keys, monkeypatch):
    monkeypatch.setattr(signature.importlib.util, "find_spec", lambda name: None)
    for attempt in (lambda: sign_artifact(copy, keys["ours"][0]), lambda: verify_signature(copy, keys["ours"][1])):
        with pytest.raises(SettingsError, match=r"deltasafe\[signing\]"):
            attempt()


def test_sign_and_verify_commands(copy, keys, capsys):
    signature_of(copy).unlink()
    assert main(["sign", str(copy), "--key", str(keys["ours"][0])]) == 0
    assert str(signature_of(copy)) in capsys.readouterr().out
    assert main(["verify", str(copy), "--public-key", str(keys["ours"][1])]) == 0
    assert "signed with" in capsys.readouterr().out
    assert main(["verify", str(copy), "--public-key", str(keys["theirs"][1])]) == 1
    assert "is not a signature" in capsys.readouterr().err


def test_openssf_command_verifies_signature_and_refuses_other_key(copy, keys):
    command = [
        sys.executable,
        "-m",
        "model_signing",
        "verify",
        "key",
        str(copy),
        "--signature",
        str(signature_of(copy)),
    ]
    for whose, accepted in (("ours", True), ("theirs", False)):
        done = subprocess.run(
            [*command, "--public_key", str(keys[whose][1])], capture_output=True, text=True, check=False
        )
        assert (done.returncode == 0) is accepted, done.stdout + done.stderr
