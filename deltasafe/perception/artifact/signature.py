"""OpenSSF model signatures of frozen ensembles, made and verified with own keys, without a network (decision 37).

The digests of an artifact show that it is unaltered; a signature shows who froze it. The signature is a Sigstore bundle
beside the folder (`ensemble-....sig`), because the folder is named by its content.
"""

import importlib.util
import pathlib
from collections.abc import Iterator
from contextlib import contextmanager

from deltasafe.errors import ArtifactError, DataError, SettingsError
from deltasafe.io.storage import atomic_file
from deltasafe.perception.artifact.frozen_ensemble import verify_artifact


def signature_of(folder: str | pathlib.Path) -> pathlib.Path:
    """Return the path of the signature: ``FOLDER.sig``, beside the folder."""
    resolved = pathlib.Path(folder).resolve()
    return resolved.with_name(f"{resolved.name}.sig")


def sign_artifact(folder: str | pathlib.Path, private_key: str | pathlib.Path) -> pathlib.Path:
    """Sign all files of an intact frozen ensemble, replace an older signature, and return its path.

    Args:
        private_key: unencrypted PEM file of the curve P-256, P-384 or P-521.

    Raises:
        ArtifactError: the ensemble is incomplete or altered.
        DataError: the key is missing, or of another kind.
        SettingsError: model-signing is not installed.
    """
    _require_installed()
    from model_signing.signing import Config

    verify_artifact(folder)
    with _key_errors(private_key, "private key"):
        config = Config().use_elliptic_key_signer(private_key=pathlib.Path(private_key))
    destination = signature_of(folder)
    with atomic_file(destination) as temporary:
        config.sign(pathlib.Path(folder), temporary)
    return destination


def verify_signature(folder: str | pathlib.Path, public_key: str | pathlib.Path) -> None:
    """Verify that a frozen ensemble is intact and that exactly its files were signed with the matching private key.

    Raises:
        ArtifactError: the ensemble is incomplete or altered, was not signed with this key, or has an additional file.
        DataError: the key is missing, or not a public key of the curve P-256, P-384 or P-521.
        SettingsError: model-signing is not installed.
    """
    _require_installed()
    from model_signing.verifying import Config

    verify_artifact(folder)
    signature = signature_of(folder)
    if not signature.is_file():
        raise ArtifactError(signature, "is missing; pull it with the ensemble, or have the ensemble signed")
    with _key_errors(public_key, "public key"):
        config = Config().use_elliptic_key_verifier(public_key=pathlib.Path(public_key))
    try:
        config.verify(pathlib.Path(folder), signature)
    except Exception as error:  # parsing a bundle raises many types
        raise ArtifactError(
            signature, f"is not a signature of {pathlib.Path(folder).name} by {public_key} ({_first_line(error)})"
        ) from error


def _require_installed() -> None:
    for name in ("model_signing", "OpenSSL"):
        if importlib.util.find_spec(name) is None:
            raise SettingsError("signatures need the package model-signing; pip install 'deltasafe[signing]'")


@contextmanager
def _key_errors(key: str | pathlib.Path, kind: str) -> Iterator[None]:
    """Translate every exception of reading a PEM file to a `DataError`."""
    try:
        yield
    except FileNotFoundError:
        raise DataError(key, f"is missing; give the {kind} as a PEM file") from None
    except Exception as error:
        raise DataError(
            key, f"is not a usable {kind} ({_first_line(error)}); give an unencrypted PEM file of the curve P-256"
        ) from error


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0].strip() or type(error).__name__
