"""Who froze an ensemble: an OpenSSF model signature beside its folder, made and checked with keys of one's own.

Digests say that a folder is what its name says; a signature says who stands behind that name. It lies beside the folder
(`ensemble-....sig`, a Sigstore bundle), so that the folder stays as it was named. Nothing here uses a network.
"""

import importlib.util
import pathlib
from collections.abc import Iterator
from contextlib import contextmanager

from deltasafe.errors import ArtifactError, DataError, SettingsError
from deltasafe.io.storage import atomic_file
from deltasafe.perception.artifact.frozen_ensemble import verify_artifact

__all__ = ["sign_artifact", "signature_of", "verify_signature"]


def signature_of(folder: str | pathlib.Path) -> pathlib.Path:
    """Where the signature of a frozen ensemble lies: ``FOLDER.sig``, beside it."""
    resolved = pathlib.Path(folder).resolve()
    return resolved.with_name(f"{resolved.name}.sig")


def sign_artifact(folder: str | pathlib.Path, private_key: str | pathlib.Path) -> pathlib.Path:
    """Sign all files of an intact frozen ensemble; returns the signature, which replaces an older one.

    Args:
        private_key: PEM, not encrypted, on the curve P-256, P-384 or P-521.

    Raises:
        ArtifactError: the ensemble is incomplete or altered.
        DataError: the key is missing, or is none of that kind.
        SettingsError: model-signing is not installed.
    """
    _require_installed()
    from model_signing.signing import Config

    verify_artifact(folder)
    with _usable(private_key, "private key"):
        config = Config().use_elliptic_key_signer(private_key=pathlib.Path(private_key))
    destination = signature_of(folder)
    with atomic_file(destination) as temporary:
        config.sign(pathlib.Path(folder), temporary)
    return destination


def verify_signature(folder: str | pathlib.Path, public_key: str | pathlib.Path) -> None:
    """Check that a frozen ensemble is intact, and that exactly its files were signed with the key's private half.

    Raises:
        ArtifactError: the ensemble is incomplete or altered, or was not signed with this key, or a file was added.
        DataError: the key is missing, or is no public key on the curve P-256, P-384 or P-521.
        SettingsError: model-signing is not installed.
    """
    _require_installed()
    from model_signing.verifying import Config

    verify_artifact(folder)
    signature = signature_of(folder)
    if not signature.is_file():
        raise ArtifactError(signature, "is missing; pull it with the ensemble, or have the ensemble signed")
    with _usable(public_key, "public key"):
        config = Config().use_elliptic_key_verifier(public_key=pathlib.Path(public_key))
    try:
        config.verify(pathlib.Path(folder), signature)
    except Exception as error:  # of many kinds, as the bundle is read
        raise ArtifactError(
            signature, f"is no signature of {pathlib.Path(folder).name} by {public_key} ({_line(error)})"
        ) from error


def _require_installed() -> None:
    for name in ("model_signing", "OpenSSL"):
        if importlib.util.find_spec(name) is None:
            raise SettingsError("signatures need the package model-signing; pip install 'deltasafe[signing]'")


@contextmanager
def _usable(key: str | pathlib.Path, kind: str) -> Iterator[None]:
    """Turns what reading a PEM file can raise into one typed error."""
    try:
        yield
    except FileNotFoundError:
        raise DataError(key, f"is missing; give the {kind} as a PEM file") from None
    except Exception as error:
        raise DataError(
            key, f"is no {kind} that can be used ({_line(error)}); give a PEM file, unencrypted, of curve P-256"
        ) from error


def _line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0].strip() or type(error).__name__
