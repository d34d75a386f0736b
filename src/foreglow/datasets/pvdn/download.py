"""The download of PVDN; every obstacle becomes a message of a single line."""

from __future__ import annotations

import importlib
import inspect
from pathlib import Path
from typing import Any

PVDN_HANDLE = "saralajew/provident-vehicle-detection-at-night-pvdn"
"""PVDN at Kaggle. Source: README of the code published with the data set."""


def download_pvdn(target: Path | str, handle: str = PVDN_HANDLE) -> Path:
    """The folder `target`, into which the data set was downloaded.

    Needs the extra `download`, a Kaggle account that has accepted the data set's terms on its page, and an API token
    (`kaggle.json`, or the environment variables that kagglehub reads).

    Args:
        target: Folder to download into; made if absent, and empty or from an earlier download.
        handle: The data set's name at Kaggle, `owner/name`.

    Raises:
        ValueError: If kagglehub is not installed or too old, or Kaggle does not have the data set, denies access or
            cannot be reached; a line says what to do.
        OSError: If the folder cannot be written.
    """
    target = Path(target)
    try:
        kagglehub: Any = importlib.import_module("kagglehub")
        errors: Any = importlib.import_module("kagglehub.exceptions")
        requests: Any = importlib.import_module("requests")
    except ImportError as error:
        raise ValueError("kagglehub: expected to be installed: pip install 'foreglow[download]'") from error
    if "output_dir" not in inspect.signature(kagglehub.dataset_download).parameters:
        raise ValueError("kagglehub: expected a version that can choose the folder: pip install -U kagglehub")
    target.mkdir(parents=True, exist_ok=True)
    try:
        kagglehub.dataset_download(handle, output_dir=str(target))
    except (errors.UnauthenticatedError, errors.CredentialError) as error:
        raise ValueError(_not_allowed(handle)) from error
    except errors.NotFoundError as error:
        raise ValueError(f"{handle}: expected a data set at Kaggle, there is none of this name") from error
    except requests.exceptions.HTTPError as error:
        status = getattr(error.response, "status_code", None)
        if status in (401, 403):
            raise ValueError(_not_allowed(handle)) from error
        raise ValueError(f"{handle}: Kaggle refuses the download: {_first_line(error)}") from error
    except requests.exceptions.RequestException as error:
        raise ValueError(
            f"{handle}: Kaggle cannot be reached, is this machine online? ({type(error).__name__})"
        ) from error
    except (errors.DataCorruptionError, errors.BackendError) as error:
        raise ValueError(f"{handle}: the download is damaged or failed, try again: {_first_line(error)}") from error
    return target


def _not_allowed(handle: str) -> str:
    return (
        f"{handle}: Kaggle does not let us in: sign in, accept the terms at https://www.kaggle.com/datasets/{handle}, "
        "and make an API token in your account's settings (kaggle.json)"
    )


def _first_line(error: BaseException) -> str:
    lines = str(error).strip().splitlines()
    return lines[0] if lines else type(error).__name__
